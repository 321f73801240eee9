"""The worker's table from exceptions to failures."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager

from footlight_server.workers.failure import Failure, FailureReason


class TaskFailedError(Exception):
    """A task came to nothing, for a reason that can be told."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


@contextmanager
def failing_as(reason: FailureReason, *kinds: type[Exception]) -> Iterator[None]:
    """Within, exceptions of these kinds mean `reason`; their message is meant for people."""
    try:
        yield
    except TaskFailedError:
        raise
    except MemoryError:
        raise
    except kinds as error:
        prim_path = getattr(error, "prim_path", "") or ""
        raise TaskFailedError(Failure(reason, str(error), prim_path)) from error


def failure_of(error: BaseException) -> Failure:
    """What an exception that ended a task stands for."""
    if isinstance(error, TaskFailedError):
        return error.failure
    if isinstance(error, MemoryError):
        return Failure(FailureReason.OUT_OF_MEMORY, f"the worker ran out of memory {error}".strip())
    if isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}:
        return Failure(FailureReason.OUTPUT, str(error))
    return Failure(FailureReason.INTERNAL, f"{type(error).__name__}: {error}")
