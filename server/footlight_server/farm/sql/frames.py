"""Frames on their way to disk: staged before the rename, committed after it, both only by the current attempt."""

from sqlalchemy import bindparam, delete, insert, select, update

from footlight_server.farm.model import Attempt, Frame, StagedFrame, TaskState
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.transaction import Transaction

_job, _task, _frame, _staged = schema.job.c, schema.task.c, schema.frame.c, schema.staged_frame.c

# The fence.
_SELECT_CURRENT = (
    select(_task.part)
    .where(
        _task.job == bindparam("the_job"),
        _task.number == bindparam("the_task"),
        _task.attempt == bindparam("the_attempt"),
        _task.state == TaskState.RUNNING.value,
    )
    .with_for_update()
)
_DELETE_STAGED = delete(schema.staged_frame).where(
    _staged.job == bindparam("the_job"),
    _staged.task == bindparam("the_task"),
    _staged.frame == bindparam("the_frame"),
)
_INSERT_STAGED = insert(schema.staged_frame)
_DELETE_FRAME = delete(schema.frame).where(
    _frame.job == bindparam("the_job"),
    _frame.task == bindparam("the_task"),
    _frame.frame == bindparam("the_frame"),
)
_INSERT_FRAME = insert(schema.frame)
_COUNT_ON_TASK = (
    update(schema.task)
    .where(_task.job == bindparam("the_job"), _task.number == bindparam("the_task"))
    .values(frames_done=_task.frames_done + 1)
)
_COUNT_ON_JOB = update(schema.job).where(_job.number == bindparam("the_job")).values(frames_done=_job.frames_done + 1)


def stage_frame(transaction: Transaction, attempt: Attempt, frame: Frame, temp_path: str) -> bool:
    """See Queue.stage_frame."""
    if _is_part(transaction, attempt) is None:
        return False
    transaction.connection.execute(_DELETE_STAGED, _key(frame))
    transaction.connection.execute(_INSERT_STAGED, {**_values(attempt, frame), "temp_path": temp_path})
    return True


def commit_frame(transaction: Transaction, attempt: Attempt, frame: Frame) -> bool:
    """See Queue.commit_frame."""
    part = _is_part(transaction, attempt)
    if part is None:
        return False
    connection = transaction.connection
    connection.execute(_DELETE_STAGED, _key(frame))
    again = connection.execute(_DELETE_FRAME, _key(frame)).rowcount
    connection.execute(_INSERT_FRAME, {**_values(attempt, frame), "part": part})
    if not again:
        connection.execute(_COUNT_ON_TASK, {"the_job": frame.job, "the_task": frame.task})
        if not part:
            connection.execute(_COUNT_ON_JOB, {"the_job": frame.job})
    if not part:
        transaction.frame_done(frame.job, frame.task, frame.layer, frame.frame)
    return True


def unstage(transaction: Transaction, staged: StagedFrame) -> None:
    """See Queue.unstage."""
    transaction.connection.execute(_DELETE_STAGED.where(_staged.attempt == staged.attempt.number), _key(staged.frame))


def _is_part(transaction: Transaction, attempt: Attempt) -> bool | None:
    """Whether the task's frames are parts of images; None if the attempt is not the current one."""
    found = transaction.connection.execute(
        _SELECT_CURRENT, {"the_job": attempt.job, "the_task": attempt.task, "the_attempt": attempt.number}
    ).scalar_one_or_none()
    return None if found is None else bool(found)


def _key(frame: Frame) -> dict[str, object]:
    return {"the_job": frame.job, "the_task": frame.task, "the_frame": frame.frame}


def _values(attempt: Attempt, frame: Frame) -> dict[str, object]:
    return {
        "job": frame.job,
        "task": frame.task,
        "frame": frame.frame,
        "layer": frame.layer,
        "path": frame.path,
        "sha256": frame.sha256,
        "size_bytes": frame.size_bytes,
        "attempt": attempt.number,
        "stats": frame.stats,
    }
