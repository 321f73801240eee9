"""Calls that write, one after the other; those that wait at the same time share a commit, which is what takes time."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from footlight_server.farm.sql import engines
from footlight_server.farm.sql.database import Database
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.sessions.errors import StorageError

# [calls] That share a commit: enough that the disk is not what limits, few enough that none waits long for the others.
MOST_TOGETHER = 64
# [1] Of the patience with locks: a call that took so much of it and failed waited for one.
_LOCKED = 0.8


@dataclass(frozen=True, slots=True)
class _Call:
    """`done` gets what the work answers and its transaction, or what it raises."""

    work: Callable[[Transaction], Any]
    done: Future[tuple[Any, Transaction]] = field(default_factory=Future)


class Writer:
    """A thread of its own, so no two writers of a server ever wait for each other's locks. Ends with `close`."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._waiting: deque[_Call] = deque()
        self._thread = ThreadPoolExecutor(1, "queue-writer")

    def submit(self, work: Callable[[Transaction], Any]) -> Future[tuple[Any, Transaction]]:
        """Do it soon; each call happens as a whole or not at all, whatever becomes of those it shares a commit with."""
        call = _Call(work)
        self._waiting.append(call)
        try:
            # Whoever comes first does what all that came until then want; the others find nothing left.
            self._thread.submit(self._work_off)
        except RuntimeError as error:  # closed
            self._waiting.remove(call)
            raise StorageError("the queue is closed") from error
        return call.done

    def close(self) -> None:
        """Return when all that was submitted is done."""
        self._thread.shutdown()

    def _work_off(self) -> None:
        calls = [self._waiting.popleft() for _ in range(min(len(self._waiting), MOST_TOGETHER))]
        if len(calls) < 2 or not self._do_together(calls):
            trouble: StorageError | None = None
            for call in calls:
                if trouble is None:
                    trouble = self._do(call)
                else:
                    call.done.set_exception(trouble)

    def _do_together(self, calls: Sequence[_Call]) -> bool:
        """False: the database would not, and nothing has happened."""
        try:
            outcomes = self._database.write_together([call.work for call in calls])
        except Exception:  # noqa: BLE001 - whatever it is, whose call it belongs to shows when each is done by itself
            return False
        for call, outcome in zip(calls, outcomes, strict=True):
            if isinstance(outcome, Exception):
                call.done.set_exception(outcome)
            else:
                call.done.set_result(outcome)
        return True

    def _do(self, call: _Call) -> StorageError | None:
        """What keeps it from being done, if that would keep all others as well, each for seconds."""
        begun = time.monotonic()
        try:
            outcome = self._database.write(call.work)
        except StorageError as error:
            call.done.set_exception(error)
            return error if time.monotonic() - begun > _LOCKED * engines.LOCK_PATIENCE / 1000 else None
        except Exception as error:  # noqa: BLE001 - it is the caller's
            call.done.set_exception(error)
        else:
            call.done.set_result(outcome)
        return None
