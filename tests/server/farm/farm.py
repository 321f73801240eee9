"""A farm as the server has it, with a real queue and real workers, in the test's own process."""

import asyncio
import contextlib
import hashlib
import os
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from google.protobuf.message import Message

from footlight.v1 import job_pb2, render_pb2
from footlight_server.api.job_spec import complete_job
from footlight_server.farm.attempt import BundleFiles
from footlight_server.farm.dispatcher import Farm
from footlight_server.farm.executor import Executor
from footlight_server.farm.local import LocalExecutor
from footlight_server.farm.model import Attempt, Job, JobState, Task
from footlight_server.farm.plan import Submission, plan_job
from footlight_server.farm.queue import Queue
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from tests.server.api.service import STAGE

T = TypeVar("T")

# More samples than any test waits for.
ENDLESS = 1 << 20


@dataclass
class Place:
    """Folders of a test's server, which may be started again in them; and what its jobs render."""

    root: Path
    patience: Patience = field(default_factory=Patience)
    environment: Collection[str] = ()
    lanes: int = 2
    output_roots: tuple[Path, ...] = ()
    clock: Callable[[], float] = time.time

    def __post_init__(self) -> None:
        for folder in (self.data, self.scratch, self.out):
            folder.mkdir(exist_ok=True)
        self.stage.write_text(STAGE)

    @property
    def data(self) -> Path:
        return self.root / "data"

    @property
    def scratch(self) -> Path:
        return self.root / "scratch"

    @property
    def out(self) -> Path:
        return self.root / "out"

    @property
    def stage(self) -> Path:
        return self.root / "stage.usda"

    @property
    def settings(self) -> Settings:
        return Settings(
            workers=1,
            roots=(),
            scratch=self.scratch,
            worker_memory=0,
            patience=self.patience,
            private=True,
            data=self.data,
            output_roots=self.output_roots,
            database=f"sqlite:///{self.data / 'queue.db'}",
        )

    async def open_queue(self) -> Queue:
        return await Queue.open(self.settings.database, self.clock)

    @contextlib.asynccontextmanager
    async def farm(
        self, executor: Executor | None = None, bundles: BundleFiles | None = None
    ) -> AsyncIterator["Running"]:
        """A server's farm; its end is that of a server that is told to stop."""
        settings, queue = self.settings, await self.open_queue()
        sessions = Sessions(settings)
        executor = executor or LocalExecutor(self.lanes, 0)
        farm = Farm(settings, queue, sessions, executor, bundles, clock=self.clock)
        try:
            await farm.start()
            yield Running(self, queue, sessions, farm)
        finally:
            await farm.close()
            await sessions.close()
            await queue.close()

    def job(self, *, frames: str = "1-3", output: str | None = None, **options: object) -> job_pb2.JobSpec:
        """A job of one small layer; options by their names in RenderSpec, LayerSpec or JobSpec."""
        render = render_pb2.RenderSpec(stage_path=str(self.stage), width=24, height=16, spp=2, max_depth=2, threads=1)
        layer = job_pb2.LayerSpec(frames=frames, output=str(self.out / "a.####.exr") if output is None else output)
        job = job_pb2.JobSpec(layers=[layer])
        for name, value in options.items():
            message = next(m for m in (render, job.layers[0], job) if name in m.DESCRIPTOR.fields_by_name)
            if isinstance(value, Message):
                getattr(message, name).CopyFrom(value)
            elif isinstance(value, list | tuple):
                getattr(message, name).extend(value)
            elif isinstance(value, dict):
                getattr(message, name).update(value)
            else:
                setattr(message, name, value)
        job.layers[0].render.CopyFrom(render)
        return job


@dataclass
class Running:
    """A farm that runs."""

    place: Place
    queue: Queue
    sessions: Sessions
    farm: Farm

    async def submit(self, spec: job_pb2.JobSpec) -> int:
        """The number of a new job."""
        checked = complete_job(spec, self.place.environment, ())
        return (await self.queue.create_job(plan_job(Submission(checked.spec, checked.frames, "ann")))).number

    async def end(self, job: int, within: float = 60.0) -> Job:
        """The job once it has ended."""
        return await self.until(lambda: self.queue.job(job), lambda job: job.state.ended, within)

    async def render(self, spec: job_pb2.JobSpec) -> int:
        """A job that has succeeded."""
        job = await self.submit(spec)
        ended = await self.end(job)
        assert ended.state is JobState.SUCCEEDED, [task.last_attempt for task in await self.queue.tasks(job, 100)]
        return job

    async def until(self, look: Callable[[], Awaitable[T]], good: Callable[[T], bool], within: float = 60.0) -> T:
        """What `look` finds once it is good; looked at after each change of the queue."""
        async with asyncio.timeout(within):
            while True:
                seen = self.queue.changed.count
                found = await look()
                if good(found):
                    return found
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self.queue.changed.wait(seen), 1.0)

    async def task(self, job: int, number: int = 1) -> Task:
        return await self.queue.task(job, number)

    async def attempts(self, job: int, task: int = 1) -> list[Attempt]:
        return await self.queue.attempts(job, task)

    async def rendering(self, job: int, within: float = 30.0) -> str:
        """The name of the render of a job's attempt, once samples are being taken."""
        async with asyncio.timeout(within):
            while True:
                for running in self.farm.running(job):
                    if running.progress is not None and running.progress.samples_done > 0:
                        return running.render
                await asyncio.sleep(0.02)

    def log(self, job: int, task: int = 1, attempt: int = 1) -> str:
        return self.farm.log_path(job, task, attempt).read_text()


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def leftovers(place: Place) -> list[Path]:
    """Workspaces and temporary files that nobody has removed."""
    return [path for folder in (place.out, place.data) for path in folder.rglob(".*")]


def workers() -> list[int]:
    """Process ids of workers that this process has started."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                if parent == os.getpid() and b"workers.child" in (entry / "cmdline").read_bytes():
                    found.append(int(entry.name))
            except OSError:
                continue
    return found
