"""The seam below the dispatcher: lanes where tasks run one at a time, and where a lane's workers come from."""

import asyncio
from collections.abc import Sequence
from typing import Protocol

from footlight_server.farm.model import Lane
from footlight_server.workers.source import WorkerSource


class Executor(Protocol):
    """Owns the places where tasks run. It is lossy: the queue is the truth, and nothing here retries a task."""

    def lanes(self) -> Sequence[Lane]:
        """Those that are there now, by name; nodes come and go."""
        ...

    def source(self, lane: Lane) -> WorkerSource:
        """Where a session on this lane gets its worker; the executor closes it.

        The source of a lane that has gone gives none: WorkerGoneError, LOST.
        """
        ...

    def changed(self) -> asyncio.Event:
        """Set when `lanes()` has changed; whoever waits for it clears it before it asks for the lanes."""
        ...

    async def start(self) -> None:
        """Bring the lanes up; those that take longer come with `changed`. Raises RuntimeError if there can be none."""
        ...

    async def close(self) -> None:
        """End all workers, within seconds."""
        ...
