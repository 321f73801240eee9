"""Forgets jobs, in the queue and in the data folder; what a crash interrupts the next start brings to its end.

Before the queue forgets a job it is marked in the data folder. A folder without a mark is never removed, so a server
that is started with the wrong database removes nothing.
"""

import asyncio
import contextlib
import shutil
from collections.abc import Sequence
from pathlib import Path

from footlight_server.farm.places import Places
from footlight_server.farm.queue import Queue
from footlight_server.sessions.errors import JobNotFoundError, StorageError

# [jobs] In one transaction, during which nobody else writes; the largest has some million rows.
_TOGETHER = 10


async def prune(queue: Queue, places: Places, jobs: Sequence[int]) -> int:
    """[bytes] That were freed. Raises what `Queue.prune` raises; jobs before the one at fault may be gone then."""
    freed = 0
    for start in range(0, len(jobs), _TOGETHER):
        together = jobs[start : start + _TOGETHER]
        await asyncio.to_thread(_mark, places, together)
        try:
            await queue.prune(together)
        except StorageError:  # it may happen yet; the next start knows
            raise
        except Exception:
            await asyncio.to_thread(_unmark, places, together)
            raise
        freed += await asyncio.to_thread(_remove, places, together)
    return freed


async def finish_pruning(queue: Queue, places: Places) -> None:
    """At start: end what a server before this one was about to do. Raises StorageError."""
    for job in await asyncio.to_thread(_marked, places):
        try:
            await queue.job(job)
        except JobNotFoundError:
            await asyncio.to_thread(_remove, places, [job])
        else:
            await asyncio.to_thread(_unmark, places, [job])


def _mark(places: Places, jobs: Sequence[int]) -> None:
    try:
        for job in jobs:
            path = places.pruned(job)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    except OSError as error:
        raise StorageError(f"the data folder cannot be written to: {error.strerror}") from error


def _unmark(places: Places, jobs: Sequence[int]) -> None:
    for job in jobs:
        with contextlib.suppress(OSError):
            places.pruned(job).unlink()


def _marked(places: Places) -> list[int]:
    marks = places.pruned(0)
    numbers = (path.name.rpartition("-")[2] for path in marks.parent.glob(marks.name.removesuffix("0") + "*"))
    return [int(number) for number in numbers if number.isdecimal()]


def _remove(places: Places, jobs: Sequence[int]) -> int:
    """[bytes] Freed."""
    freed = 0
    for job in jobs:
        folder = places.job(job)
        freed += sum(_size(path) for path in folder.rglob("*"))
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            _unmark(places, [job])
    return freed


def _size(path: Path) -> int:
    """[bytes] Of a file; nothing of what goes while we look, as a log does that is being written."""
    try:
        return 0 if path.is_dir() else path.lstat().st_size
    except OSError:
        return 0
