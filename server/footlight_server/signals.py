"""When a server shall stop: a signal, a second one that hurries, or the end of standard input."""

import asyncio
import os
import signal
import sys
from collections.abc import Coroutine


class Stop:
    """Belongs to the running loop. `asked` is set by the first SIGTERM or SIGINT, `hurried` by the second."""

    def __init__(self, *, private: bool) -> None:
        self.asked = asyncio.Event()
        self.hurried = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            self._loop.add_signal_handler(number, self._signalled)
        if private:
            self._loop.add_reader(sys.stdin.fileno(), self._read)

    def _signalled(self) -> None:
        if self.asked.is_set():
            self.hurried.set()
        self.asked.set()

    def _read(self) -> None:
        """Whoever holds the other end says nothing; it only lets go."""
        if not os.read(sys.stdin.fileno(), 4096):
            self._loop.remove_reader(sys.stdin.fileno())
            self.asked.set()
            self.hurried.set()


async def unless(event: asyncio.Event, work: Coroutine[object, object, None]) -> bool:
    """Await the work, but give it up as soon as the event is set. Whether it came to its end; raises what it raises."""
    working, waiting = asyncio.create_task(work), asyncio.create_task(event.wait())
    try:
        await asyncio.wait({working, waiting}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (working, waiting):
            task.cancel()
        await asyncio.wait({working, waiting})
    if working.cancelled():
        return False
    working.result()
    return True
