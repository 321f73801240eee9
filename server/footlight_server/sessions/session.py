"""One render on the server: drives the state machine with what worker and clients say, and carries out its effects."""

import asyncio
import contextlib
import logging
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from google.protobuf.timestamp_pb2 import Timestamp

from footlight.v1 import render_pb2, report_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.sessions.encoding import Encoding, TileEncoder
from footlight_server.sessions.machine import (
    CancelAsked,
    DeadlinePassed,
    Effect,
    Event,
    Failed,
    Finished,
    Heard,
    Patience,
    Phase,
    RenderingBegan,
    State,
    TakenUp,
    WorkerGone,
    WritingBegan,
    step,
)
from footlight_server.sessions.tile_queue import TileVersion
from footlight_server.sessions.viewer import Viewer
from footlight_server.workers.failure import Failure, FailureReason
from footlight_server.workers.process import WorkerGoneError
from footlight_server.workers.shown import shown_message, shown_stage
from footlight_server.workers.source import Worker, WorkerSource

log = logging.getLogger(__name__)

# [s] For the file system to make a directory; for a worker to be had, which warms up on a machine that may be busy.
_MAKING = 300.0
_TAKING = 300.0
# What a worker may say of itself; a stage that is not trusted may speak through it. [characters] Of a failure; [bytes]
# of a report and of statistics, which clients take 4 MB of; what a database's integer holds.
_LONGEST_FAILURE = 4000
_LARGEST_REPORT = 2 << 20
_LARGEST_STATS = 256 << 10
_MOST_MEMORY = (1 << 63) - 1


