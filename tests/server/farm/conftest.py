"""Queues on both databases."""

from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from footlight_server.farm.queue import Queue
from tests.server.farm.databases import Postgres, a_server
from tests.server.farm.jobs import Clock


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    with a_server() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of a database without jobs, of either kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/queue.db"
    server: Postgres = request.getfixturevalue("postgres")
    return server.emptied_database()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
async def queue(database_url: str, clock: Clock) -> AsyncIterator[Queue]:
    opened = await Queue.open(database_url, clock)
    yield opened
    await opened.close()
