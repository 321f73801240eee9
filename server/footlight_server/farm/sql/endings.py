"""Ends attempts: by what the dispatcher says, or at the start of a server for the one before it."""

from itertools import groupby

from sqlalchemy import bindparam, delete, update

from footlight_server.farm.model import Attempt, Ending, ExitClass, Task
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.job_change import JobChange
from footlight_server.farm.sql.lanes import blame_lane
from footlight_server.farm.sql.reads import running, task_numbered
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.transitions import AttemptEnded, Effect
from footlight_server.sessions.errors import JobNotFoundError

_attempt, _staged = schema.attempt.c, schema.staged_frame.c

_END_ATTEMPT = (
    update(schema.attempt)
    .where(
        _attempt.job == bindparam("the_job"),
        _attempt.task == bindparam("the_task"),
        _attempt.number == bindparam("the_attempt"),
    )
    .values(
        ended=bindparam("new_ended"),
        exit_class=bindparam("new_exit_class"),
        message=bindparam("new_message"),
        prim_path=bindparam("new_prim_path"),
        peak_memory_bytes=bindparam("new_peak"),
    )
)
_UNSTAGE = delete(schema.staged_frame).where(_staged.job == bindparam("the_job"), _staged.task == bindparam("the_task"))
_STOPPED = Ending(ExitClass.PREEMPTED, "the server stopped")


def finish(transaction: Transaction, attempt: Attempt, ending: Ending, seconds: float) -> Task | None:
    """See Queue.finish. `seconds`: how long it took."""
    try:
        change = JobChange(transaction, attempt.job)
    except JobNotFoundError:  # pruned
        return None
    if not _end(change, attempt, ending):
        return None
    change.render_seconds = seconds
    change.write()
    return task_numbered(transaction.connection, attempt.job, attempt.task)


def recover(transaction: Transaction) -> int:
    """See Queue.recover."""
    left = running(transaction.connection)
    for job, attempts in groupby(left, key=lambda attempt: attempt.job):
        change = JobChange(transaction, job)
        for attempt in attempts:
            _end(change, attempt, _STOPPED)
        change.write()
    return len(left)


def _end(change: JobChange, attempt: Attempt, ending: Ending) -> bool:
    """False: it is not the current attempt."""
    row = change.task(attempt.task)
    ended = change.step([row], AttemptEnded(attempt.number, ending.exit_class)) if row else []
    if not ended:
        return False
    transaction = change.transaction
    transaction.connection.execute(
        _END_ATTEMPT,
        {
            "the_job": attempt.job,
            "the_task": attempt.task,
            "the_attempt": attempt.number,
            # The clock may have been set back meanwhile.
            "new_ended": max(attempt.started, transaction.now),
            "new_exit_class": ending.exit_class.value,
            "new_message": _plain(ending.message),
            "new_prim_path": _plain(ending.prim_path),
            "new_peak": ending.peak_memory_bytes,
        },
    )
    transaction.connection.execute(_UNSTAGE, {"the_job": attempt.job, "the_task": attempt.task})
    if Effect.BLAME_LANE in ended[0].effects:
        blame_lane(transaction, attempt)
    return True


def _plain(message: str) -> str:
    """Without what a database does not take: NUL, and halves of characters."""
    return message.encode("utf-8", "replace").decode().replace("\0", "\ufffd")
