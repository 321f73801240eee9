"""From rows to the plain values of farm/model.py."""

import json
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, Row, and_, bindparam, select
from sqlalchemy.sql import Select

from footlight_server.farm.model import (
    Attempt,
    ExitClass,
    Frame,
    Job,
    JobState,
    Task,
    TaskCounts,
    TaskKind,
    TaskState,
)
from footlight_server.farm.sql import schema

_job, _task, _attempt = schema.job.c, schema.task.c, schema.attempt.c
COUNTS = tuple(TaskCounts.__slots__)

SELECT_JOBS: Select[*tuple[Any, ...]] = select(schema.job, schema.job_spec.c.spec).join_from(
    schema.job, schema.job_spec
)
_SELECT_TAGS = (
    select(schema.job_tag.c.job, schema.job_tag.c.tag)
    .where(schema.job_tag.c.job.in_(bindparam("jobs", expanding=True)))
    .order_by(schema.job_tag.c.tag)
)
_ATTEMPT = (
    _attempt.job,
    _attempt.task,
    _attempt.number,
    _attempt.worker,
    _attempt.host,
    _attempt.started,
    _attempt.ended,
    _attempt.exit_class,
    _attempt.message,
    _attempt.prim_path,
    _attempt.peak_memory_bytes,
)
SELECT_ATTEMPTS: Select[*tuple[Any, ...]] = select(*_ATTEMPT)
# With the last attempt, if there is one.
SELECT_TASKS: Select[*tuple[Any, ...]] = (
    select(
        _task.job,
        _task.number,
        schema.layer.c.name,
        _task.kind,
        _task.frames,
        _task.sample_begin,
        _task.sample_end,
        _task.state,
        _task.frames_done,
        _task.failures,
        _task.attempt,
        _task.not_before,
        *_ATTEMPT,
    )
    .join_from(schema.task, schema.layer, and_(schema.layer.c.job == _task.job, schema.layer.c.number == _task.layer))
    .outerjoin(
        schema.attempt,
        and_(_attempt.job == _task.job, _attempt.task == _task.number, _attempt.number == _task.attempt),
    )
)
FRAME_COLUMNS = ("job", "layer", "frame", "path", "sha256", "size_bytes", "task", "attempt", "stats")
SELECT_FRAMES = select(*(schema.frame.c[name] for name in FRAME_COLUMNS))


def jobs_of(connection: Connection, rows: Sequence[Row[*tuple[Any, ...]]]) -> list[Job]:
    """Jobs of rows of SELECT_JOBS, with their tags."""
    tags: dict[int, list[str]] = {}
    for number, tag in connection.execute(_SELECT_TAGS, {"jobs": [row.number for row in rows]}):
        tags.setdefault(number, []).append(tag)
    return [_job_of(row, tuple(tags.get(row.number, ()))) for row in rows]


def _job_of(row: Row[*tuple[Any, ...]], tags: tuple[str, ...]) -> Job:
    return Job(
        number=row.number,
        title=row.title,
        user=row.user,
        spec=row.spec,
        state=JobState(row.state),
        paused=bool(row.paused),
        priority=row.priority,
        retries=row.retries,
        show=row.show,
        shot=row.shot,
        tags=tags,
        created=row.created,
        started=row.started,
        ended=row.ended,
        counts=TaskCounts(**{name: getattr(row, name) for name in COUNTS}),
        frames_done=row.frames_done,
        frames_total=row.frames_total,
        render_seconds=row.render_seconds,
    )


def task_of(row: Row[*tuple[Any, ...]]) -> Task:
    """A task of a row of SELECT_TASKS. By position: a page has a thousand of them."""
    job, number, layer, kind, frames, begin, end, state, done, failures, attempt, not_before, *last = row
    return Task(
        job,
        number,
        layer,
        TaskKind(kind),
        frames_from(frames),
        begin,
        end,
        TaskState(state),
        done,
        failures,
        attempt,
        not_before,
        attempt_of(last) if last[0] is not None else None,
    )


def attempt_of(row: Sequence[Any]) -> Attempt:
    """An attempt of a row of SELECT_ATTEMPTS."""
    job, task, number, worker, host, started, ended, how, message, prim_path, peak = row
    exit_class = None if how is None else ExitClass(how)
    return Attempt(job, task, number, worker, host, started, ended, exit_class, message, prim_path, peak)


def frame_of(row: Row[*tuple[Any, ...]]) -> Frame:
    """A frame of a row of SELECT_FRAMES."""
    return Frame(*row)


def frames_to(frames: Sequence[int]) -> str:
    """Frame numbers as they are kept."""
    return json.dumps(frames, separators=(",", ":"))


def frames_from(kept: str) -> tuple[int, ...]:
    """And back."""
    return tuple(json.loads(kept))
