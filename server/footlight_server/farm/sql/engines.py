"""How connections to SQLite and PostgreSQL are made, so that a transaction is what its name says."""

from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event, exc, make_url

from footlight_server.sessions.errors import DatabaseRefusedError

_SQLITE = "sqlite:///"
# [connections] That read while one writes.
READERS = 2
# [ms] How long a statement waits for a lock that somebody else holds: a backup, a person with a shell.
LOCK_PATIENCE = 5000
# [ms] PostgreSQL: for any one statement.
STATEMENT_PATIENCE = 30_000
# [s] PostgreSQL: until a server that does not answer counts as gone.
CONNECT_PATIENCE = 5


def url_of(address: str) -> URL:
    """A queue's address with the driver to be used. Raises DatabaseRefusedError for what cannot hold a queue."""
    if address.startswith(_SQLITE):
        # Not parsed: a folder may have any sign in its name.
        path = address.removeprefix(_SQLITE)
        if not Path(path).is_absolute():
            raise DatabaseRefusedError(f"not an absolute path: {path}")
        return URL.create("sqlite+pysqlite", database=path)
    try:
        url = make_url(address)
    except exc.ArgumentError as error:
        raise DatabaseRefusedError("not the URL of a database; sqlite:///absolute/path or postgresql://…") from error
    if url.get_backend_name() != "postgresql":
        raise DatabaseRefusedError(
            f"not a database for a queue: {url.drivername}; sqlite:///absolute/path or postgresql://…"
        )
    return url.set(drivername="postgresql+psycopg")


def writing(url: URL) -> Engine:
    """One connection. Its transactions and other writers' exclude each other: in SQLite from their begin, in PostgreSQL
    by the rows they lock.
    """
    if url.get_backend_name() == "sqlite":
        return _sqlite(url, "BEGIN IMMEDIATE", connections=1)
    return _postgres(url, "READ COMMITTED", connections=1)


def reading(url: URL) -> Engine:
    """READERS connections, each of whose transactions sees one moment."""
    if url.get_backend_name() == "sqlite":
        return _sqlite(url, "BEGIN", connections=READERS)
    return _postgres(url, "REPEATABLE READ", connections=READERS)


def _sqlite(url: URL, begin: str, connections: int) -> Engine:
    """Without these listeners two transactions could read the same rows before either writes, in silence.

    The driver begins a transaction at the first write only; see the double claim in tests/server/farm/test_claims.py.
    """
    engine = create_engine(
        url,
        pool_size=connections,
        max_overflow=0,
        connect_args={"check_same_thread": False, "timeout": LOCK_PATIENCE / 1000},
    )

    @event.listens_for(engine, "connect")
    def connect(connection: Any, _record: object) -> None:
        connection.isolation_level = None
        connection.execute(f"PRAGMA busy_timeout = {LOCK_PATIENCE}")
        mode = connection.execute("PRAGMA journal_mode = WAL").fetchone()[0]
        # A commit is on disk when it returns; NORMAL would lose the last ones with the power.
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
        keys = connection.execute("PRAGMA foreign_keys").fetchone()[0]
        if mode != "wal" or keys != 1:
            raise DatabaseRefusedError(f"SQLite cannot keep a queue here: journal {mode}, foreign keys {keys}")

    @event.listens_for(engine, "begin")
    def begin_transaction(connection: Connection) -> None:
        connection.exec_driver_sql(begin)

    return engine


def _postgres(url: URL, isolation: str, connections: int) -> Engine:
    limits = f"-c lock_timeout={LOCK_PATIENCE} -c statement_timeout={STATEMENT_PATIENCE}"
    return create_engine(
        url,
        pool_size=connections,
        max_overflow=0,
        # A connection that was cut while idle is made anew, and the database owned anew, before anything is lost.
        pool_pre_ping=True,
        isolation_level=isolation,
        connect_args={
            "options": limits,
            "connect_timeout": CONNECT_PATIENCE,
            "application_name": "footlight",
            "keepalives_idle": 5,
            "keepalives_interval": 2,
            "keepalives_count": 3,
            "tcp_user_timeout": 1000 * 2 * CONNECT_PATIENCE,
        },
    )
