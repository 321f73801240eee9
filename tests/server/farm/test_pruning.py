"""Jobs that are forgotten leave nothing behind, wherever a crash comes between; and nothing else is ever removed."""

from pathlib import Path

import pytest

from footlight_server.farm.model import Selection
from footlight_server.farm.places import Places
from footlight_server.farm.pruning import finish_pruning, prune
from footlight_server.farm.queue import Queue
from footlight_server.sessions.errors import JobNotEndedError, JobNotFoundError, StorageError
from tests.server.farm.jobs import a_job, run_all


async def ended_jobs(queue: Queue, places: Places, count: int) -> list[int]:
    numbers = [(await queue.create_job(a_job(frames=1))).number for _ in range(count)]
    await run_all(queue)
    for number in numbers:
        log = places.log(number, 1, 1)
        log.parent.mkdir(parents=True)
        log.write_text("x" * 100)
    return numbers


def kept(places: Places) -> list[str]:
    return sorted(path.name for path in (places.data / "jobs").iterdir())


async def test_jobs_go_with_their_files(queue: Queue, tmp_path: Path) -> None:
    places = Places(tmp_path / "data")
    numbers = await ended_jobs(queue, places, 25)
    assert await prune(queue, places, numbers[:-1]) == 24 * 100
    assert kept(places) == [str(numbers[-1])]
    assert [job.number for job in await queue.jobs(100)] == numbers[-1:]


async def test_a_job_that_has_not_ended_stays_as_it_is(queue: Queue, tmp_path: Path) -> None:
    places = Places(tmp_path / "data")
    (number,) = await ended_jobs(queue, places, 1)
    waiting = (await queue.create_job(a_job())).number
    with pytest.raises(JobNotEndedError):
        await prune(queue, places, [number, waiting])
    assert kept(places) == [str(number)]


async def test_the_next_start_ends_what_a_crash_interrupted(
    queue: Queue, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = Places(tmp_path / "data")
    forgotten, not_yet, other = await ended_jobs(queue, places, 3)

    async def crash(_: object) -> None:
        raise StorageError("killed")

    with monkeypatch.context() as patched:
        patched.setattr(queue, "prune", crash)
        for number in (forgotten, not_yet):
            with pytest.raises(StorageError):
                await prune(queue, places, [number])
    await queue.prune([forgotten])
    assert str(forgotten) in kept(places)
    await finish_pruning(queue, places)
    assert kept(places) == sorted(map(str, (not_yet, other)))
    with pytest.raises(JobNotFoundError):
        await queue.job(forgotten)
    await queue.retry(not_yet, Selection())


async def test_a_server_with_the_wrong_database_removes_nothing(queue: Queue, tmp_path: Path) -> None:
    places = Places(tmp_path / "data")
    log = places.log(77, 1, 1)
    log.parent.mkdir(parents=True)
    log.write_text("of a job that this database never knew")
    await finish_pruning(queue, places)
    assert log.exists()
