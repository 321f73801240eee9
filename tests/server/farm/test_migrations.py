"""A database of any revision becomes this program's, with a copy first; what cannot be is left as it was."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import inspect

from footlight_server.farm.queue import Queue
from footlight_server.farm.sql.database import Database
from footlight_server.farm.sql.migrate import downgrade, revision_of, upgrade
from footlight_server.farm.sql.ownership import refuse_network
from footlight_server.farm.sql.schema import metadata
from footlight_server.farm.transitions import Policy
from footlight_server.sessions.errors import DatabaseBusyError, DatabaseRefusedError, StorageError
from tests.server.farm.databases import Postgres
from tests.server.farm.jobs import a_job


@pytest.fixture(params=["sqlite", "postgresql"])
def empty_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of a database without tables."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/queue.db"
    server = request.getfixturevalue("postgres")
    assert isinstance(server, Postgres)
    return server.new_database()


def test_migrations_make_what_the_schema_says_and_unmake_it(empty_url: str) -> None:
    database = Database(empty_url, time.time, Policy())
    try:
        for _ in range(2):
            with database.connected() as connection:
                upgrade(connection)
                context = MigrationContext.configure(connection, opts={"compare_server_default": False})
                assert compare_metadata(context, metadata) == []
                assert set(inspect(connection).get_table_names()) == {*metadata.tables, "alembic_version"}
                assert indexes_of(connection) == {
                    (index.name, bool(index.unique)) for table in metadata.tables.values() for index in table.indexes
                }
            with database.connected() as connection:
                downgrade(connection, "base")
                assert inspect(connection).get_table_names() == ["alembic_version"]
    finally:
        database.close()


def indexes_of(connection: object) -> set[tuple[str | None, bool]]:
    seen = inspect(connection)
    return {
        (index["name"], bool(index["unique"]))
        for table in metadata.tables
        for index in seen.get_indexes(table)
        if not index.get("duplicates_constraint")
    }


async def test_sqlite_keeps_rows_as_the_schema_says(tmp_path: Path) -> None:
    """What the comparison above does not see."""
    await (await Queue.open(f"sqlite:///{tmp_path}/queue.db")).close()
    with sqlite3.connect(tmp_path / "queue.db") as connection:
        found = dict(connection.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall())
    for name, table in metadata.tables.items():
        options = table.dialect_options["sqlite"]
        assert ("WITHOUT ROWID" in found[name]) == (options["with_rowid"] is False)
        assert ("AUTOINCREMENT" in found[name]) == options["autoincrement"]


async def test_a_migration_that_fails_changes_nothing(empty_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from footlight_server.farm.sql import migrate

    def fail(_connection: object) -> None:
        raise OSError("the power went")

    monkeypatch.setattr(migrate, "check_integrity", fail)
    with pytest.raises(OSError, match="the power went"):
        await Queue.open(empty_url)
    database = Database(empty_url, time.time, Policy())
    with database.connected() as connection:
        assert revision_of(connection) is None
        assert inspect(connection).get_table_names() == []
    database.close()


async def test_before_a_migration_there_is_a_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"sqlite:///{tmp_path}/queue.db"
    queue = await Queue.open(url)
    await queue.create_job(a_job())
    await queue.close()
    assert not list(tmp_path.glob("*.backup"))
    # A program that knows one revision more.
    migrations = tmp_path / "migrations"
    import footlight_server.farm.sql.migrate as module

    shutil.copytree(Path(module.__file__).with_name("migrations"), migrations)
    (migrations / "versions" / "0002_more.py").write_text(
        'import sqlalchemy as sa\nfrom alembic import op\nrevision = "0002"\ndown_revision = "0001"\n'
        'def upgrade() -> None:\n    op.add_column("job", sa.Column("more", sa.Text()))\n'
    )
    monkeypatch.setattr(module, "__file__", str(tmp_path / "migrate.py"))
    again = await Queue.open(url)
    assert len(await again.jobs(10)) == 1
    await again.close()
    assert (tmp_path / "queue.db.0001.backup").stat().st_mode & 0o777 == 0o600
    with sqlite3.connect(tmp_path / "queue.db.0001.backup") as copy:
        assert copy.execute("SELECT count(*) FROM task").fetchone() == (3,)
        assert "more" not in [row[1] for row in copy.execute("PRAGMA table_info(job)")]
    # And to the one that does not know it, it is too new.
    monkeypatch.undo()
    with pytest.raises(DatabaseRefusedError, match=r"newer version \(revision 0002"):
        await Queue.open(url)


async def test_a_folder_may_have_any_name(tmp_path: Path) -> None:
    folder = tmp_path / "a?mode=ro&b #%41 ü"
    folder.mkdir()
    queue = await Queue.open(f"sqlite:///{folder}/queue.db")
    await queue.create_job(a_job())
    await queue.close()
    assert {path.name for path in folder.iterdir()} == {"queue.db", "queue.db.lock"}


async def test_only_the_owner_reads_it(tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        queue = await Queue.open(f"sqlite:///{tmp_path}/queue.db")
        await queue.create_job(a_job())
    finally:
        os.umask(old)
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
    await queue.close()
    assert modes == dict.fromkeys(("queue.db", "queue.db-wal", "queue.db-shm", "queue.db.lock"), 0o600)


async def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "queue.db"
    path.write_bytes(b"no database " * 1000)
    with pytest.raises(DatabaseRefusedError, match="not a database"):
        await Queue.open(f"sqlite:///{path}")
    assert path.read_bytes().startswith(b"no database")


@pytest.mark.parametrize(
    "url", ["mysql://localhost/x", "sqlite:///relative.db", "sqlite://", "no url", "sqlite:////nowhere/at/all/queue.db"]
)
async def test_what_is_no_database_for_a_queue_is_refused(url: str) -> None:
    with pytest.raises(DatabaseRefusedError):
        await Queue.open(url)


async def test_sqlite_is_kept_so_that_a_commit_is_on_disk(tmp_path: Path) -> None:
    queue = await Queue.open(f"sqlite:///{tmp_path}/queue.db")
    try:
        pragmas = {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 5000}
        with queue._database.connected() as connection:
            found = {name: connection.exec_driver_sql(f"PRAGMA {name}").scalar_one() for name in pragmas}
        assert found == pragmas
    finally:
        await queue.close()


# --- ownership ---


async def test_a_second_server_is_refused(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/queue.db"
    queue = await Queue.open(url)
    with pytest.raises(DatabaseBusyError, match=f"process {os.getpid()}"):
        await Queue.open(url)
    await queue.close()
    await (await Queue.open(url)).close()


async def test_a_server_that_was_killed_owns_nothing_though_its_children_live(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/queue.db"
    program = (
        "import asyncio, subprocess, sys\n"
        "from footlight_server.farm.queue import Queue\n"
        f"queue = asyncio.run(Queue.open({url!r}))\n"
        "child = subprocess.Popen(['sleep', '60'])\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout
        child = int(server.stdout.readline())
        try:
            with pytest.raises(DatabaseBusyError):
                await Queue.open(url)
            server.kill()
            server.wait(10)
            await (await Queue.open(url)).close()
        finally:
            os.kill(child, signal.SIGKILL)


def test_network_file_systems_are_refused(tmp_path: Path) -> None:
    here = tmp_path.resolve()
    mounts = "\n".join(
        [
            "1 0 8:1 / / rw,relatime - ext4 /dev/sda1 rw",
            f"2 1 0:40 / {here} rw,relatime shared:9 - nfs4 server:/share rw",
            f"3 2 8:2 / {here}/my\\040disk rw - ext4 /dev/sdb1 rw",
            f"4 1 0:41 / {here}2 rw - cifs //server/share rw",
        ]
    )
    with pytest.raises(DatabaseRefusedError, match="nfs4"):
        refuse_network(tmp_path, mounts)
    for folder in (tmp_path.parent, tmp_path / "my disk"):
        refuse_network(folder, mounts)
    with pytest.raises(DatabaseRefusedError, match="cifs"):
        refuse_network(Path(f"{here}2/queues"), mounts)
    refuse_network(tmp_path)


# --- trouble ---


async def test_a_locked_database_is_an_error_in_time_and_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("footlight_server.farm.sql.engines.LOCK_PATIENCE", 200)
    queue = await Queue.open(f"sqlite:///{tmp_path}/queue.db")
    try:
        job = await queue.create_job(a_job())
        seen = queue.changed.count
        with sqlite3.connect(tmp_path / "queue.db", isolation_level=None) as other:
            other.execute("BEGIN IMMEDIATE")
            with pytest.raises(StorageError, match="locked"):
                await queue.pause(job.number)
            # Whoever only reads does not notice.
            assert not (await queue.job(job.number)).paused
            other.execute("ROLLBACK")
        assert queue.changed.count == seen
        assert (await queue.pause(job.number)).paused
    finally:
        await queue.close()


async def test_a_full_disk_is_an_error_and_passes(tmp_path: Path) -> None:
    queue = await Queue.open(f"sqlite:///{tmp_path}/queue.db")
    try:
        with queue._database.connected() as connection:
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
            connection.exec_driver_sql(f"PRAGMA max_page_count = {pages + 5}")
        with pytest.raises(StorageError, match="full"):
            await queue.create_job(a_job(frames=5000))
        assert await queue.jobs(10) == []
        with queue._database.connected() as connection:
            connection.exec_driver_sql("PRAGMA max_page_count = 1000000")
        assert await queue.create_job(a_job(frames=5000))
    finally:
        await queue.close()
