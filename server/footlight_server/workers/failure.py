"""Why a piece of work came to nothing: the closed list of reasons, and how a dead process is read."""

import signal
from dataclasses import dataclass
from enum import Enum, auto


class FailureReason(Enum):
    """Names and meaning as in the protocol's FailureReason."""

    INVALID_ARGUMENT = auto()
    STAGE_UNREADABLE = auto()
    SCENE = auto()
    CRASHED = auto()
    OUT_OF_MEMORY = auto()
    TIMEOUT = auto()
    OUTPUT = auto()
    INTERNAL = auto()
    LOST = auto()


@dataclass(frozen=True, slots=True)
class Failure:
    """A reason, a sentence for people, and the prim at fault if there is one."""

    reason: FailureReason
    message: str
    prim_path: str = ""


# What C++ says on stderr when an allocation or a thread cannot be had and nobody catches it.
_MEMORY_CRIES = ("bad_alloc", "MemoryError", "Cannot allocate memory", "Resource temporarily unavailable")


# [1] Of the limit: code that never expects an allocation to fail crashes near it in ways of its own.
_NEAR_LIMIT = 0.7

# Signals by which others end it, and in which words.
_STOPPED = {
    "SIGKILL": "killed (SIGKILL), by somebody or by the kernel for want of memory",
    "SIGSYS": "stopped (SIGSYS): it tried what a confined worker must not do",
}


def read_exit(returncode: int, stderr: str, memory_bytes: int, memory_limit: int, *, over_memory: bool) -> Failure:
    """The failure that the end of a worker process stands for.

    `returncode` as in subprocess; `stderr` its last words; `memory_bytes` the most it was seen to hold; `memory_limit`
    what it may, or 0; `over_memory`: the server killed it for that.
    """
    held = f"it held {memory_bytes / 2**20:.0f} MB"
    if over_memory:
        return Failure(FailureReason.OUT_OF_MEMORY, f"the worker passed its limit of memory; {held}")
    if any(cry in stderr for cry in _MEMORY_CRIES) or 0 < _NEAR_LIMIT * memory_limit < memory_bytes:
        return Failure(FailureReason.OUT_OF_MEMORY, f"the worker ran out of memory; {held}")
    if returncode >= 0:
        return Failure(
            FailureReason.CRASHED, f"the worker left with status {returncode} and no answer{_last_line(stderr)}"
        )
    name = _signal_name(-returncode)
    if name == "SIGXCPU":
        return Failure(FailureReason.TIMEOUT, "the worker used up its CPU time while it opened the stage")
    if name in _STOPPED:
        return Failure(FailureReason.CRASHED, f"the worker was {_STOPPED[name]}; {held}")
    return Failure(FailureReason.CRASHED, f"the worker crashed ({name}); {held}{_last_line(stderr)}")


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _last_line(stderr: str) -> str:
    """The first line that faulthandler or the runtime left, as an addition to a message."""
    lines = [line for line in stderr.splitlines() if line.startswith(("Fatal", "terminate", "  what", "bwrap:"))]
    return f"; it said: {' '.join(line.strip() for line in lines)[:300]}" if lines else ""
