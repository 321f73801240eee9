"""A server of our own: on a Unix socket that only we can reach, and gone when we are."""

import contextlib
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from typing import IO

from footlight.errors import FootlightError

# [s] Starting takes under one second on the reference machine; stopping is bounded by the server to ten.
START_TIMEOUT = 30.0
STOP_TIMEOUT = 12.0
# [lines] Of the server's log, for the message.
LAST_LINES = 20


class NoServerError(FootlightError):
    """A private server cannot be started: it is not installed, or it ended at once."""


@contextlib.contextmanager
def private_server() -> Iterator[str]:
    """Start a server for us alone and give its address; it ends with the block.

    It also ends when this process does, however that happens: it reads from a pipe whose other end only we hold. A
    Ctrl-C at the terminal does not reach it, so that renders can be cancelled in order. Raises NoServerError with what
    the server said last.
    """
    if find_spec("footlight_server") is None:
        raise NoServerError(
            "footlight-server is not installed in this Python, so no private server can be started; install it "
            "(pip install footlight-server) or name a running one with --server HOST:PORT"
        )
    # The directory has mode 0700; the log has no name, so that a crash leaves no more than an empty directory.
    with tempfile.TemporaryDirectory(prefix="footlight-") as directory, tempfile.TemporaryFile() as log:
        address = f"unix:{directory}/socket"
        process = subprocess.Popen(
            [sys.executable, "-m", "footlight_server", "--private", f"--listen={address}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            start_new_session=True,
        )
        try:
            _wait_until_listening(process, log)
            yield address
        finally:
            _stop(process)


def _wait_until_listening(process: subprocess.Popen[bytes], log: IO[bytes]) -> None:
    """The server's one line on stdout says that it listens; its end without one, that it could not start."""
    assert process.stdout is not None
    if not select.select([process.stdout], [], [], START_TIMEOUT)[0]:
        raise NoServerError(f"the private server did not start within {START_TIMEOUT:.0f} s")
    if not process.stdout.readline():
        log.seek(0)
        said = log.read().decode(errors="replace").strip().splitlines()[-LAST_LINES:]
        raise NoServerError("the private server could not start: " + ("\n".join(said) or "it said nothing"))


def _stop(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()  # the server's sign to leave
    try:
        process.wait(STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    finally:
        process.stdout.close()
