"""Gives out worker processes and keeps one warm ahead of need."""

import asyncio
import contextlib
import logging

from footlight.worker.v1 import worker_pb2
from footlight_server.workers.failure import Failure, FailureReason
from footlight_server.workers.process import WorkerGoneError, WorkerProcess
from footlight_server.workers.sandbox import SandboxName, choose_sandbox

log = logging.getLogger(__name__)

# A worker that dies before it has a task says nothing about the task.
_ATTEMPTS = 3


class WorkerPool:
    """Gives out workers; keeps one warm ahead of need."""

    def __init__(self, memory_limit: int, *, spare: bool) -> None:
        self._memory_limit = memory_limit
        self._spare = spare
        self._next: asyncio.Task[WorkerProcess] | None = None

    def prepare(self) -> None:
        """Have a worker warm up for the next task, if none does."""
        if self._next is None:
            self._next = asyncio.create_task(self._warm())

    def prepare_spare(self) -> None:
        """The same, while a task runs; a server that expects one task only does not."""
        if self._spare:
            self.prepare()

    async def take(self, task: worker_pb2.Task) -> WorkerProcess:
        """A warm worker, which the caller closes. Raises WorkerGoneError if none can be had.

        For a task that has to be confined it is one that is, or in `task.confinement` it is told to do that itself.
        """
        if task.HasField("confinement"):
            sandbox = await asyncio.to_thread(choose_sandbox)
            if sandbox.refusal:
                raise WorkerGoneError(Failure(FailureReason.STAGE_UNREADABLE, sandbox.refusal))
            task.confinement.outside = sandbox.name is SandboxName.BUBBLEWRAP
            if task.confinement.outside:
                return await self._warm(task.confinement)
        return await self._take_warm()

    async def _take_warm(self) -> WorkerProcess:
        for attempt in range(1, _ATTEMPTS + 1):
            self.prepare()
            assert self._next is not None
            coming, self._next = self._next, None
            try:
                worker = await self._hand_over(coming)
            except WorkerGoneError as gone:
                log.warning("a worker died before it had a task: %s", gone)
                if attempt == _ATTEMPTS:
                    raise
                continue
            if worker.alive:
                return worker
            log.warning("worker %d died while it waited for a task", worker.pid)
            await worker.close()
        message = f"{_ATTEMPTS} workers died before they had a task"
        raise WorkerGoneError(Failure(FailureReason.CRASHED, message))

    async def close(self) -> None:
        """End the worker that waits."""
        if self._next is not None:
            coming, self._next = self._next, None
            coming.cancel()
            with contextlib.suppress(asyncio.CancelledError, WorkerGoneError):
                await (await coming).close()

    async def _warm(self, confinement: worker_pb2.Confinement | None = None) -> WorkerProcess:
        worker = await WorkerProcess.spawn(self._memory_limit, confinement)
        try:
            await worker.warm_up()
        except BaseException:
            await worker.close()
            raise
        return worker

    async def _hand_over(self, coming: asyncio.Task[WorkerProcess]) -> WorkerProcess:
        """Wait for a warming worker; if the waiter is cancelled, the worker goes back."""
        try:
            return await asyncio.shield(coming)
        except asyncio.CancelledError:
            if self._next is None:
                self._next = coming
            else:
                coming.cancel()
            raise
