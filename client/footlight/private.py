"""A server of our own: on a Unix socket that only we can reach, and gone when we are."""

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import grpc

from footlight.errors import FootlightError

# [s] Importing the server takes under one second on the reference machine.
START_TIMEOUT = 30.0
STOP_TIMEOUT = 5.0


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
    with tempfile.TemporaryDirectory(prefix="footlight-") as directory:  # mode 0700
        address = f"unix:{directory}/socket"
        log = Path(directory) / "log"
        with log.open("wb") as stderr:
            process = subprocess.Popen(
                [sys.executable, "-m", "footlight_server", "--private", f"{directory}/socket"],
                stdin=subprocess.PIPE,
                stdout=stderr,
                stderr=stderr,
                start_new_session=True,
            )
        try:
            _wait_until_ready(process, address, log)
            yield address
        finally:
            _stop(process)


def _wait_until_ready(process: subprocess.Popen[bytes], address: str, log: Path) -> None:
    deadline = time.monotonic() + START_TIMEOUT
    socket = Path(address.removeprefix("unix:"))
    while not socket.exists():
        if process.poll() is not None:
            said = log.read_text(errors="replace").strip().splitlines()
            raise NoServerError("the private server ended at once: " + ("\n".join(said[-20:]) or "without a word"))
        if time.monotonic() > deadline:
            raise NoServerError(f"the private server did not start within {START_TIMEOUT:.0f} s")
        time.sleep(0.01)
    with grpc.insecure_channel(address) as channel:
        try:
            grpc.channel_ready_future(channel).result(timeout=max(deadline - time.monotonic(), 1.0))
        except grpc.FutureTimeoutError as error:
            raise NoServerError("the private server does not answer") from error


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        process.stdin.close()  # the server's sign to leave
    try:
        process.wait(STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
