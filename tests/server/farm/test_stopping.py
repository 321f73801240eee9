"""Orders to stop: of a job, of a task, of the server."""

import asyncio
from pathlib import Path

import pytest

from footlight_server.farm.model import ExitClass, JobState, Selection, TaskState
from footlight_server.sessions.errors import RenderNotFoundError
from tests.server.farm.farm import ENDLESS, Place, leftovers, workers


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


async def test_cancelling_a_job_stops_what_runs(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-3", spp=ENDLESS))
        name = await farm.rendering(job)
        with pytest.raises(RenderNotFoundError):
            farm.sessions.cancel(name, keep=False)
        assert farm.farm.attempt(job, 1) is not None
        await farm.queue.cancel(job)
        assert (await farm.end(job, within=10)).state is JobState.CANCELLED
        assert {a.exit_class for n in (1, 2) for a in await farm.attempts(job, n)} == {ExitClass.CANCELLED}
        async with asyncio.timeout(5):  # the queue says it first
            while farm.farm.running():
                await asyncio.sleep(0.02)
        assert list(place.out.iterdir()) == []


async def test_skipping_a_task_stops_it_and_lets_the_others_go_on(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-2", spp=ENDLESS))
        await farm.rendering(job)
        await farm.queue.skip(job, Selection(tasks=frozenset({1})))
        await farm.until(lambda: farm.task(job, 1), lambda task: task.state is TaskState.SKIPPED, within=10)
        assert (await farm.task(job, 2)).state is TaskState.RUNNING


async def test_being_told_to_stop_is_no_failure_and_the_next_server_goes_on(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-2", chunk=2, width=96, height=64, spp=1500))
        await farm.until(lambda: farm.queue.frames(job, 10), lambda frames: len(frames) == 1)
        done = (place.out / "a.0001.exr").stat().st_mtime_ns
        await farm.rendering(job)
        await farm.farm.drain(0.1)
        task = await farm.task(job)
        assert (task.state, task.failures) == (TaskState.READY, 0)
        assert task.last_attempt is not None
        assert task.last_attempt.exit_class is ExitClass.PREEMPTED
    assert workers() == []
    async with place.farm() as farm:
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        assert (place.out / "a.0001.exr").stat().st_mtime_ns == done
        assert leftovers(place) == []


async def test_draining_lets_what_is_nearly_done_come_to_its_end(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-20"))
        await farm.until(farm.queue.running, lambda _: bool(farm.farm.running()))
        await farm.farm.drain(30)
        ended = [attempt for n in range(1, 21) for attempt in await farm.attempts(job, n)]
        assert 0 < len(ended) < 20
        assert {attempt.exit_class for attempt in ended} == {ExitClass.SUCCEEDED}
        await asyncio.sleep(0.3)
        assert await farm.queue.running() == []