class Session:
    """Made when a render is accepted; `run` takes it to its end."""

    def __init__(
        self,
        identifier: str,
        number: int,
        task: worker_pb2.Task,
        directory: Path,
        patience: Patience,
        encoders: ThreadPoolExecutor,
    ) -> None:
        # Counts the renders of this server.
        self.number = number
        # The client's name for the request, if it gave one.
        self.request_id = ""
        self._task = task
        self._directory = directory
        self._patience = patience
        self._encoders = encoders
        self._state = State(created=time.monotonic())
        self._worker: Worker | None = None
        # Called when the state has changed, with the render as it is then.
        self.listener: Callable[[render_pb2.Render], None] | None = None
        self._encoder: TileEncoder | None = None
        # aov -> tile -> version: what a viewer that joins has missed.
        self._shown: dict[str, dict[int, TileVersion]] = {}
        self._viewers: list[Viewer] = []
        self._talk: set[asyncio.Task[None]] = set()
        self._clock = time.time() - time.monotonic()
        self._render = render_pb2.Render(name=f"renders/{identifier}", spec=task.spec)
        self._render.spec.stage_path = shown_stage(task, task.spec)
        self._describe()

    @property
    def name(self) -> str:
        """`renders/{id}`."""
        return self._render.name

    @property
    def taken_up(self) -> bool:
        """It has a worker."""
        return self._worker is not None

    @property
    def ended(self) -> bool:
        """Nothing more will happen to it."""
        return self._state.phase.ended

    @property
    def has_image(self) -> bool:
        """There is a result to fetch."""
        return self._state.has_image

    @property
    def render(self) -> render_pb2.Render:
        """The render as it is now; a copy."""
        copy = render_pb2.Render()
        copy.CopyFrom(self._render)
        return copy

    @property
    def progress(self) -> render_pb2.Progress:
        """How far it is; a copy."""
        copy = render_pb2.Progress()
        copy.CopyFrom(self._render.progress)
        return copy

    @property
    def failure(self) -> Failure | None:
        """Why it failed; None if it did not."""
        return self._state.failure if self._state.phase is Phase.FAILED else None

    @property
    def peak_memory(self) -> int:
        """[bytes] The most its worker was seen to hold, from outside and by itself."""
        seen = self._worker.peak_memory if self._worker is not None else 0
        return min(max(seen, self._render.stats.peak_memory_bytes), _MOST_MEMORY)

    @property
    def last_words(self) -> str:
        """What its worker wrote to standard error, the end of it."""
        return self._worker.last_words if self._worker is not None else ""

    @property
    def film_bytes(self) -> int:
        """[bytes] Of pixels that are kept for viewers."""
        return self._encoder.film_bytes if self._encoder is not None else 0

    @property
    def exr_path(self) -> Path:
        """Where the image is, if there is one."""
        return Path(self._task.exr_path)

    @property
    def png_path(self) -> Path:
        """Where the picture is, if the spec asks for one and there is an image."""
        return Path(self._task.png_path)

    def move_files(self, exr: Path, png: Path) -> None:
        """The files of the result are elsewhere now."""
        self._task.exr_path, self._task.png_path = str(exr), str(png)

    # --- what clients do ---

    def cancel(self, *, keep: bool) -> None:
        """Have it end soon."""
        self._apply(CancelAsked(keep=keep))

    @contextlib.contextmanager
    def viewing(self, aovs: Iterable[str], encoding: Encoding, credit: int, max_rate: float) -> Iterator[Viewer]:
        """A viewer that is kept up to date inside the block."""
        viewer = Viewer(aovs, encoding, credit, max_rate, self._encoders)
        viewer.show_render(self.render, ended=self.ended)
        if self._encoder is not None:
            for aov, tiles in self._shown.items():
                for tile, version in tiles.items():
                    viewer.show_tiles(aov, (tile,), version, self._encoder)
        self._viewers.append(viewer)
        self._publish()
        try:
            yield viewer
        finally:
            self._viewers.remove(viewer)
            self._publish()

    def forget_pixels(self) -> None:
        """Let go of the film; viewers that join from now on get events only."""
        self._encoder = None
        self._shown.clear()

    # --- its course ---

    async def run(self, source: WorkerSource) -> None:
        """Take a worker and see the render to its end. Cancelled only when the render has ended or the server stops."""
        try:
            await self._make_directory()
            self._worker = await self._take(source)
            if not self.ended:
                await self._converse(self._worker, source)
        except WorkerGoneError as gone:
            self._apply(WorkerGone(gone.failure))
        except Exception as error:
            log.exception("%s: the server failed", self.name)
            self._apply(Failed(Failure(FailureReason.INTERNAL, f"{type(error).__name__}: {error}")))
        finally:
            if self._worker is not None:
                await self._worker.close()
            self._apply(Failed(Failure(FailureReason.INTERNAL, "the server gave up")))

    async def _make_directory(self) -> None:
        try:
            async with asyncio.timeout(_MAKING):
                await asyncio.to_thread(self._directory.mkdir, 0o700)
        except OSError as error:
            why = str(error) or "the file system does not answer"
            raise WorkerGoneError(Failure(FailureReason.OUTPUT, f"no place for the image: {why}")) from error

    async def _take(self, source: WorkerSource) -> Worker:
        try:
            async with asyncio.timeout(_TAKING):
                return await source.take(self._task)
        except TimeoutError:
            message = f"no worker was ready within {_TAKING:g} s"
            raise WorkerGoneError(Failure(FailureReason.TIMEOUT, message)) from None

    async def _converse(self, worker: Worker, source: WorkerSource) -> None:
        await worker.send(worker_pb2.WorkerRequest(task=self._task))
        self._apply(TakenUp())
        while not self.ended:
            try:
                async with asyncio.timeout_at(self._loop_time(self._state.deadline)):
                    event = await worker.receive()
            except TimeoutError:
                self._apply(DeadlinePassed())
                continue
            self._hear(event, worker)
            if event.HasField("progress"):  # not earlier: the first tiles need the processor more
                source.prepare_spare()

    def _loop_time(self, deadline: float | None) -> float | None:
        """The event loop's time for a monotonic time."""
        if deadline is None:
            return None
        return deadline - time.monotonic() + asyncio.get_running_loop().time()

    def _hear(self, event: worker_pb2.WorkerEvent, worker: Worker) -> None:
        """Take in what the worker says."""
        match event.WhichOneof("event"):
            case "opened":
                self._render.spec.CopyFrom(event.opened.spec)
                self._render.spec.stage_path = shown_stage(self._task, event.opened.spec)
                self._render.report.CopyFrom(_bounded(event.opened.report))
            case "film":
                self._encoder = TileEncoder(worker.open_film(event.film))
                self._publish()
                self._apply(RenderingBegan())
            case "tiles":
                self._show_tiles(event.tiles)
                self._apply(Heard())
            case "progress":
                self._render.progress.CopyFrom(event.progress)
                for viewer in self._viewers:
                    viewer.show_progress(event.progress)
                self._apply(Heard())
            case "writing":
                self._apply(WritingBegan())
            case "done":
                if event.done.stats.ByteSize() > _LARGEST_STATS:
                    raise ValueError(f"the worker's statistics have {event.done.stats.ByteSize()} bytes")
                self._render.stats.CopyFrom(event.done.stats)
                self._apply(Finished(has_image=event.done.has_image, cancelled=event.done.cancelled))
            case "failed":
                self._apply(Failed(_failure(event.failed)))

    def _show_tiles(self, tiles: worker_pb2.Tiles) -> None:
        if self._encoder is None or tiles.scale < 1 or not self._encoder.has(tiles.aov, tiles.indices):
            raise ValueError(f"the worker shows tiles of {tiles.aov!r} that its film does not have")
        version = TileVersion(tiles.samples, tiles.scale)
        self._shown.setdefault(tiles.aov, {}).update(dict.fromkeys(tiles.indices, version))
        for viewer in self._viewers:
            viewer.show_tiles(tiles.aov, tiles.indices, version, self._encoder)

    def _publish(self) -> None:
        """Tell the worker which AOVs are looked at."""
        if self._worker is not None and self._encoder is not None and not self.ended:
            wanted = sorted({aov for viewer in self._viewers for aov in viewer.queue.aovs})
            self._tell(worker_pb2.WorkerRequest(publish=worker_pb2.Publish(aovs=wanted)))

    def _tell(self, request: worker_pb2.WorkerRequest) -> None:
        if self._worker is not None:
            task = asyncio.create_task(self._worker.send(request))
            self._talk.add(task)
            task.add_done_callback(self._talk.discard)

    def _apply(self, event: Event) -> None:
        self._state, effects = step(self._state, event, time.monotonic(), self._patience)
        self._describe()
        for effect in effects:
            self._carry_out(effect)

    def _carry_out(self, effect: Effect) -> None:
        match effect:
            case Effect.ANNOUNCE:
                log.info("%s: %s", self.name, self._state.phase.name.lower())
                if self.listener is not None:
                    self.listener(self.render)
                for viewer in self._viewers:
                    viewer.show_render(self.render, ended=self.ended)
            case Effect.FINISH_WORKER:
                self._tell(worker_pb2.WorkerRequest(finish=worker_pb2.Finish()))
            case Effect.KILL_WORKER:
                if self._worker is not None:
                    self._worker.kill()
            case Effect.DISCARD_FILES:
                asyncio.get_running_loop().run_in_executor(None, self.discard_files)

    def discard_files(self) -> None:
        """Remove what it has on disk. Blocks."""
        shutil.rmtree(self._directory, ignore_errors=True)

    def _describe(self) -> None:
        """Bring the resource up to the state."""
        state, render = self._state, self._render
        render.state = render_pb2.RenderState.Value(f"RENDER_STATE_{state.phase.name}")
        render.has_result = state.has_image
        render.create_time.CopyFrom(self._timestamp(state.created))
        if state.started is not None:
            render.start_time.CopyFrom(self._timestamp(state.started))
        if state.ended is not None:
            render.end_time.CopyFrom(self._timestamp(state.ended))
        if state.phase.ended and state.failure is not None:
            render.failure.reason = render_pb2.FailureReason.Value(f"FAILURE_REASON_{state.failure.reason.name}")
            render.failure.message = shown_message(self._task, state.failure.message)
            render.failure.prim_path = state.failure.prim_path

    def _timestamp(self, monotonic: float) -> Timestamp:
        """Wall-clock time of a monotonic time; a clock that jumps later on does not reorder a render's times."""
        timestamp = Timestamp()
        timestamp.FromNanoseconds(int((self._clock + monotonic) * 1e9))
        return timestamp


def _failure(message: render_pb2.Failure) -> Failure:
    name = render_pb2.FailureReason.Name(message.reason).removeprefix("FAILURE_REASON_")
    reason = FailureReason.__members__.get(name, FailureReason.INTERNAL)
    return Failure(reason, message.message[:_LONGEST_FAILURE], message.prim_path[:_LONGEST_FAILURE])


def _bounded(report: report_pb2.StageReport) -> report_pb2.StageReport:
    """The report, or if it is too long for anybody to be told, one that says so."""
    if report.ByteSize() <= _LARGEST_REPORT:
        return report
    said = report_pb2.StageReport()
    said.remarks.add(message=f"the report of this stage has {report.ByteSize()} bytes and is left out")
    return said
