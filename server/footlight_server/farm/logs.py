"""The log of an attempt: one line for each thing that happened, then what the worker wrote to standard error."""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

log = logging.getLogger(__name__)


class LogWriter:
    """Writes the logs of all attempts on one thread, in order. A log that cannot be written stops no render."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._thread = ThreadPoolExecutor(1, "attempt-logs")

    def open(self, path: Path) -> "AttemptLog":
        """A log at that path; the file and its directory are made with the first line."""
        return AttemptLog(path, self._clock, self._thread)

    def close(self) -> None:
        """Finish what is to be written. Blocks."""
        self._thread.shutdown(wait=True)


class AttemptLog:
    """Appended to from the event loop, which it never blocks."""

    def __init__(self, path: Path, clock: Callable[[], float], thread: ThreadPoolExecutor) -> None:
        self._path = path
        self._clock = clock
        self._thread = thread

    def say(self, text: str) -> None:
        """Add a line, or several, with the time (UTC) before each."""
        stamp = datetime.fromtimestamp(self._clock(), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        lines = "".join(f"{stamp} {_plain(line)}\n" for line in text.splitlines() or [""])
        self._thread.submit(self._append, lines)

    async def flush(self) -> None:
        """Wait until all of it is in the file."""
        await asyncio.wrap_future(self._thread.submit(int))

    def _append(self, lines: str) -> None:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8", errors="replace") as file:
                file.write(lines)
        except OSError as error:
            log.warning("%s: a line is lost: %s", self._path, error.strerror)


def _plain(line: str) -> str:
    """Without what would steer the terminal of whoever reads it; a stage that is not trusted may have written it."""
    return "".join(letter if letter.isprintable() or letter == "\t" else "\ufffd" for letter in line)
