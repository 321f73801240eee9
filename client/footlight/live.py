"""The running frames of a job, as they converge, to a viewer."""

import asyncio
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self

from footlight.client import AsyncClient
from footlight.errors import FootlightError
from footlight.image import TileBatch
from footlight.names import short
from footlight.tev import NoViewerError
from footlight.v1 import job_pb2, render_pb2

# [s] For the last tiles of frames that are done when the job is.
LAST_TILES = 5.0


class Viewer(Protocol):
    """Shows pixels under a name."""

    async def show(self, name: str, batch: TileBatch) -> None:
        """Draw a batch. Raises NoViewerError."""

    async def close(self) -> None:
        """No more will come."""


class LiveFrames:
    """Follows every render that a job's events name; for the length of an `async with`. `say` hears what is amiss."""

    def __init__(self, client: AsyncClient, viewer: Viewer, say: Callable[[str], None]) -> None:
        self._client = client
        self._viewer = viewer
        self._say = say
        self._said = ""
        self._turn = asyncio.Lock()
        self._group = asyncio.TaskGroup()
        # Renders that were met, and the tasks that still follow one.
        self._met: set[str] = set()
        self._following: set[asyncio.Task[None]] = set()

    def event(self, event: job_pb2.JobEvent) -> None:
        """Follow the render that a task is at, if it is a new one."""
        kind = event.WhichOneof("event")
        if kind not in ("task", "progress"):
            return
        task = event.task if kind == "task" else event.progress
        render = task.last_attempt.render
        if task.state == job_pb2.TASK_STATE_RUNNING and render and render not in self._met:
            self._met.add(render)
            following = self._group.create_task(self._follow(task, render), name=f"live {render}")
            self._following.add(following)
            following.add_done_callback(self._following.discard)

    async def _follow(self, task: job_pb2.Task, render: str) -> None:
        title = f"{short(task.name)} {task.layer}"
        try:
            async for event in self._client.session(render).events(["color"]):
                if isinstance(event, render_pb2.Render) and event.spec.HasField("time_code"):
                    title = _title(task, event.spec)
                elif isinstance(event, TileBatch):
                    # One viewer, one connection. While others wait here they give no credit, and get newer tiles later.
                    async with self._turn:
                        await self._viewer.show(title, event)
        except NoViewerError as error:
            self._complain(str(error))
        except FootlightError as error:
            self._complain(f"{title} cannot be shown: {error}")

    def _complain(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self._say(text)

    async def __aenter__(self) -> Self:
        await self._group.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._following and kind is None:
                await asyncio.wait(self._following, timeout=LAST_TILES)
        finally:
            for following in self._following:
                following.cancel()
            try:
                await self._group.__aexit__(kind, error, trace)
            finally:
                await self._viewer.close()


def _title(task: job_pb2.Task, spec: render_pb2.RenderSpec) -> str:
    """`12 main 1001`, with its samples if it has a part of them only."""
    name = f"{short(task.name).partition('/')[0]} {task.layer} {spec.time_code:g}"
    whole = task.sample_end - task.sample_begin == spec.spp
    return name if whole else f"{name} samples {task.sample_begin}-{task.sample_end}"
