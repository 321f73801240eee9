"""A stage that is not trusted may have taken its worker over: nothing that it says harms more than its own render."""

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from footlight.v1 import render_pb2, report_pb2, stats_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.farm.endings import ending_of
from footlight_server.farm.model import ExitClass
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.session import Session
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from footlight_server.workers.failure import Failure, FailureReason
from footlight_server.workers.film import Film, FilmShape, Plane, create_film, open_film
from footlight_server.workers.process import WorkerGoneError


class Liar:
    """A worker, and where it comes from: says what the test wants, then goes."""

    pid = 0
    alive = True
    peak_memory = 0
    last_words = ""

    def __init__(self, *events: worker_pb2.WorkerEvent) -> None:
        self.versions: dict[str, str] = {}
        self._events = list(events)

    async def take(self, task: worker_pb2.Task) -> "Liar":
        del task
        return self

    def prepare(self) -> None: ...

    def prepare_spare(self) -> None: ...

    async def send(self, request: worker_pb2.WorkerRequest) -> None: ...

    async def receive(self) -> worker_pb2.WorkerEvent:
        if not self._events:
            raise WorkerGoneError(Failure(FailureReason.CRASHED, "gone"))
        return self._events.pop(0)

    def open_film(self, message: worker_pb2.Film) -> Film:
        planes = tuple(Plane(aov.name, aov.channels, aov.offset) for aov in message.aovs)
        _, descriptor = create_film(FilmShape(1, 1, (Plane("color", 3, 0),)))
        return open_film(FilmShape(message.width, message.height, planes), descriptor)

    def kill(self) -> None: ...

    async def close(self) -> None: ...


async def told(
    tmp_path: Path, *events: worker_pb2.WorkerEvent, heard: Callable[[render_pb2.Render], None] | None = None
) -> Session:
    """A session that has heard these events; `heard` is told of its states."""
    settings = Settings(workers=1, roots=(), scratch=tmp_path, worker_memory=0, patience=Patience(), private=True)
    sessions = Sessions(settings)
    session = sessions.adopt(worker_pb2.Task(), tmp_path / "work", Patience())
    session.listener = heard
    async with asyncio.timeout(20):
        await session.run(Liar(*events))
        await sessions.close()
    return session


async def test_numbers_that_no_database_holds_are_cut(tmp_path: Path) -> None:
    stats = stats_pb2.RenderStats(peak_memory_bytes=2**64 - 1)
    session = await told(tmp_path, worker_pb2.WorkerEvent(done=worker_pb2.Done(stats=stats, has_image=True)))
    assert session.peak_memory == 2**63 - 1


async def test_words_are_bounded(tmp_path: Path) -> None:
    long = "x" * (5 << 20)
    report = report_pb2.StageReport(remarks=[report_pb2.Remark(message=long)])
    failed = render_pb2.Failure(reason=render_pb2.FAILURE_REASON_SCENE, message=long, prim_path=long)
    session = await told(
        tmp_path,
        worker_pb2.WorkerEvent(opened=worker_pb2.Opened(report=report)),
        worker_pb2.WorkerEvent(failed=failed),
    )
    assert session.failure is not None
    assert session.render.ByteSize() < 20_000
    assert "left out" in session.render.report.remarks[0].message


@pytest.mark.parametrize(
    ("width", "height", "planes"),
    [
        (1 << 31, 1 << 31, (("color", 0),)),
        (0, 5, (("color", 3),)),
        (1, 1, (("color", 1 << 30),)),
        (1, 1, tuple((f"a{n}", 1) for n in range(1000))),
    ],
)
async def test_a_film_that_no_image_has_fails_the_render(
    tmp_path: Path, width: int, height: int, planes: Sequence[tuple[str, int]]
) -> None:
    film = worker_pb2.Film(width=width, height=height)
    for name, channels in planes:
        film.aovs.add(name=name, channels=channels)
    session = await told(tmp_path, worker_pb2.WorkerEvent(film=film))
    assert session.failure is not None
    assert session.failure.reason is FailureReason.INTERNAL


async def test_a_render_only_goes_forward(tmp_path: Path) -> None:
    """Each state is kept for every viewer until it is read."""
    film = worker_pb2.WorkerEvent(film=worker_pb2.Film(width=1, height=1, aovs=[{"name": "color", "channels": 3}]))
    writing = worker_pb2.WorkerEvent(writing=worker_pb2.Writing())
    states: list[str] = []
    await told(
        tmp_path,
        *[film, writing] * 100,
        heard=lambda render: states.append(render_pb2.RenderState.Name(render.state).removeprefix("RENDER_STATE_")),
    )
    assert states == ["OPENING", "RENDERING", "WRITING", "FAILED"]


@pytest.mark.parametrize("cancelled", [True, False])
async def test_an_end_without_an_image_counts_as_a_failure(tmp_path: Path, cancelled: bool) -> None:
    """Were it taken for a cancellation, the task would be tried again for ever."""
    session = await told(tmp_path, worker_pb2.WorkerEvent(done=worker_pb2.Done(cancelled=cancelled)))
    ending = ending_of(session.render, session.failure, None)
    assert ending is not None
    assert ending.exit_class is ExitClass.CRASH
