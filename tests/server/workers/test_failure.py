"""How the end of a process is read: with real processes."""

import signal
import subprocess
import sys

import pytest

from footlight_server.workers.failure import FailureReason, read_exit

GIGABYTE = 1 << 30


def end_of(program: str) -> tuple[int, str]:
    """Status and last words of a Python process."""
    command = [sys.executable, "-X", "faulthandler", "-c", f"import os, resource, signal\n{program}"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return result.returncode, result.stderr


@pytest.mark.parametrize(
    ("program", "reason", "word"),
    [
        ("os.kill(os.getpid(), signal.SIGKILL)", FailureReason.CRASHED, "SIGKILL"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", FailureReason.CRASHED, "SIGSEGV"),
        ("os.kill(os.getpid(), signal.SIGBUS)", FailureReason.CRASHED, "SIGBUS"),
        ("os.kill(os.getpid(), signal.SIGSYS)", FailureReason.CRASHED, "confined"),
        ("os.write(2, b'bwrap: no such place')\nos._exit(1)", FailureReason.CRASHED, "no such place"),
        ("os.abort()", FailureReason.CRASHED, "SIGABRT"),
        ("os.kill(os.getpid(), 63)", FailureReason.CRASHED, "signal 63"),
        ("os._exit(7)", FailureReason.CRASHED, "status 7"),
        ("os._exit(0)", FailureReason.CRASHED, "no answer"),
        (
            "resource.setrlimit(resource.RLIMIT_CPU, (1, 9))\nwhile True: pass",
            FailureReason.TIMEOUT,
            "CPU",
        ),
        (
            "resource.setrlimit(resource.RLIMIT_DATA, (1 << 27, 1 << 27))\nx = bytearray(1 << 30)",
            FailureReason.OUT_OF_MEMORY,
            "memory",
        ),
    ],
)
def test_an_end_is_read_as_what_it_was(program: str, reason: FailureReason, word: str) -> None:
    code, words = end_of(program)
    failure = read_exit(code, words, GIGABYTE, 0, over_memory=False)
    assert failure.reason is reason
    assert word in failure.message


def test_a_crash_close_to_the_limit_of_memory_is_put_down_to_it() -> None:
    near = read_exit(-signal.SIGSEGV, "", 9 * GIGABYTE, 10 * GIGABYTE, over_memory=False)
    far = read_exit(-signal.SIGSEGV, "", GIGABYTE, 10 * GIGABYTE, over_memory=False)
    assert near.reason is FailureReason.OUT_OF_MEMORY
    assert far.reason is FailureReason.CRASHED


def test_what_was_killed_for_its_memory_says_how_much() -> None:
    failure = read_exit(-signal.SIGKILL, "", 3 * GIGABYTE, 2 * GIGABYTE, over_memory=True)
    assert failure.reason is FailureReason.OUT_OF_MEMORY
    assert "3072 MB" in failure.message
