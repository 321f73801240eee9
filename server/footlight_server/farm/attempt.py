"""One attempt at a task: its frames one after the other, each a session, and each result recorded as it comes."""

import asyncio
import contextlib
import logging
import shutil
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from footlight.v1 import job_pb2, render_pb2, stats_pb2
from footlight_server.blobs.durable import make_directory
from footlight_server.farm.assignment import Assignment, assign, bundle_of, is_part, patience_of
from footlight_server.farm.endings import ending_of
from footlight_server.farm.logs import AttemptLog
from footlight_server.farm.meter import FarmMeter
from footlight_server.farm.model import Attempt, Claim, Ending, ExitClass, Frame, StagedFrame, TaskKind
from footlight_server.farm.outputs import is_below
from footlight_server.farm.places import Places
from footlight_server.farm.queue import Queue
from footlight_server.farm.results import copy_in_place, put_in_place, seal, why
from footlight_server.sessions.errors import BlobsMissingError, InvalidFieldsError, ServiceError, StorageError
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.session import Session
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from footlight_server.workers.source import WorkerSource

log = logging.getLogger(__name__)
T = TypeVar("T")

# [s] Between two tries to tell the queue, while its database does not answer.
_RETRY_PERIOD = 1.0
# [s] That a file system may take for a result; a hang is a failure like any other.
_FILE_PATIENCE = 300.0
# [s] That nobody waits longer for a log, or for what is left over to be removed.
_TIDYING = 30.0
# [s] That unpacking an uploaded stage may take.
_BUNDLE_PATIENCE = 900.0
_FENCED = Ending(ExitClass.CANCELLED, "it is not the current attempt any more")


class BundleFiles(Protocol):
    """Where uploaded stages are."""

    async def materialise(self, digest: str) -> Path:
        """The directory with a bundle's files, read-only. Raises BlobsMissingError, StorageError."""
        ...


