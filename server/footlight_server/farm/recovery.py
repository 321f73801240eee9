"""What a server that died in the middle has left: results between rename and record, and half-made files."""

import asyncio
import logging
import shutil
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TypeVar

from footlight.v1 import job_pb2
from footlight_server.farm.assignment import target_of
from footlight_server.farm.model import Attempt, StagedFrame
from footlight_server.farm.places import Places, workspace
from footlight_server.farm.queue import Queue
from footlight_server.farm.results import holds, put_in_place
from footlight_server.sessions.errors import ServiceError

log = logging.getLogger(__name__)
T = TypeVar("T")

# [s] For a file system, to read an image and to remove what is half-made.
_PATIENCE = 120.0


async def recover(queue: Queue, places: Places) -> int:
    """Bring queue and disk together, then make the tasks of that server ready again; answers how many attempts it left.

    To be called before anything is claimed. Raises StorageError.
    """
    await asyncio.gather(*(_settle(queue, staged) for staged in await queue.staged()))
    for attempt in await queue.running():
        for directory in await _workspaces(queue, places, attempt):
            await _answer(partial(shutil.rmtree, directory, ignore_errors=True), None)
    return await queue.recover()


async def _settle(queue: Queue, staged: StagedFrame) -> None:
    """Record a result if its bytes are there, under the one name or the other; else forget it."""
    path, temporary, digest = Path(staged.frame.path), Path(staged.temp_path), staged.frame.sha256
    there = await _answer(partial(holds, path, digest), otherwise=False)
    if not there and await _answer(partial(holds, temporary, digest), otherwise=False):
        try:
            async with asyncio.timeout(_PATIENCE):
                await asyncio.to_thread(put_in_place, temporary, path)
            there = True
        except OSError as error:
            log.warning("%s: made before the server stopped, but cannot be put in place: %s", path, error)
    if there and await queue.commit_frame(staged.attempt, staged.frame):
        log.info("%s: was finished before the server stopped", path)
    else:
        await queue.unstage(staged)


async def _answer(work: Callable[[], T], otherwise: T) -> T:
    """What file work comes to; `otherwise` if the file system hangs: for that no server shall stay down."""
    try:
        async with asyncio.timeout(_PATIENCE):
            return await asyncio.to_thread(work)
    except TimeoutError:
        log.warning("a file system did not answer for %g s; what was made there is made again", _PATIENCE)
        return otherwise


async def _workspaces(queue: Queue, places: Places, attempt: Attempt) -> Iterable[Path]:
    """The directories where an attempt may have worked."""
    try:
        task = await queue.task(attempt.job, attempt.task)
        layer = job_pb2.LayerSpec.FromString(await queue.layer_spec(attempt.job, task.layer))
    except ServiceError as error:
        log.warning("jobs/%d/tasks/%d: nothing is tidied up: %s", attempt.job, attempt.task, error)
        return ()
    return [workspace(target_of(layer, task, frame, places), attempt, frame) for frame in task.frames]
