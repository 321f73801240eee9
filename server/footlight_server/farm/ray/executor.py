"""Lanes on the nodes of a Ray cluster. A bridge that ends is started again; the queue gives its tasks out anew."""

import asyncio
import contextlib
import logging
import time
from collections.abc import Sequence

from footlight.worker.v1 import bridge_pb2, worker_pb2
from footlight_server.farm.model import Lane
from footlight_server.farm.ray.environment import Access, check_access
from footlight_server.farm.ray.link import BridgeLink
from footlight_server.farm.ray.worker import RayWorker
from footlight_server.workers.failure import Failure, FailureReason
from footlight_server.workers.process import WorkerGoneError

log = logging.getLogger(__name__)

# [s] Without a word from the bridge, which speaks every two; before another one is started.
_SILENCE = 30.0
_PAUSE = 2.0
# [s] For the bridge to join and tell its first lanes, when the server starts.
_JOINING = 60.0
# [s] A lane that was lost is not used for so long; by then Ray has found out whether its node is gone (15 s, measured).
_SUSPECT = 20.0


class RayExecutor:
    """Implements Executor. `address` HOST:PORT of the head; `memory_limit` [bytes] for each worker, 0: none."""

    def __init__(self, address: str, access: Access, memory_limit: int) -> None:
        self._address = address
        self._access = access
        self._memory_limit = memory_limit
        self._link: BridgeLink | None = None
        self._lanes: tuple[Lane, ...] = ()
        # What `lanes` was when the change was last told.
        self._told: Sequence[Lane] = ()
        # lane -> [s, monotonic] when it may be used again.
        self._suspects: dict[str, float] = {}
        self._changed = asyncio.Event()
        self._keeper: asyncio.Task[None] | None = None

    def lanes(self) -> Sequence[Lane]:
        """Those of nodes that live, but not what was just lost."""
        now = time.monotonic()
        return tuple(lane for lane in self._lanes if self._suspects.get(lane.name, 0.0) <= now)

    def source(self, lane: Lane) -> "LaneSource":
        """Workers of that lane."""
        return LaneSource(self, lane.name)

    def changed(self) -> asyncio.Event:
        """Set when `lanes()` has changed."""
        return self._changed

    async def start(self) -> None:
        """Join the cluster. Raises RuntimeError if it does not answer, ClusterError if it cannot be joined safely."""
        await asyncio.to_thread(check_access, self._address.rpartition(":")[0].strip("[]"), self._access)
        self._keeper = asyncio.create_task(self._keep())
        try:
            async with asyncio.timeout(_JOINING):
                while not self._lanes:
                    await self._changed.wait()
                    self._changed.clear()
        except TimeoutError:
            await self.close()
            raise RuntimeError(
                f"the Ray cluster at {self._address} showed no node with lanes within {_JOINING:g} s; start one with "
                "`footlight cluster up`, and see that the tokens are the same"
            ) from None
        self._changed.set()

    async def close(self) -> None:
        """Leave the cluster; its actors end with the bridge."""
        if self._keeper is not None:
            self._keeper.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._keeper

    async def take(self, lane: str, task: worker_pb2.Task) -> RayWorker:
        """A worker on the lane. Raises WorkerGoneError."""
        if self._link is None:
            raise WorkerGoneError(Failure(FailureReason.LOST, "there is no connection to the Ray cluster"))
        return await RayWorker.take(self._link, lane, task, self._memory_limit, self.suspect)

    def suspect(self, lane: str) -> None:
        """Leave a lane alone until it is known whether its node lives."""
        self._suspects[lane] = time.monotonic() + _SUSPECT
        self._tell()

    def update(self, lanes: bridge_pb2.Lanes) -> None:
        """As Lanes: what the bridge sees."""
        self._lanes = tuple(Lane(lane.name, lane.node) for lane in lanes.lanes)
        self._tell()

    def _tell(self) -> None:
        """Say so if the lanes are others than before."""
        now = self.lanes()
        if now != self._told:
            log.info("Ray lanes: %s", ", ".join(lane.name for lane in now) or "none")
            self._told = now
            self._changed.set()

    async def _keep(self) -> None:
        """Have a bridge, always."""
        while True:
            try:
                await self._cross()
            except Exception:
                # Whatever it was: without a bridge nothing runs until somebody is woken up.
                log.exception("the bridge to the Ray cluster failed")
            await asyncio.sleep(_PAUSE)

    async def _cross(self) -> None:
        """One bridge, from its start to its end."""
        link = await BridgeLink.start(self._address, self._access, self)
        self._link = link
        try:
            await link.run(_SILENCE)
        finally:
            self._link = None
            self.update(bridge_pb2.Lanes())
            await link.close()


class LaneSource:
    """Implements WorkerSource for one lane; the node keeps its own worker warm."""

    def __init__(self, executor: RayExecutor, lane: str) -> None:
        self._executor = executor
        self._lane = lane

    async def take(self, task: worker_pb2.Task) -> RayWorker:
        """As WorkerSource."""
        return await self._executor.take(self._lane, task)

    def prepare(self) -> None:
        """The node does."""

    def prepare_spare(self) -> None:
        """The node does."""

    async def close(self) -> None:
        """Nothing waits here."""
