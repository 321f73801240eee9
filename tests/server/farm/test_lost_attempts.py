"""A task never stays RUNNING with nobody at it, whatever went wrong on the way; and who waits for it can be stopped."""

import asyncio
from pathlib import Path

import pytest

from footlight_server.farm.dispatcher import Farm
from footlight_server.farm.model import Attempt, Ending, ExitClass, JobState, Lane, Task
from footlight_server.farm.queue import Queue
from tests.server.farm.farm import Place
from tests.server.farm.jobs import a_job


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


async def test_a_claim_that_nobody_runs_is_made_ready_again(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight_server.farm.dispatcher._COMPARING", 0.0)
    async with place.farm() as farm:
        await farm.farm.drain(0.0)
        job = await farm.submit(place.job(frames="1"))
        lane = Lane("gone/1", "gone")
        assert await farm.queue.claim(lane, [lane]) is not None
        farm.farm._stopping = False
        farm.farm._loop = asyncio.create_task(farm.farm._dispatch())
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        assert [attempt.exit_class for attempt in await farm.attempts(job)] == [ExitClass.LOST, ExitClass.SUCCEEDED]


async def test_an_end_that_cannot_be_recorded_frees_the_lane_and_the_task(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("footlight_server.farm.dispatcher._COMPARING", 0.0)
    finish, tries = Queue.finish, []

    async def fault(queue: Queue, attempt: Attempt, ending: Ending) -> Task | None:
        tries.append(ending)
        if len(tries) == 1:
            raise OverflowError("Python int too large to convert to SQLite INTEGER")
        return await finish(queue, attempt, ending)

    monkeypatch.setattr(Queue, "finish", fault)
    place.lanes = 1
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1"))
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        assert [attempt.exit_class for attempt in await farm.attempts(job)] == [ExitClass.LOST, ExitClass.SUCCEEDED]
        assert farm.farm.running() == []


async def test_a_log_that_hangs_does_not_hold_the_attempt(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight_server.farm.attempt._TIDYING", 0.2)

    async def hang(_: object) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr("footlight_server.farm.logs.AttemptLog.flush", hang)
    async with place.farm() as farm:
        assert isinstance(farm.farm, Farm)
        await farm.render(place.job(frames="1"))


@pytest.mark.parametrize("turns", range(5))
async def test_a_cancellation_that_meets_an_answer_is_not_lost(place: Place, turns: int) -> None:
    """`asyncio.wait_for` of Python 3.11 returns the answer then, and whoever was cancelled goes on for ever."""
    queue = await place.open_queue()
    number = (await queue.create_job(a_job())).number
    loop = asyncio.get_running_loop()
    answers: list[asyncio.Future[int]] = []

    def at_once(*_: object) -> "asyncio.Future[int]":
        answers.append(loop.create_future())
        return answers[-1]

    queue._start_write = at_once  # type: ignore[method-assign,assignment]

    async def ask() -> None:
        while True:
            await queue.cancel(number)

    asking = asyncio.create_task(ask())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    answers[0].set_result(1)
    for _ in range(turns):
        await asyncio.sleep(0)
    asking.cancel()
    await asyncio.wait({asking}, timeout=2)
    assert asking.cancelled()
    await queue.close()
