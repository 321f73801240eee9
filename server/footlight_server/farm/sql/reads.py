"""What is asked about jobs, tasks and frames: pages by key, never by counting off."""

from collections.abc import Iterable, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, and_, exists, func, select, text, tuple_

from footlight_server.farm.model import (
    Attempt,
    Event,
    EventKind,
    Frame,
    Job,
    JobState,
    StagedFrame,
    Task,
    TaskCounts,
    TaskState,
    Usage,
)
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.rows import (
    FRAME_COLUMNS,
    SELECT_ATTEMPTS,
    SELECT_FRAMES,
    SELECT_JOBS,
    SELECT_TASKS,
    attempt_of,
    frame_of,
    jobs_of,
    task_of,
)
from footlight_server.sessions.errors import FrameNotFoundError, JobNotFoundError, TaskNotFoundError

_job, _task, _attempt, _frame, _event = (
    schema.job.c,
    schema.task.c,
    schema.attempt.c,
    schema.frame.c,
    schema.event.c,
)


def job_numbered(connection: Connection, number: int) -> Job:
    """Raises JobNotFoundError."""
    rows = connection.execute(SELECT_JOBS.where(_job.number == number)).all()
    if not rows:
        raise JobNotFoundError(f"no job jobs/{number}")
    return jobs_of(connection, rows)[0]


def job_of_request(connection: Connection, user: str, request_id: str) -> Job | None:
    """See Queue.job_of_request."""
    # In these words the condition finds its index.
    given = text(schema.GIVEN_REQUEST)
    query = SELECT_JOBS.where(given, _job.user == user, _job.request_id == request_id)
    rows = connection.execute(query).all()
    return jobs_of(connection, rows)[0] if rows else None


def require_job(connection: Connection, number: int) -> None:
    """Raises JobNotFoundError."""
    if connection.execute(select(_job.number).where(_job.number == number)).one_or_none() is None:
        raise JobNotFoundError(f"no job jobs/{number}")


def jobs(
    connection: Connection,
    limit: int,
    before: int | None,
    states: Sequence[JobState],
    user: str,
    show: str,
    shot: str,
    tag: str,
) -> list[Job]:
    """See Queue.jobs."""
    query = SELECT_JOBS
    if before is not None:
        query = query.where(_job.number < before)
    if states:
        query = query.where(_job.state.in_([state.value for state in states]))
    for column, word in ((_job.user, user), (_job.show, show), (_job.shot, shot)):
        if word:
            query = query.where(column == word)
    if tag:
        query = query.where(exists().where(schema.job_tag.c.job == _job.number, schema.job_tag.c.tag == tag))
    return jobs_of(connection, connection.execute(query.order_by(_job.number.desc()).limit(limit)).all())


def usage(connection: Connection, user: str) -> Usage:
    """See Queue.usage."""
    waiting = _job.blocked + _job.ready + _job.running
    count, tasks = connection.execute(
        select(func.count(), func.coalesce(func.sum(waiting), 0)).where(_job.user == user, _job.ended.is_(None))
    ).one()
    return Usage(int(count), int(tasks))


def task_counts(connection: Connection) -> TaskCounts:
    """See Queue.task_counts."""
    states = [func.coalesce(func.sum(_job[state.value]), 0) for state in TaskState]
    counts = connection.execute(select(*states)).one()
    return TaskCounts(**{state.value: int(count) for state, count in zip(TaskState, counts, strict=True)})


def tasks(
    connection: Connection, job: int, limit: int, after: int, states: Sequence[TaskState], layer: str
) -> list[Task]:
    """See Queue.tasks."""
    require_job(connection, job)
    query = SELECT_TASKS.where(_task.job == job, _task.number > after)
    if states:
        query = query.where(_task.state.in_([state.value for state in states]))
    if layer:
        query = query.where(schema.layer.c.name == layer)
    return [task_of(row) for row in connection.execute(query.order_by(_task.number).limit(limit))]


def task_numbered(connection: Connection, job: int, number: int) -> Task:
    """Raises JobNotFoundError, TaskNotFoundError."""
    row = connection.execute(SELECT_TASKS.where(_task.job == job, _task.number == number)).one_or_none()
    if row is None:
        require_job(connection, job)
        raise TaskNotFoundError(f"no task jobs/{job}/tasks/{number}")
    return task_of(row)


