"""The seam below a session: what it needs of a worker, and where it gets one, whatever machine that is on."""

from typing import Protocol

from footlight.worker.v1 import worker_pb2
from footlight_server.workers.film import Film


class Worker(Protocol):
    """A process that takes one task. Whoever took it closes it."""

    # Of what it runs, by name.
    versions: dict[str, str]

    @property
    def pid(self) -> int:
        """Of the process, on its own machine."""
        ...

    @property
    def alive(self) -> bool:
        """It has not ended yet, as far as we know."""
        ...

    @property
    def peak_memory(self) -> int:
        """[bytes] The most it was seen to hold so far; kept after its end."""
        ...

    @property
    def last_words(self) -> str:
        """The end of what it wrote to standard error, at most 8 KB; kept after its end."""
        ...

    async def send(self, request: worker_pb2.WorkerRequest) -> None:
        """Send a request; that the worker has gone shows in `receive`."""
        ...

    async def receive(self) -> worker_pb2.WorkerEvent:
        """The next event. The caller sets a deadline.

        Raises WorkerGoneError; its reason is LOST when nothing is heard of its host.
        """
        ...

    def open_film(self, message: worker_pb2.Film) -> Film:
        """The pixels that a Film event announces. Raises ValueError if it is not what it says."""
        ...

    def kill(self) -> None:
        """SIGKILL to it and what it may have started."""
        ...

    async def close(self) -> None:
        """Kill it if it lives, wait for its end within seconds, let go of everything."""
        ...


class WorkerSource(Protocol):
    """Gives out workers. Whoever made it closes it."""

    async def take(self, task: worker_pb2.Task) -> Worker:
        """A warm worker for this task, which the caller closes. Raises WorkerGoneError if none can be had.

        Notes in `task` what was done outside the worker for its confinement.
        """
        ...

    def prepare(self) -> None:
        """Have a worker warm up for the next task, if none does."""
        ...

    def prepare_spare(self) -> None:
        """The same, while a task runs; for a source that expects one task only it means nothing."""
        ...

    async def close(self) -> None:
        """End the workers that wait."""
        ...
