"""A bell that rings when the queue has changed: one rings, any number wait, none of them polls."""

import asyncio


class Changes:
    """Belongs to one event loop. Who looks first and then waits from the count it saw misses nothing.

    seen = changes.count
    ...  # look
    await changes.wait(seen)
    """

    def __init__(self) -> None:
        self._count = 0
        self._rung = asyncio.Event()

    @property
    def count(self) -> int:
        """How often it rang."""
        return self._count

    def ring(self) -> None:
        """Wake all that wait."""
        self._count += 1
        rung, self._rung = self._rung, asyncio.Event()
        rung.set()

    async def wait(self, seen: int) -> int:
        """Return the count as soon as it is above `seen`. Deadlines are the caller's: cancelling this loses nothing."""
        while self._count <= seen:
            await self._rung.wait()
        return self._count
