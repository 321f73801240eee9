"""What only PostgreSQL can do to a queue: go away, come back, and be taken over meanwhile."""

import asyncio
from collections.abc import Iterator

import pytest

from footlight_server.farm.model import TaskState
from footlight_server.farm.queue import Queue
from footlight_server.sessions.errors import DatabaseBusyError, DatabaseRefusedError, StorageError
from tests.server.farm.audit import audit
from tests.server.farm.databases import Postgres, a_server
from tests.server.farm.jobs import LANES, ONE, SUCCEEDED, a_job, claim, run_all


@pytest.fixture
def url(postgres: Postgres) -> str:
    return postgres.emptied_database()


@pytest.fixture(scope="module")
def fragile() -> Iterator[Postgres]:
    """A server that is stopped."""
    with a_server() as server:
        yield server


def terminate(postgres: Postgres) -> None:
    """Cut all connections but one's own."""
    postgres.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'footlight'")


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight_server.farm.sql.ownership.ADVISORY_PATIENCE", 0.3)


async def test_a_second_server_is_refused_and_the_first_does_not_notice(url: str) -> None:
    queue = await Queue.open(url)
    try:
        with pytest.raises(DatabaseBusyError, match="in use by another server"):
            await Queue.open(url)
        assert await queue.create_job(a_job())
    finally:
        await queue.close()
    again = await Queue.open(url)
    assert len(await again.jobs(10)) == 1
    await again.close()


async def test_connections_that_were_cut_are_made_anew_and_nobody_notices(postgres: Postgres, url: str) -> None:
    queue = await Queue.open(url)
    try:
        job = await queue.create_job(a_job())
        claimed = await claim(queue)
        terminate(postgres)
        assert await queue.finish(claimed.attempt, SUCCEEDED) is not None
        assert (await queue.task(job.number, 1)).state is TaskState.SUCCEEDED
        terminate(postgres)
        assert len(await run_all(queue)) == 2
        await audit(queue)
    finally:
        await queue.close()


async def test_who_was_cut_off_and_came_back_too_late_owns_nothing(postgres: Postgres, url: str) -> None:
    first = await Queue.open(url)
    try:
        await first.create_job(a_job())
        claimed = await claim(first)
        terminate(postgres)
        second = await Queue.open(url)
        try:
            assert await second.recover() == 1
            for _ in range(3):
                with pytest.raises(StorageError):
                    await first.finish(claimed.attempt, SUCCEEDED)
            taken = await claim(second)
            assert (taken.attempt.task, taken.attempt.number) == (1, 2)
        finally:
            await second.close()
        # It is free again, and what the first one still believes to run is not its own any more.
        assert await first.finish(claimed.attempt, SUCCEEDED) is None
    finally:
        await first.close()


async def test_a_server_that_stops_and_starts_again_loses_nothing(fragile: Postgres) -> None:
    queue = await Queue.open(fragile.new_database())
    try:
        job = await queue.create_job(a_job())
        claimed = await claim(queue)
        fragile.stop()
        for call in (queue.job(job.number), queue.finish(claimed.attempt, SUCCEEDED), queue.claim(ONE, LANES)):
            with pytest.raises(StorageError, match="the database"):
                await asyncio.wait_for(call, 30)
        fragile.start()
        assert await queue.running() == [claimed.attempt]
        assert await queue.finish(claimed.attempt, SUCCEEDED) is not None
        await audit(queue)
    finally:
        await queue.close()


async def test_a_database_that_is_not_there_is_refused(postgres: Postgres) -> None:
    with pytest.raises(DatabaseRefusedError, match="nobody_made_it"):
        await Queue.open(f"postgresql://postgres@/nobody_made_it?host={postgres.folder}")
    with pytest.raises(DatabaseRefusedError, match="cannot be opened"):
        await Queue.open("postgresql://postgres@127.0.0.1:1/queue")
