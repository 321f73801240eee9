"""What people do to jobs: pause, resume, cancel, retry, skip, prune."""

from collections.abc import Iterable, Sequence

from sqlalchemy import ColumnElement, Connection, delete, exists, select

from footlight_server.farm.model import Job, JobState, Selection, TaskState
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.job_change import JobChange, Stepped, TaskRow
from footlight_server.farm.sql.lanes import forget_blame
from footlight_server.farm.sql.reads import job_numbered
from footlight_server.farm.sql.rows import frames_from
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.transitions import (
    DONE_STATES,
    WAITING_STATES,
    CancelAsked,
    RetryAsked,
    SkipAsked,
)
from footlight_server.sessions.errors import JobEndedError, JobNotEndedError, TaskNotFoundError

_job, _task = schema.job.c, schema.task.c

_CANCELLABLE = WAITING_STATES | {TaskState.RUNNING}
_RETRIABLE = frozenset({TaskState.FAILED, TaskState.SKIPPED, TaskState.CANCELLED})
_SKIPPABLE = frozenset(TaskState) - DONE_STATES


def pause(transaction: Transaction, number: int, *, paused: bool) -> Job:
    """See Queue.pause and Queue.resume."""
    change = JobChange(transaction, number)
    if change.ended:
        raise JobEndedError(f"jobs/{number} has ended")
    change.paused = paused
    change.write()
    return job_numbered(transaction.connection, number)


def cancel(transaction: Transaction, number: int) -> Job:
    """See Queue.cancel."""
    change = JobChange(transaction, number)
    if not change.ended:
        change.cancelling = True
        change.step(change.tasks(_task.state.in_(_CANCELLABLE)), CancelAsked())
        change.write()
    return job_numbered(transaction.connection, number)


def retry(transaction: Transaction, number: int, selection: Selection) -> tuple[Job, int]:
    """See Queue.retry."""
    change = JobChange(transaction, number)
    changed = change.step(_chosen(change, selection, _RETRIABLE), RetryAsked())
    if changed:
        forget_blame(transaction, number, [each.row.number for each in changed])
        change.cancelling = False
    return _written(change, changed)


def skip(transaction: Transaction, number: int, selection: Selection) -> tuple[Job, int]:
    """See Queue.skip."""
    change = JobChange(transaction, number)
    return _written(change, change.step(_chosen(change, selection, _SKIPPABLE), SkipAsked()))


def prunable(connection: Connection, before: float, user: str | None) -> list[int]:
    """Jobs that have ended before that time [s since 1970, UTC], and that no job still waits for."""
    query = select(_job.number).where(_job.ended <= before, ~_is_waited_for())
    if user is not None:
        query = query.where(_job.user == user)
    return list(connection.execute(query.order_by(_job.number)).scalars())


def prune(transaction: Transaction, numbers: Sequence[int]) -> None:
    """See Queue.prune."""
    for number in numbers:
        if JobChange(transaction, number).ended is False:
            raise JobNotEndedError(f"jobs/{number} has not ended")
        waited_for = select(_job.number).where(_job.number == number, _is_waited_for())
        if transaction.connection.execute(waited_for).one_or_none():
            raise JobNotEndedError(f"jobs/{number} has not succeeded, and a job still waits for it")
    # Everything else goes with them.
    for number in numbers:
        transaction.connection.execute(delete(schema.job).where(_job.number == number))
    transaction.rings = True


def _is_waited_for() -> ColumnElement[bool]:
    """It has not succeeded, and a job that has not ended needs it."""
    waiting = schema.job.alias("waiting")
    return (_job.state != JobState.SUCCEEDED.value) & exists().where(
        schema.job_need.c.needs == _job.number,
        waiting.c.number == schema.job_need.c.job,
        waiting.c.ended.is_(None),
    )


def _written(change: JobChange, changed: Sequence[Stepped]) -> tuple[Job, int]:
    if changed:
        change.write()
    return job_numbered(change.transaction.connection, change.number), len(changed)


def _chosen(change: JobChange, selection: Selection, states: Iterable[TaskState]) -> list[TaskRow]:
    """The tasks of a selection that are in one of these states. Raises TaskNotFoundError."""
    connection, job = change.transaction.connection, change.number
    conditions: list[ColumnElement[bool]] = []
    if selection.layer:
        query = select(schema.layer.c.number).where(schema.layer.c.job == job, schema.layer.c.name == selection.layer)
        layer = connection.execute(query).scalar_one_or_none()
        if layer is None:
            raise TaskNotFoundError(f"jobs/{job} has no layer {selection.layer}")
        conditions.append(_task.layer == layer)
    if selection.tasks:
        found = {row.number for row in change.tasks_numbered(selection.tasks)}
        if missing := sorted(selection.tasks - found):
            raise TaskNotFoundError(f"no task jobs/{job}/tasks/{missing[0]}")
    wanted = _with_frames(connection, job, selection.frames) if selection.frames is not None else None
    return [
        row
        for row in change.tasks(_task.state.in_(list(states)), *conditions)
        if (not selection.tasks or row.number in selection.tasks) and (wanted is None or row.number in wanted)
    ]


def _with_frames(connection: Connection, job: int, frames: frozenset[int]) -> set[int]:
    """Numbers of the tasks that hold one of the frames."""
    rows = connection.execute(select(_task.number, _task.frames).where(_task.job == job))
    return {number for number, kept in rows if not frames.isdisjoint(frames_from(kept))}
