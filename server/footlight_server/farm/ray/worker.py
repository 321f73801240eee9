"""A worker on a node of the cluster, as a session holds it: the interface of a local one, over the bridge."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable

import numpy as np

from footlight.v1 import render_pb2
from footlight.worker.v1 import bridge_pb2, worker_pb2
from footlight_server.farm.ray.link import BridgeLink
from footlight_server.workers.failure import Failure, FailureReason
from footlight_server.workers.film import Film, FilmShape, Plane, create_film, open_film
from footlight_server.workers.process import WorkerGoneError

log = logging.getLogger(__name__)

# [s] Without a word, when a sign of life is due every two: the node is taken for dead, long before Ray says so.
SILENCE = 10.0
# [s] For the first one, if the process that holds the lane has to be started: 1 s (measured) where nothing else runs.
STARTING = 12.0
# [s] For a worker to end.
_ENDING = 3.0


class RayWorker:
    """One conversation with a lane. Made by `take`; whoever holds it calls `close`."""

    def __init__(self, link: BridgeLink, lane: str, suspect: Callable[[str], None]) -> None:
        self.versions: dict[str, str] = {}
        self._link = link
        self._lane = lane
        self._suspect = suspect
        self._call = link.open(self)
        self._pid = 0
        self._events: deque[worker_pb2.WorkerEvent] = deque()
        self._news = asyncio.Event()
        self._failure: Failure | None = None
        self._ended = False
        self._heard = asyncio.get_running_loop().time() + STARTING - SILENCE
        self._peak = 0
        self._last_words = ""
        self._film: Film | None = None
        self._talk: set[asyncio.Task[None]] = set()

    @classmethod
    async def take(
        cls, link: BridgeLink, lane: str, task: worker_pb2.Task, memory_limit: int, suspect: Callable[[str], None]
    ) -> "RayWorker":
        """A worker that waits for `task`, in which it notes how it is confined. Raises WorkerGoneError.

        `suspect` is called with the lane when it falls silent or cannot be reached.
        """
        worker = cls(link, lane, suspect)
        try:
            take = bridge_pb2.Take(lane=lane, task=task, memory_limit=memory_limit)
            await link.send(bridge_pb2.BridgeRequest(call=worker._call, take=take))
            await worker._wait_until_taken(task)
        except BaseException:
            await worker.close()
            raise
        return worker

    @property
    def pid(self) -> int:
        """Of the process, on its node."""
        return self._pid

    @property
    def alive(self) -> bool:
        """It has not ended yet, as far as we know."""
        return not self._ended

    @property
    def peak_memory(self) -> int:
        """[bytes] The most it was seen to hold so far."""
        return self._peak

    @property
    def last_words(self) -> str:
        """The end of what it wrote to standard error; known once it has gone."""
        return self._last_words

    async def send(self, request: worker_pb2.WorkerRequest) -> None:
        """Send a request; that the worker has gone shows in `receive`."""
        await self._link.send(bridge_pb2.BridgeRequest(call=self._call, send=request))

    async def receive(self) -> worker_pb2.WorkerEvent:
        """The next event. Raises WorkerGoneError; LOST if nothing is heard of the node. The caller sets a deadline."""
        while not self._events:
            self._raise_if_gone()
            await self._wait_for_news()
        return self._events.popleft()

    def open_film(self, message: worker_pb2.Film) -> Film:
        """Pixels that are filled in as tiles arrive."""
        planes = tuple(Plane(aov.name, aov.channels, aov.offset) for aov in message.aovs)
        shape = FilmShape(message.width, message.height, planes)
        shape.check()
        self._film, descriptor = create_film(shape)
        return open_film(shape, descriptor)

    def kill(self) -> None:
        """SIGKILL to it, as soon as word of it gets through."""
        if not self._ended:
            kill = bridge_pb2.BridgeRequest(call=self._call, kill=bridge_pb2.Kill())
            task = asyncio.create_task(self._link.send(kill))
            self._talk.add(task)
            task.add_done_callback(self._talk.discard)

    async def close(self) -> None:
        """Have it end, wait for that within seconds, forget the conversation."""
        try:
            if not self._ended:
                await self._link.send(bridge_pb2.BridgeRequest(call=self._call, end=bridge_pb2.End()))
                async with asyncio.timeout(_ENDING):
                    while not self._ended:
                        self._news.clear()
                        await self._news.wait()
        except TimeoutError:
            log.warning("%s does not say that its worker has ended", self._lane)
        finally:
            self._ended = True
            self._link.forget(self._call)

    # --- what the bridge says ---

    def hear(self, event: bridge_pb2.BridgeEvent) -> None:
        """As Listener."""
        self._heard = asyncio.get_running_loop().time()
        match event.WhichOneof("event"):
            case "taken":
                self._pid = event.taken.pid
                self.versions = dict(event.taken.versions)
                self._taken = event.taken.task
            case "said":
                try:
                    self._paint(event.said)
                except (KeyError, ValueError) as error:
                    # A stage that is not trusted may speak through it; the other lanes shall hear nothing of that.
                    self._failure = Failure(FailureReason.INTERNAL, f"the worker sent what is no tile: {error!r:.200}")
                else:
                    self._events.append(event.said.event)
            case "beat":
                self._peak = max(self._peak, event.beat.peak_memory_bytes)
            case "gone":
                self._peak = max(self._peak, event.gone.peak_memory_bytes)
                self._last_words = event.gone.last_words
                if event.gone.unreachable:
                    self._suspect(self._lane)
                self._end(_failure(event.gone.failure))
        self._news.set()

    def lose(self, why: str) -> None:
        """As Listener."""
        self._end(Failure(FailureReason.LOST, why))
        self._news.set()

    def _end(self, failure: Failure) -> None:
        if not self._ended:
            self._ended = True
            self._failure = failure

    def _paint(self, said: bridge_pb2.Said) -> None:
        """Take the pixels of tiles in before anybody hears of them."""
        tiles = said.event.tiles
        if self._film is None or not said.pixels:
            return
        plane, shape = self._film.planes[tiles.aov], self._film.shape
        for index, data in zip(tiles.indices, said.pixels, strict=True):
            box = shape.box(index)
            pixels = np.frombuffer(data, "<f4").reshape(box.height, box.width, plane.shape[2])
            plane[box.y : box.y + box.height, box.x : box.x + box.width] = pixels

    async def _wait_until_taken(self, task: worker_pb2.Task) -> None:
        while not self._pid:
            self._raise_if_gone()
            await self._wait_for_news()
        task.CopyFrom(self._taken)

    async def _wait_for_news(self) -> None:
        """Until something comes; if the lane is silent for too long it is given up."""
        self._news.clear()
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout_at(max(self._heard + SILENCE, loop.time())):
                await self._news.wait()
        except TimeoutError:
            self._fall_silent(f"nothing was heard of {self._lane} for {SILENCE:g} s")

    def _fall_silent(self, why: str) -> None:
        self._suspect(self._lane)
        self._end(Failure(FailureReason.LOST, why))

    def _raise_if_gone(self) -> None:
        if self._failure is not None:
            raise WorkerGoneError(self._failure)


def _failure(message: render_pb2.Failure) -> Failure:
    name = render_pb2.FailureReason.Name(message.reason).removeprefix("FAILURE_REASON_")
    if name == "UNSPECIFIED":
        return Failure(FailureReason.CRASHED, "the worker was closed")
    return Failure(FailureReason[name], message.message, message.prim_path)
