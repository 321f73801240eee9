"""Looks every few seconds at what a server has: tasks, lanes, workers' memory, uploads, and how late its loop is."""

import asyncio
import logging
import os
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from pathlib import Path

from footlight_server.blobs.store import BlobStore
from footlight_server.farm.dispatcher import Farm
from footlight_server.farm.queue import Queue
from footlight_server.metrics import Metrics
from footlight_server.workers.memory import resident_memory

log = logging.getLogger(__name__)

# [s] Between two looks at the queue and the processes; a look may take so long.
_PERIOD = 5.0
# A look may take this share of the time at most: of uploads there may be a million files.
_SHARE = 0.05
_PATIENCE = 30.0
# [s] How long the task sleeps that measures how late the loop wakes it.
_LAG_PERIOD = 0.5


class Gauges:
    """From `start` to `close`. A look that fails is logged, and the next one tries again."""

    def __init__(self, metrics: Metrics, queue: Queue, farm: Farm, blobs: BlobStore) -> None:
        self._metrics = metrics
        self._queue = queue
        self._farm = farm
        self._blobs = blobs
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begin, with a look at once."""
        looks = (self._look_at_farm, self._look_at_workers, self._look_at_blobs)
        self._tasks = [asyncio.create_task(_every(_PERIOD, look), name=look.__name__) for look in looks]
        self._tasks.append(asyncio.create_task(self._measure_lag(), name="loop lag"))

    async def close(self) -> None:
        """End."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _look_at_farm(self) -> None:
        self._metrics.show_lanes(len(self._farm.lanes()), len(self._farm.running()))
        self._metrics.show_tasks(asdict(await self._queue.task_counts()))

    async def _look_at_workers(self) -> None:
        self._metrics.show_workers(*await asyncio.to_thread(children_memory))

    async def _look_at_blobs(self) -> None:
        self._metrics.show_blobs(await self._blobs.total_bytes())

    async def _measure_lag(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            due = loop.time() + _LAG_PERIOD
            await asyncio.sleep(_LAG_PERIOD)
            self._metrics.count_lag(max(0.0, loop.time() - due))


async def _every(period: float, look: Callable[[], Awaitable[None]]) -> None:
    while True:
        begun = time.monotonic()
        try:
            async with asyncio.timeout(_PATIENCE):
                await look()
        except Exception as error:  # noqa: BLE001 - a number that is not known now is known later
            log.warning("no metrics from %s: %s: %s", look.__name__, type(error).__name__, error)
        await asyncio.sleep(max(period, (time.monotonic() - begun) / _SHARE))


def children_memory() -> tuple[int, int]:
    """Processes that this one started, and [bytes] what they hold together. Blocks."""
    pid = os.getpid()
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    held = [memory for child in children if (memory := resident_memory(int(child)))]
    return len(held), sum(held)
