"""The actor that holds one lane on a node: starts the worker as its own child there and carries messages to and fro."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

from footlight.v1 import render_pb2
from footlight.worker.v1 import bridge_pb2, worker_pb2
from footlight_server.farm.ray.outbox import Outbox, PendingTiles
from footlight_server.workers.film import Film
from footlight_server.workers.pool import WorkerPool
from footlight_server.workers.process import WorkerGoneError
from footlight_server.workers.source import Worker

# [s] Between signs of life.
BEAT = 2.0


class LaneActor:
    """One conversation at a time; a new one ends the one before, which nobody listens to any more.

    The renderer is no part of this process: its crash, its memory and its limits are those of a child that is ours.
    """

    def __init__(self, memory_limit: int) -> None:
        self._pool = WorkerPool(memory_limit, spare=True)
        self._worker: Worker | None = None
        # A worker that is being taken.
        self._coming: asyncio.Task[Worker] | None = None

    async def converse(self, data: bytes) -> AsyncIterator[bytes]:
        """Take a worker for the task in `data` and tell all it says, as serialized BridgeEvents, up to `gone`."""
        await self.end()
        task = worker_pb2.Task.FromString(data)
        try:
            self._pool.prepare()
            self._coming = coming = asyncio.create_task(self._pool.take(task))
            while not coming.done():
                yield bridge_pb2.BridgeEvent(beat=bridge_pb2.Beat()).SerializeToString()
                await asyncio.wait({coming}, timeout=BEAT)
            self._worker = worker = coming.result()
        except WorkerGoneError as error:
            yield _gone(error).SerializeToString()
            return
        except asyncio.CancelledError:  # `end` came first
            return
        finally:
            self._coming = None
        taken = bridge_pb2.Taken(pid=worker.pid, versions=worker.versions, task=task)
        yield bridge_pb2.BridgeEvent(taken=taken).SerializeToString()
        try:
            async for event in _relay(worker):
                if event.said.event.HasField("progress"):
                    self._pool.prepare_spare()
                yield event.SerializeToString()
        finally:
            await self._close(worker)

    async def send(self, data: bytes) -> None:
        """Pass a serialized WorkerRequest on to the worker."""
        if self._worker is not None:
            await self._worker.send(worker_pb2.WorkerRequest.FromString(data))

    async def kill(self) -> None:
        """SIGKILL to the worker; what it died of comes as `gone`."""
        if self._worker is not None:
            self._worker.kill()

    async def end(self) -> None:
        """Close the worker, or take none, and wait for its end."""
        if self._coming is not None:
            self._coming.cancel()
        if self._worker is not None:
            await self._close(self._worker)

    async def _close(self, worker: Worker) -> None:
        if self._worker is worker:
            self._worker = None
        await worker.close()


async def _relay(worker: Worker) -> AsyncIterator[bridge_pb2.BridgeEvent]:
    """What the worker says, and signs of life; `gone` comes last."""
    outbox = Outbox()
    film: Film | None = None
    reader = asyncio.create_task(_read(worker, outbox))
    waiting = asyncio.create_task(outbox.next())
    try:
        while True:
            await asyncio.wait({reader, waiting}, timeout=BEAT, return_when=asyncio.FIRST_COMPLETED)
            if waiting.done():
                entry = waiting.result()
                waiting = asyncio.create_task(outbox.next())
                if isinstance(entry, PendingTiles):
                    assert film is not None
                    for tiles in entry.messages():
                        yield _painted(tiles, film)
                    continue
                if entry.HasField("film"):
                    film = worker.open_film(entry.film)
                yield bridge_pb2.BridgeEvent(said=bridge_pb2.Said(event=entry))
            elif reader.done():
                yield _gone(reader.result(), worker)
                return
            else:
                yield bridge_pb2.BridgeEvent(beat=bridge_pb2.Beat(peak_memory_bytes=worker.peak_memory))
    finally:
        for task in (reader, waiting):
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


async def _read(worker: Worker, outbox: Outbox) -> WorkerGoneError:
    """Fill the outbox until the worker has gone, and say why."""
    try:
        while True:
            outbox.put(await worker.receive())
    except WorkerGoneError as error:
        return error


def _painted(tiles: worker_pb2.Tiles, film: Film) -> bridge_pb2.BridgeEvent:
    plane = film.planes[tiles.aov]
    said = bridge_pb2.Said(event=worker_pb2.WorkerEvent(tiles=tiles))
    for index in tiles.indices:
        box = film.shape.box(index)
        said.pixels.append(plane[box.y : box.y + box.height, box.x : box.x + box.width].tobytes())
    return bridge_pb2.BridgeEvent(said=said)


def _gone(error: WorkerGoneError, worker: Worker | None = None) -> bridge_pb2.BridgeEvent:
    failure = error.failure
    gone = bridge_pb2.Gone(
        failure=render_pb2.Failure(
            reason=render_pb2.FailureReason.Value(f"FAILURE_REASON_{failure.reason.name}"),
            message=failure.message,
            prim_path=failure.prim_path,
        )
    )
    if worker is not None:
        gone.peak_memory_bytes = worker.peak_memory
        gone.last_words = worker.last_words
    return bridge_pb2.BridgeEvent(gone=gone)
