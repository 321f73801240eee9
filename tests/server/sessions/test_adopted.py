"""The farm's sessions beside those of clients: watched like any render, and in nobody's way."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from footlight.v1 import render_pb2
from footlight_server.sessions.encoding import Encoding
from footlight_server.sessions.errors import RenderNotFoundError
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.session import Session
from footlight_server.sessions.sessions import Sessions
from footlight_server.sessions.tasks import make_task
from footlight_server.settings import Settings
from footlight_server.workers.failure import FailureReason
from footlight_server.workers.pool import WorkerPool
from tests.server.api.service import STAGE


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(workers=1, roots=(), scratch=tmp_path, worker_memory=0, patience=Patience(), private=True)


@pytest.fixture
async def sessions(settings: Settings) -> AsyncIterator[Sessions]:
    sessions = Sessions(settings)
    yield sessions
    await sessions.close()


@pytest.fixture
async def pool() -> AsyncIterator[WorkerPool]:
    pool = WorkerPool(0, spare=False)
    yield pool
    await pool.close()


@pytest.fixture
def spec(tmp_path: Path) -> render_pb2.RenderSpec:
    path = tmp_path / "stage.usda"
    path.write_text(STAGE)
    spec = render_pb2.RenderSpec(stage_path=str(path), width=32, height=32, spp=2, max_depth=2)
    spec.pixel_filter, spec.strategy = render_pb2.PIXEL_FILTER_BOX, render_pb2.STRATEGY_MIS
    return spec


def adopt(sessions: Sessions, settings: Settings, spec: render_pb2.RenderSpec, name: str) -> Session:
    directory = settings.scratch / name
    return sessions.adopt(make_task(spec, settings, directory), directory, settings.patience)


async def test_it_is_watched_by_its_name_but_is_in_no_list(
    sessions: Sessions, settings: Settings, spec: render_pb2.RenderSpec, pool: WorkerPool
) -> None:
    session = adopt(sessions, settings, spec, "a")
    heard: list[int] = []
    session.listener = lambda render: heard.append(render.state)
    shown: list[object] = []

    async def watch() -> None:
        with sessions.get(session.name).viewing(["color"], Encoding.FLOAT, 8, 0) as viewer:
            while (item := await viewer.next()) is not None:
                shown.append(item)

    watching = asyncio.create_task(watch())
    async with asyncio.timeout(60):
        await session.run(pool)
        await watching
    states = [render_pb2.RENDER_STATE_OPENING, render_pb2.RENDER_STATE_RENDERING]
    assert heard == [*states, render_pb2.RENDER_STATE_WRITING, render_pb2.RENDER_STATE_SUCCEEDED]
    assert any(getattr(item, "tiles", None) for item in shown)
    assert session.peak_memory > 1 << 20
    assert session.exr_path.is_file()
    assert sessions.page(100, None).renders == []


async def test_clients_cannot_cancel_it_and_it_takes_no_slot(
    sessions: Sessions, settings: Settings, spec: render_pb2.RenderSpec, pool: WorkerPool
) -> None:
    spec.spp = 1 << 20
    endless = adopt(sessions, settings, spec, "endless")
    course = asyncio.create_task(endless.run(pool))
    with pytest.raises(RenderNotFoundError, match="cancel the job"):
        sessions.cancel(endless.name, keep=False)
    spec.spp = 1
    mine = sessions.create(spec, "")
    async with asyncio.timeout(60):
        while not mine.ended:
            await asyncio.sleep(0.05)
    assert mine.render.state == render_pb2.RENDER_STATE_SUCCEEDED
    assert not endless.ended
    endless.cancel(keep=False)
    async with asyncio.timeout(10):
        await course
    assert endless.render.state == render_pb2.RENDER_STATE_CANCELLED


async def test_many_of_them_crowd_out_no_render_of_a_client(
    sessions: Sessions, settings: Settings, spec: render_pb2.RenderSpec
) -> None:
    mine = sessions.create(spec, "my request")
    farm = [adopt(sessions, settings, spec, str(number)) for number in range(300)]
    assert sessions.get(farm[0].name) is farm[0], "one that runs is never forgotten"
    for session in farm:
        session.cancel(keep=False)
    last = adopt(sessions, settings, spec, "last")
    assert sessions.get(last.name) is last
    with pytest.raises(RenderNotFoundError):
        sessions.get(farm[0].name)
    assert sessions.get(mine.name) is mine
    assert sessions.create(spec, "my request") is mine
    assert [render.name for render in sessions.page(1000, None).renders] == [mine.name]


async def test_a_limit_on_the_whole_frame_ends_it(
    sessions: Sessions, settings: Settings, spec: render_pb2.RenderSpec, pool: WorkerPool
) -> None:
    spec.spp = 1 << 20
    directory = settings.scratch / "slow"
    session = sessions.adopt(make_task(spec, settings, directory), directory, Patience(total=1.0))
    async with asyncio.timeout(60):
        await session.run(pool)
    assert session.failure is not None
    assert session.failure.reason is FailureReason.TIMEOUT
    assert "limit of 1 s" in session.failure.message


async def test_a_directory_that_is_gone_is_an_output_failure(
    sessions: Sessions, settings: Settings, spec: render_pb2.RenderSpec, pool: WorkerPool
) -> None:
    session = adopt(sessions, settings, spec, "gone/deeper")
    async with asyncio.timeout(60):
        await session.run(pool)
    assert session.failure is not None
    assert session.failure.reason is FailureReason.OUTPUT
    assert not session.render.HasField("start_time")


async def test_a_page_of_renders_fits_into_a_message(sessions: Sessions, spec: render_pb2.RenderSpec) -> None:
    """However long the reports of a stage are that somebody made for that."""
    made = [sessions.create(spec, "") for _ in range(8)]
    for session in made:
        session._render.report.remarks.add(message="x" * 1_000_000)
    names, newest = [], None
    while True:
        page = sessions.page(1000, newest)
        assert sum(render.ByteSize() for render in page.renders) < 4_000_000
        names += [render.name for render in page.renders]
        if not page.next_token:
            break
        newest = int(page.next_token)
    assert names == [session.name for session in reversed(made)]