@dataclass(frozen=True, slots=True)
class Running:
    """An attempt that runs, as it is now. `frame`, `render` (`renders/{id}`) and `progress`: of the frame at hand."""

    attempt: Attempt
    frame: int | None
    render: str
    progress: render_pb2.Progress | None


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What attempts work with. `bundles`: None if the server takes no uploads."""

    settings: Settings
    places: Places
    queue: Queue
    sessions: Sessions
    bundles: BundleFiles | None
    meter: FarmMeter | None = None


async def insist(say: Callable[[], Awaitable[T]]) -> T:
    """Tell the queue something, again and again while its database does not answer."""
    while True:
        try:
            return await say()
        except StorageError as error:
            log.warning("the queue does not answer, trying again: %s", error)
            await asyncio.sleep(_RETRY_PERIOD)


class AttemptRun:
    """Made when a task was claimed; `run` takes it to its end."""

    def __init__(
        self, claim: Claim, source: Callable[[], WorkerSource], around: Surroundings, attempt_log: AttemptLog
    ) -> None:
        self.claim = claim
        self._source = source
        self._around = around
        self._log = attempt_log
        self._session: Session | None = None
        self._course: asyncio.Task[None] | None = None
        self._frame: int | None = None
        self._stop: Ending | None = None
        self._stopped = asyncio.Event()
        self._peak = 0

    @property
    def now(self) -> Running:
        """As it is."""
        if self._session is None:
            return Running(self.claim.attempt, self._frame, "", None)
        return Running(self.claim.attempt, self._frame, self._session.name, self._session.progress)

    def stop(self, exit_class: ExitClass, message: str) -> None:
        """Have it end soon; the first to ask says how. What a worker has finished by now is still recorded."""
        if self._stop is None:
            self._stop = Ending(exit_class, message)
            self._stopped.set()
            self._log.say(f"stopping: {message}")
            self._stop_session()

    async def run(self) -> Ending:
        """Render what has no image yet; how it ended. Raises only when it is cancelled."""
        task, attempt = self.claim.task, self.claim.attempt
        self._log.say(
            f"attempt {attempt.number} at task {task.number} on {attempt.worker}: {task.kind} {task.layer}, "
            f"frames {_listed(task.frames)}, samples {task.sample_begin} to {task.sample_end}"
        )
        try:
            ending = await self._run_frames()
        except (BlobsMissingError, InvalidFieldsError) as error:
            ending = Ending(ExitClass.SCENE, str(error))
        except (OSError, ServiceError) as error:
            ending = Ending(ExitClass.OUTPUT, str(error) or type(error).__name__)
        except Exception as error:
            log.exception("jobs/%d/tasks/%d: the server failed", attempt.job, attempt.task)
            ending = Ending(ExitClass.CRASH, f"{type(error).__name__}: {error}")
        self._log.say(f"ended: {ending.exit_class}" + (f": {ending.message}" if ending.message else ""))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_TIDYING):
                await self._log.flush()
        return replace(ending, peak_memory_bytes=self._peak)

    # --- its frames ---

    async def _run_frames(self) -> Ending:
        files = await self._files_of_bundle()
        patience = patience_of(self.claim, self._around.settings)
        settings, places = self._around.settings, self._around.places
        for frame in self.claim.task.frames:
            if frame in self.claim.done:
                continue
            if self._stop is not None:
                return self._stop
            parts = await self._parts(frame)
            if isinstance(parts, Ending):
                return parts
            self._frame = frame
            work = assign(self.claim, frame, settings=settings, places=places, parts=parts, files=files)
            if work.ours:
                await _in_time(partial(make_directory, work.target.parent), _FILE_PATIENCE)
            # Looked at when it was submitted; a link may have been put there since.
            elif not await _in_time(partial(is_below, work.target, settings.output_roots), _FILE_PATIENCE):
                return Ending(ExitClass.SCENE, f"{work.target}: leads out of the directories this server may write to")
            ending = await self._run_frame(work, patience)
            if ending is not None:
                return ending
        return Ending(ExitClass.SUCCEEDED)

    async def _run_frame(self, work: Assignment, patience: Patience) -> Ending | None:
        """Render a frame and record it; None if it is."""
        session = self._around.sessions.adopt(work.task, work.directory, patience)
        try:
            ending = await self._render(session)
            if ending is None:
                ending = await self._deliver(work, session)
            else:  # nobody looks for the image where it is made
                ending = replace(ending, message=ending.message.replace(str(work.made), str(work.target)))
        finally:
            self._session = None
            session.forget_pixels()
        # Not if we are cancelled: what was staged is for the next server to look at.
        with contextlib.suppress(TimeoutError):
            await _in_time(partial(shutil.rmtree, work.directory, ignore_errors=True), _TIDYING)
        return ending

    async def _files_of_bundle(self) -> Path | None:
        digest = bundle_of(self.claim)
        if not digest:
            return None
        if self._around.bundles is None:
            raise BlobsMissingError("this server keeps no uploads", [digest])
        laying_out = asyncio.ensure_future(self._around.bundles.materialise(digest))
        stopped = asyncio.create_task(self._stopped.wait())
        try:
            await asyncio.wait({laying_out, stopped}, timeout=_BUNDLE_PATIENCE, return_when=asyncio.FIRST_COMPLETED)
            if self._stop is not None:
                return None  # and nobody will miss them
            if not laying_out.done():
                raise StorageError(f"the uploaded stage was not laid out within {_BUNDLE_PATIENCE:g} s")
            return laying_out.result()
        finally:
            stopped.cancel()
            laying_out.cancel()

    async def _parts(self, frame: int) -> tuple[Frame, ...] | Ending:
        """What a merge merges; nothing for other tasks."""
        if self.claim.task.kind is not TaskKind.MERGE:
            return ()
        needed = self.claim.needs_from
        made = await insist(lambda: self._around.queue.parts(self.claim.task.job, needed))
        parts = {part.task: part for part in made if part.frame == frame}
        if missing := [f"task {number}" for number in needed if number not in parts]:
            return Ending(ExitClass.SCENE, f"there is nothing to merge of {', '.join(missing)}")
        return tuple(parts[number] for number in needed)

    async def _render(self, session: Session) -> Ending | None:
        """See a session to its end; None if there is a result."""
        self._session = session
        session.listener = self._hear
        self._course = asyncio.create_task(session.run(self._source()), name=session.name)
        if self._stop is not None:  # asked while the frame was prepared
            self._stop_session()
        try:
            await asyncio.wait({self._course})
        finally:
            if not self._course.done():  # we are cancelled: the server goes at once
                self._course.cancel()
                await asyncio.wait({self._course})
        self._peak = max(self._peak, session.peak_memory)
        for line in session.last_words.splitlines():
            self._log.say(f"worker: {line}")
        return ending_of(session.render, session.failure, self._stop)

    def _stop_session(self) -> None:
        if self._session is not None and self._course is not None:
            waits = not self._session.taken_up
            self._session.cancel(keep=False)
            if waits:
                self._course.cancel()

    # --- their results ---

    async def _deliver(self, work: Assignment, session: Session) -> Ending | None:
        """Have the result on disk and in the queue; None if it is.

        A crash after any line here leaves what the next server can tell apart: see recovery.py.
        """
        attempt, queue = self.claim.attempt, self._around.queue
        try:
            # The server's own files are for nobody else; images that were asked for are.
            mode = None if work.ours else self._around.settings.output_mode
            sealed = await _in_time(partial(seal, work.made, mode), _FILE_PATIENCE)
            frame = Frame(
                job=attempt.job,
                layer=self.claim.task.layer,
                frame=work.frame,
                path=str(work.target),
                sha256=sealed.sha256,
                size_bytes=sealed.size_bytes,
                task=attempt.task,
                attempt=attempt.number,
                stats=session.render.stats.SerializeToString(),
            )
            for made, target in work.extras:
                await _in_time(partial(copy_in_place, made, target), _FILE_PATIENCE)
            if not await insist(lambda: queue.stage_frame(attempt, frame, str(work.made))):
                return self._stop or _FENCED
            try:
                await _in_time(partial(put_in_place, work.made, work.target), _FILE_PATIENCE)
            except OSError:
                await insist(lambda: queue.unstage(StagedFrame(attempt, frame, str(work.made))))
                raise
            if not await insist(lambda: queue.commit_frame(attempt, frame)):
                return self._stop or _FENCED
            self._count(session.render.stats)
        except OSError as error:
            return Ending(ExitClass.OUTPUT, why(error, work.target))
        session.move_files(work.target, dict(work.extras).get(session.png_path, session.png_path))
        self._log.say(f"frame {work.frame}: {work.target}, {sealed.size_bytes} bytes, sha256 {sealed.sha256}")
        return None

    def _count(self, stats: stats_pb2.RenderStats) -> None:
        """Note what was recorded. A merge takes no samples; its stats are those of what it merged."""
        meter, merges = self._around.meter, self.claim.task.kind is TaskKind.MERGE
        if meter is None:
            return
        if not merges:
            meter.count_work(stats)
        if merges or not is_part(job_pb2.LayerSpec.FromString(self.claim.layer_spec), self.claim.task):
            meter.count_frame()

    def _hear(self, render: render_pb2.Render) -> None:
        """Note what a session says of itself."""
        state = render_pb2.RenderState.Name(render.state).removeprefix("RENDER_STATE_").lower()
        line = f"frame {self._frame}: {state}"
        match render.state:
            case render_pb2.RENDER_STATE_RENDERING:
                spec = render.spec
                line += f" {spec.camera_path} at {spec.width}x{spec.height}, {spec.spp} samples per pixel"
            case render_pb2.RENDER_STATE_SUCCEEDED:
                line += f" after {render.stats.seconds.total:.2f} s, {render.stats.peak_memory_bytes / 2**20:.0f} MB"
            case render_pb2.RENDER_STATE_FAILED:
                line += f": {render.failure.message}"
        self._log.say(line)


async def _in_time(work: Callable[[], T], seconds: float) -> T:
    """File work on a thread. Raises OSError; TimeoutError, which is one, if it takes longer."""
    async with asyncio.timeout(seconds):
        return await asyncio.to_thread(work)


def _listed(frames: Sequence[int]) -> str:
    return ", ".join(map(str, frames[:8])) + (f" and {len(frames) - 8} more" if len(frames) > 8 else "")
