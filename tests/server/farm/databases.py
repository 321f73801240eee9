"""Databases for tests: files, and a PostgreSQL server of one's own with a new database for each test."""

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg


def _program(name: str) -> str:
    """PostgreSQL's programs; Debian keeps them off the path."""
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"), key=lambda path: int(path.parts[-3]))
    program = str(found[-1]) if found else shutil.which(name)
    assert program, f"{name} is needed (packages.txt)"
    return program


class Postgres:
    """A server below a folder, reached through a socket there."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._databases = folder, 0
        self._shared: str | None = None
        # It refuses to run as root.
        self._user = "postgres" if os.geteuid() == 0 else None
        command = [_program("initdb"), f"--pgdata={folder}/data", "--auth=trust", "--username=postgres", "--no-sync"]
        subprocess.run(
            command, check=True, stdout=subprocess.DEVNULL, timeout=60, cwd="/", user=self._user, group=self._user
        )
        self._server: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        options = {
            "listen_addresses": "",
            "unix_socket_directories": self.folder,
            "fsync": "off",
            "max_connections": 40,
        }
        command = [_program("postgres"), "-D", f"{self.folder}/data"]
        command += [f"--{name}={value}" for name, value in options.items()]
        log = subprocess.DEVNULL
        self._server = subprocess.Popen(command, stdout=log, stderr=log, cwd="/", user=self._user, group=self._user)
        end = time.monotonic() + 30
        while True:
            try:
                psycopg.connect(self._info("postgres"), connect_timeout=5).close()
            except psycopg.OperationalError:
                assert self._server.poll() is None
                assert time.monotonic() < end, "PostgreSQL does not start"
                time.sleep(0.05)
            else:
                return

    def stop(self) -> None:
        """As if the machine went away: no goodbye to anybody."""
        if self._server:
            self._server.send_signal(signal.SIGQUIT)
            self._server.wait(30)
            self._server = None

    def execute(self, statement: str, database: str = "postgres") -> list[tuple[object, ...]]:
        with psycopg.connect(self._info(database), autocommit=True) as connection:
            cursor = connection.execute(statement.encode())
            return cursor.fetchall() if cursor.description else []

    def new_database(self) -> str:
        """The URL of an empty one."""
        self._databases += 1
        name = f"queue{self._databases}"
        self.execute(f"CREATE DATABASE {name}")
        return self._url(name)

    def emptied_database(self) -> str:
        """The URL of one without jobs: always the same one, since making one takes a second."""
        if self._shared is None:
            self._shared = self.new_database().split("@/")[1].split("?")[0]
        name = self._shared
        self.execute(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'")
        found = self.execute("SELECT tablename FROM pg_tables WHERE schemaname = 'public'", name)
        tables = ", ".join(f'"{table}"' for (table,) in found if table != "alembic_version")
        if tables:
            self.execute(f"TRUNCATE {tables} RESTART IDENTITY CASCADE", name)
        return self._url(name)

    def _url(self, name: str) -> str:
        return f"postgresql://postgres@/{name}?host={self.folder}"

    def _info(self, name: str) -> str:
        return f"host={self.folder} user=postgres dbname={name}"


@contextmanager
def a_server() -> Iterator[Postgres]:
    """PostgreSQL, as long as this lasts."""
    # A short path for the socket, in a folder that the server's user may enter.
    folder = Path(tempfile.mkdtemp(prefix="footlight-pg-"))
    try:
        if os.geteuid() == 0:
            os.chown(folder, pwd.getpwnam("postgres").pw_uid, pwd.getpwnam("postgres").pw_gid)
        server = Postgres(folder)
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder)
