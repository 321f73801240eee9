"""One server owns a database: a locked file beside SQLite's, an advisory lock in PostgreSQL. Both end with it."""

import contextlib
import fcntl
import os
import time
from pathlib import Path
from typing import Any

from footlight_server.sessions.errors import DatabaseBusyError, DatabaseRefusedError

# SQLite's locks and shared memory do not work on these (https://sqlite.org/howtocorrupt.html, section 2.1).
NETWORK = ("nfs", "cifs", "smb", "afs", "9p", "fuse.sshfs", "fuse.glusterfs", "lustre", "beegfs", "gpfs")
# Any number will do, as long as it stays the same: "footlght" in ASCII.
ADVISORY_KEY = int.from_bytes(b"footlght", "big")
# [s] PostgreSQL may notice only now that the connection which held the lock is gone.
ADVISORY_PATIENCE = 2.0
# Hashes of tokens are in it, and what people work on.
PRIVATE = 0o600
_MOUNTS = Path("/proc/self/mountinfo")


class FileOwnership:
    """The lock on `<database>.lock`, held until `release`. Raises DatabaseBusyError, DatabaseRefusedError."""

    def __init__(self, database: Path) -> None:
        refuse_network(database.parent)
        path = database.with_name(f"{database.name}.lock")
        try:
            # Not inherited by workers, which may outlive a server that was killed.
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, PRIVATE)
            make_private(database)
        except OSError as error:
            raise DatabaseRefusedError(f"{error.filename}: {error.strerror}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.pread(self._file, 32, 0).decode("ascii", "replace").strip()
            os.close(self._file)
            raise DatabaseBusyError(f"{database} is in use by another server (process {owner or 'unknown'})") from error
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)

    def release(self) -> None:
        """Let go; the file stays, since removing it would let two servers lock two files of one name."""
        with contextlib.suppress(OSError):
            os.close(self._file)


def make_private(file: Path) -> None:
    """Make an empty file that only its owner reads, where there is none; what SQLite puts beside it is as private."""
    os.close(os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, PRIVATE))


def refuse_network(folder: Path, mounts: str | None = None) -> None:
    """Raise DatabaseRefusedError if the folder lies on a network file system. `mounts`: as in /proc/self/mountinfo."""
    if mounts is None:
        if not _MOUNTS.exists():
            return
        mounts = _MOUNTS.read_text()
    where = folder.resolve()
    kind, _ = max(
        ((kind, point) for point, kind in _mounted(mounts) if where.is_relative_to(point)),
        key=lambda mount: len(mount[1].parts),
        default=("", where),
    )
    if kind.startswith(NETWORK):
        raise DatabaseRefusedError(
            f"{folder} is on a network file system ({kind}), where SQLite would lose data; "
            "use a local folder, or a PostgreSQL database"
        )


def _mounted(mounts: str) -> list[tuple[Path, str]]:
    """Mount points and kinds of file system, in the order they were mounted (proc_pid_mountinfo(5))."""
    found = []
    for line in mounts.splitlines():
        left, _, right = line.partition(" - ")
        point = left.split(" ")[4].encode("ascii", "surrogateescape").decode("unicode_escape")
        found.append((Path(point), right.split(" ")[0]))
    return found


def own_advisory(connection: Any) -> None:
    """Take the lock for as long as this DB-API connection to PostgreSQL lives. Raises DatabaseBusyError."""
    end = time.monotonic() + ADVISORY_PATIENCE
    with connection.cursor() as cursor:
        while not cursor.execute("SELECT pg_try_advisory_lock(%s)", (ADVISORY_KEY,)).fetchone()[0]:
            if time.monotonic() > end:
                raise DatabaseBusyError(f"the database {connection.info.dbname} is in use by another server")
            time.sleep(0.1)
    connection.commit()