def attempts(connection: Connection, job: int, task: int) -> list[Attempt]:
    """See Queue.attempts."""
    task_numbered(connection, job, task)
    query = SELECT_ATTEMPTS.where(_attempt.job == job, _attempt.task == task).order_by(_attempt.number)
    return [attempt_of(row) for row in connection.execute(query)]


def running(connection: Connection) -> list[Attempt]:
    """See Queue.running."""
    return _running_where(connection)


def orders(connection: Connection) -> list[Attempt]:
    """See Queue.orders."""
    same = and_(_task.job == _attempt.job, _task.number == _attempt.task)
    return _running_where(connection, exists().where(same, _task.stop != ""))


def _running_where(connection: Connection, *conditions: ColumnElement[bool]) -> list[Attempt]:
    query = SELECT_ATTEMPTS.where(_attempt.ended.is_(None), *conditions).order_by(_attempt.job, _attempt.task)
    return [attempt_of(row) for row in connection.execute(query)]


def layer_spec(connection: Connection, job: int, layer: str) -> bytes:
    """See Queue.layer_spec."""
    spec = connection.execute(
        select(schema.layer_spec.c.spec)
        .join_from(
            schema.layer_spec,
            schema.layer,
            and_(schema.layer.c.job == schema.layer_spec.c.job, schema.layer.c.number == schema.layer_spec.c.layer),
        )
        .where(schema.layer.c.job == job, schema.layer.c.name == layer)
    ).scalar_one_or_none()
    if spec is None:
        require_job(connection, job)
        raise FrameNotFoundError(f"jobs/{job} has no layer {layer}")
    return bytes(spec)


def frames(connection: Connection, job: int, limit: int, after: tuple[str, int] | None) -> list[Frame]:
    """See Queue.frames."""
    require_job(connection, job)
    query = SELECT_FRAMES.where(_frame.job == job, text(schema.IS_IMAGE))
    if after is not None:
        query = query.where(tuple_(_frame.layer, _frame.frame) > tuple_(*after))
    query = query.order_by(_frame.layer, _frame.frame).limit(limit)
    return [frame_of(row) for row in connection.execute(query)]


def frame(connection: Connection, job: int, layer: str, number: int) -> Frame:
    """See Queue.frame."""
    row = connection.execute(
        SELECT_FRAMES.where(_frame.job == job, text(schema.IS_IMAGE), _frame.layer == layer, _frame.frame == number)
    ).one_or_none()
    if row is None:
        require_job(connection, job)
        raise FrameNotFoundError(f"jobs/{job} has no image of frame {number} of layer {layer} (yet)")
    return frame_of(row)


def parts(connection: Connection, job: int, numbers: Sequence[int]) -> list[Frame]:
    """See Queue.parts."""
    query = SELECT_FRAMES.where(_frame.job == job, _frame.task.in_(numbers)).order_by(_frame.task, _frame.frame)
    return [frame_of(row) for row in connection.execute(query)]


def staged(connection: Connection) -> list[StagedFrame]:
    """See Queue.staged."""
    held = schema.staged_frame.c
    query = (
        SELECT_ATTEMPTS.add_columns(*(held[name] for name in FRAME_COLUMNS), held.temp_path)
        .join_from(
            schema.attempt,
            schema.staged_frame,
            and_(_attempt.job == held.job, _attempt.task == held.task, _attempt.number == held.attempt),
        )
        .order_by(held.job, held.task, held.frame)
    )
    size = len(SELECT_ATTEMPTS.selected_columns)
    rows: Iterable[Any] = connection.execute(query)
    return [StagedFrame(attempt_of(row[:size]), frame_of(row[size:-1]), row[-1]) for row in rows]


def events(connection: Connection, job: int, after: int, limit: int) -> list[Event]:
    """See Queue.events."""
    query = select(schema.event).where(_event.job == job, _event.id > after).order_by(_event.id).limit(limit)
    return [
        Event(
            id=row.id,
            time=row.time,
            job=row.job,
            kind=EventKind(row.kind),
            task=row.task,
            layer=row.layer,
            frame=row.frame,
            state=row.state,
        )
        for row in connection.execute(query)
    ]


def last_event(connection: Connection) -> int:
    """See Queue.last_event."""
    return int(connection.execute(select(func.coalesce(func.max(_event.id), 0))).scalar_one())


def bundles_in_use(connection: Connection) -> set[str]:
    """See Queue.bundles_in_use."""
    return set(connection.execute(select(schema.job_bundle.c.digest).distinct()).scalars())
