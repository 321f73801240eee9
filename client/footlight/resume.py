"""Streams that are opened again where they broke: how long, how often, and the loop around it."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Iterator
from typing import Any

from footlight.errors import FootlightError, NotReadingError, ServerUnavailableError, rpc_errors

# [s] Between tries: the first, and the longest.
FIRST_PAUSE = 0.1
LONGEST_PAUSE = 2.0


def _quiet(_error: FootlightError) -> None:
    pass


class Patience:
    """How long a broken stream is tried again: `seconds` [s] from the break on, anew after each message.

    A stream that never began is not tried again, and 0 seconds is no try. `told` hears of every break once.
    """

    def __init__(
        self,
        seconds: float,
        told: Callable[[FootlightError], None] = _quiet,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._seconds = seconds
        self._told = told
        self._clock = clock
        self._began = False
        self._broken_at: float | None = None
        self._pause = FIRST_PAUSE

    def heard(self) -> None:
        """A message came."""
        self._began = True
        self._broken_at = None
        self._pause = FIRST_PAUSE

    def after(self, error: FootlightError) -> float:
        """[s] To wait before the next try. Raises `error` if another try is of no use, or too late."""
        if not self._began:
            raise error
        if isinstance(error, NotReadingError):
            self._began = False  # two in a row without a message between are one too many
            return 0.0
        if not isinstance(error, ServerUnavailableError):
            raise error
        now = self._clock()
        if self._broken_at is None:
            self._broken_at = now
            if self._seconds > 0:
                self._told(error)
        if now - self._broken_at >= self._seconds:
            raise error
        pause = self._pause
        self._pause = min(2 * pause, LONGEST_PAUSE)
        return pause


def resumed(address: str, patience: Patience, call: Callable[[], Any]) -> Iterator[Any]:
    """The messages of a stream that `call` opens, from where the last one broke. Cancelled when the iteration ends."""
    while True:
        try:
            with rpc_errors(address):
                stream = call()
                try:
                    for message in stream:
                        patience.heard()
                        yield message
                    return
                finally:
                    stream.cancel()
        except FootlightError as error:
            pause = patience.after(error)
        time.sleep(pause)


async def resumed_async(address: str, patience: Patience, call: Callable[[], Any]) -> AsyncGenerator[Any, None]:
    """`resumed` for asyncio."""
    while True:
        try:
            with rpc_errors(address):
                stream = call()
                try:
                    async for message in stream:
                        patience.heard()
                        yield message
                    return
                finally:
                    stream.cancel()
        except FootlightError as error:
            pause = patience.after(error)
        await asyncio.sleep(pause)
