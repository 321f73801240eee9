"""What is not the farm's doing: a locked database, a clock that is set, lanes that come and go."""

import asyncio
import sqlite3
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from footlight_server.farm.local import LocalExecutor
from footlight_server.farm.model import ExitClass, JobState, Lane, TaskState
from footlight_server.sessions.errors import StorageError
from footlight_server.workers.pool import WorkerPool
from footlight_server.workers.source import WorkerSource
from tests.server.farm.farm import ENDLESS, Place, digest, leftovers
from tests.server.farm.jobs import a_job


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


async def test_a_locked_database_delays_and_loses_nothing(place: Place) -> None:
    """Longer than SQLite waits by itself, while a frame is rendered, its result recorded and the next one claimed."""
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-2", chunk=2, width=96, height=64, spp=400))
        await farm.rendering(job)
        with sqlite3.connect(place.data / "queue.db", isolation_level=None) as other:
            other.execute("BEGIN IMMEDIATE")
            await asyncio.sleep(7)
            other.execute("ROLLBACK")
        other.close()
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        assert len(await farm.attempts(job)) == 1
        for frame in await farm.queue.frames(job, 10):
            assert frame.sha256 == digest(Path(frame.path))
        assert leftovers(place) == []


async def test_calls_do_not_wait_for_a_lock_one_after_the_other(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute's backlog would be a minute in which nobody is told anything, and then too late."""
    monkeypatch.setattr("footlight_server.farm.sql.engines.LOCK_PATIENCE", 500)
    queue = await place.open_queue()
    number = (await queue.create_job(a_job())).number
    with sqlite3.connect(place.data / "queue.db", isolation_level=None) as other:
        other.execute("BEGIN IMMEDIATE")
        begun = time.monotonic()
        answers = await asyncio.gather(*(queue.pause(number) for _ in range(30)), return_exceptions=True)
        assert [type(answer) for answer in answers] == [StorageError] * 30
        assert time.monotonic() - begun < 5
        other.execute("ROLLBACK")
    other.close()
    assert (await queue.pause(number)).paused
    await queue.close()


@dataclass
class SetClock:
    """The wall clock of a machine whose administrator sets it."""

    offset: float = 0.0

    def __call__(self) -> float:
        return time.time() + self.offset


@pytest.mark.parametrize("jump", [-86400.0, 86400.0])
async def test_a_clock_that_is_set_neither_loses_tasks_nor_starts_a_storm(place: Place, jump: float) -> None:
    clock = SetClock()
    place.clock = clock
    async with place.farm() as farm:
        place.out.rmdir()  # an output failure, which is tried again after a pause
        job = await farm.submit(place.job(frames="1", retries=5))
        await farm.until(lambda: farm.task(job), lambda task: task.failures == 1)
        clock.offset = jump
        await farm.until(lambda: farm.task(job), lambda task: task.failures == 2, within=15)
        place.out.mkdir()
        assert (await farm.end(job, within=30)).state is JobState.SUCCEEDED
        attempts = await farm.attempts(job)
        assert len(attempts) == 3
        assert all(attempt.ended is not None and attempt.ended >= attempt.started for attempt in attempts)
        after = await farm.submit(place.job(frames="2", spp=ENDLESS))
        await farm.rendering(after)
        clock.offset = -jump
        await asyncio.sleep(0.5)
        assert (await farm.task(after)).state is TaskState.RUNNING


@dataclass
class Nodes:
    """An executor whose lanes are put in and taken out."""

    there: list[Lane] = field(default_factory=list)
    pool: WorkerPool = field(default_factory=lambda: WorkerPool(0, spare=False))
    event: asyncio.Event = field(default_factory=asyncio.Event)

    def lanes(self) -> Sequence[Lane]:
        return list(self.there)

    def source(self, lane: Lane) -> WorkerSource:
        assert lane in self.there
        return self.pool

    def changed(self) -> asyncio.Event:
        return self.event

    def set(self, *lanes: Lane) -> None:
        self.there = list(lanes)
        self.event.set()

    async def start(self) -> None:
        """They come later."""

    async def close(self) -> None:
        await self.pool.close()


async def test_lanes_that_come_are_used_at_once_and_those_that_went_are_not(place: Place) -> None:
    first, second = Lane("a/1", "a"), Lane("b/1", "b")
    nodes = Nodes()
    async with place.farm(nodes) as farm:
        job = await farm.submit(place.job(frames="1-6"))
        await asyncio.sleep(0.3)
        assert (await farm.queue.job(job)).state is JobState.QUEUED
        nodes.set(first)
        await farm.until(lambda: farm.queue.frames(job, 10), bool, within=15)
        nodes.set(second)
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        used = [attempt.worker for n in range(1, 7) for attempt in await farm.attempts(job, n)]
        assert used == sorted(used)
        assert set(used) == {"a/1", "b/1"}


async def test_a_farm_without_lanes_waits(place: Place) -> None:
    async with place.farm(LocalExecutor(0, 0)) as farm:
        job = await farm.submit(place.job(frames="1"))
        await asyncio.sleep(0.3)
        assert (await farm.queue.job(job)).state is JobState.QUEUED
        assert farm.farm.lanes() == ()


async def test_nothing_is_asked_of_the_queue_while_nothing_happens(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-3", spp=ENDLESS))
        await farm.rendering(job)
        await asyncio.sleep(0.5)
        asked: list[str] = []
        for name in ("claim_many", "orders", "next_wake"):
            real = getattr(farm.queue, name)

            async def counting(*arguments: object, name: str = name, real: object = real) -> object:
                asked.append(name)
                return await real(*arguments)  # type: ignore[operator]

            monkeypatch.setattr(farm.queue, name, counting)
        await asyncio.sleep(2)
        assert asked == []
        await farm.queue.cancel(job)
        assert (await farm.end(job, within=10)).state is JobState.CANCELLED
        assert {a.exit_class for n in (1, 2) for a in await farm.attempts(job, n)} == {ExitClass.CANCELLED}


async def test_a_delayed_task_is_taken_up_when_it_is_due(place: Place) -> None:
    """Again and again: a moment too early, or between two questions, and it would wait for the next event."""
    async with place.farm() as farm:
        place.out.rmdir()
        job = await farm.submit(place.job(frames="1-4"))
        await farm.until(lambda: farm.queue.tasks(job, 10), lambda tasks: all(task.failures > 1 for task in tasks), 20)
        await farm.queue.cancel(job)
        for number in range(1, 5):
            first, second, *_ = await farm.attempts(job, number)
            assert first.ended is not None
            assert 1.0 <= second.started - first.ended < 6.0, "the pause after a first failure, and two lanes for four"
