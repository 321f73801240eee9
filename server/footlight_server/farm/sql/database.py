"""Connections and transactions: one that writes, a few that read, each call a transaction of its own."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from sqlalchemy import Connection, event, exc, text

from footlight_server.farm.sql.engines import reading, url_of, writing
from footlight_server.farm.sql.ownership import FileOwnership, own_advisory
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.transitions import Policy
from footlight_server.sessions.errors import DatabaseBusyError, DatabaseRefusedError, ServiceError, StorageError

P = ParamSpec("P")
T = TypeVar("T")


class Database:
    """The database at a URL, owned until `close`. Methods block, and are called from one thread each: one that writes,
    READERS that read. Raises DatabaseBusyError, DatabaseRefusedError.
    """

    def __init__(self, address: str, clock: Callable[[], float], policy: Policy) -> None:
        self._clock, self._policy = clock, policy
        self._opened = False
        url = url_of(address)
        self._owned: FileOwnership | None = None
        # None for a database that is not a file.
        self.path: Path | None = None
        if url.get_backend_name() == "sqlite":
            self.path = Path(url.database or "")
            self._owned = FileOwnership(self.path)
        self._writer, self._reader = writing(url), reading(url)
        if self.path is None:
            event.listen(self._writer, "connect", lambda connection, _: own_advisory(connection))
        try:
            with self.connected():
                self._opened = True
        except StorageError as error:
            self.close()
            raise DatabaseRefusedError(f"the database cannot be opened: {error}") from error
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the connections, and of the database."""
        self._reader.dispose()
        self._writer.dispose()
        if self._owned:
            self._owned.release()

    def write(self, work: Callable[[Transaction], T]) -> tuple[T, Transaction]:
        """What `work` answers once everything it changed is on disk; nothing is changed if it raises."""
        with self.connected() as connection:
            return self._do(connection, work)

    def write_together(self, works: Sequence[Callable[[Transaction], T]]) -> list[tuple[T, Transaction] | Exception]:
        """As `write` of each in turn, with one commit for all: what each answers, or raises.

        Raises what the database raises, whichever of them it was for; nothing has happened then.
        """
        outcomes: list[tuple[T, Transaction] | Exception] = []
        with self.connected() as connection:
            for work in works:
                try:
                    with connection.begin_nested():
                        outcomes.append(self._do(connection, work))
                except (ServiceError, ValueError) as error:
                    outcomes.append(error)
        return outcomes

    def _do(self, connection: Connection, work: Callable[[Transaction], T]) -> tuple[T, Transaction]:
        transaction = Transaction(connection, self._clock(), self._policy)
        value = work(transaction)
        transaction.record()
        return value, transaction

    def read(self, work: Callable[Concatenate[Connection, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """What `work` answers; all that it sees is of one moment."""
        with _telling(), self._reader.begin() as connection:
            return work(connection, *args, **kwargs)

    def vacuum_into(self, copy: Path) -> None:
        """Write a copy of the SQLite file as it is now; not in a transaction, so others go on writing meanwhile."""
        with _telling(), self._reader.connect() as connection:
            plain = connection.connection.dbapi_connection
            assert plain is not None
            plain.cursor().execute("VACUUM INTO ?", (str(copy),))

    @contextlib.contextmanager
    def connected(self) -> Iterator[Connection]:
        """The connection that writes, in a transaction."""
        try:
            with _telling(), self._writer.begin() as connection:
                yield connection
        except DatabaseBusyError as error:
            if not self._opened:
                raise
            # The connection was lost, and the next one came too late.
            raise StorageError(str(error)) from error


@contextlib.contextmanager
def _telling() -> Iterator[None]:
    """Within, what the database cannot do is a StorageError; its message quotes no statement and no values."""
    try:
        yield
    except (exc.OperationalError, exc.InterfaceError) as error:
        raise StorageError(f"the database: {error.orig}") from error
    except (exc.IntegrityError, exc.ProgrammingError, exc.DataError):  # faults of ours
        raise
    except exc.TimeoutError as error:
        raise StorageError("the database: all connections are busy") from error
    except exc.DBAPIError as error:  # a damaged file, a connection that broke in an unusual way
        raise StorageError(f"the database: {error.orig}") from error


def database_name(connection: Connection) -> str:
    """`sqlite` or `postgresql`."""
    return connection.dialect.name


def check_integrity(connection: Connection) -> None:
    """Raise DatabaseRefusedError if SQLite finds its own file damaged."""
    if database_name(connection) != "sqlite":
        return
    found = connection.execute(text("PRAGMA quick_check(1)")).scalar_one()
    if found != "ok":
        raise DatabaseRefusedError(f"the database is damaged: {found}")
