"""Lanes on this machine: every one a worker process at a time, all from one pool."""

import asyncio
import socket
from collections.abc import Sequence

from footlight_server.farm.model import Lane
from footlight_server.workers.pool import WorkerPool


class LocalExecutor:
    """`lanes` tasks run at the same time; 0: none ever. `memory_limit` [bytes] for each worker, 0: none."""

    def __init__(self, lanes: int, memory_limit: int) -> None:
        host = socket.gethostname()
        self._lanes = tuple(Lane(f"{host}/{number}", host) for number in range(1, lanes + 1))
        self._pool = WorkerPool(memory_limit, spare=True)
        self._changed = asyncio.Event()

    def lanes(self) -> Sequence[Lane]:
        """Always the same ones."""
        return self._lanes

    def source(self, lane: Lane) -> WorkerPool:  # noqa: ARG002 - the processes of a machine are alike
        """The pool."""
        return self._pool

    def changed(self) -> asyncio.Event:
        """Never set."""
        return self._changed

    async def start(self) -> None:
        """Nothing is started before there is a task: a server may never be given one."""

    async def close(self) -> None:
        """End the worker that waits."""
        await self._pool.close()
