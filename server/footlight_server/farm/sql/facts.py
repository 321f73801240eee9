"""Gathers why something waits; farm/why.py puts it into words. And when the next delay ends."""

from typing import Any

from sqlalchemy import Connection, Row, and_, case, func, literal_column, or_, select, text

from footlight_server.farm.model import JobState, TaskState
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.lanes import failed_on, failed_tasks
from footlight_server.farm.sql.limits import limits
from footlight_server.farm.sql.reads import running, task_numbered
from footlight_server.farm.transitions import DONE_STATES, WAITING_STATES, Policy
from footlight_server.farm.why import WaitedLayer, WaitFacts
from footlight_server.sessions.errors import JobNotFoundError

_job, _layer, _task = schema.job.c, schema.layer.c, schema.task.c

# [tasks] That are named of those waited for.
_NAMED = 3


def wait_facts(connection: Connection, job: int, task: int | None, now: float, policy: Policy) -> WaitFacts:
    """See Queue.wait_facts."""
    of_job = connection.execute(select(schema.job).where(_job.number == job)).one_or_none()
    if of_job is None:
        raise JobNotFoundError(f"no job jobs/{job}")
    number = _first_waiting(connection, of_job) if task is None else task
    if number is None:
        return WaitFacts(job, waits=False)
    found = task_numbered(connection, job, number)
    if found.state not in WAITING_STATES:
        return WaitFacts(job, waits=False)
    layer = connection.execute(select(_task.layer).where(_task.job == job, _task.number == number)).scalar_one()
    tasks, tasks_left = _needed_tasks(connection, job, number)
    names = _limits_of(connection, job, layer)
    return WaitFacts(
        job,
        waits=True,
        now=now,
        paused=bool(of_job.paused),
        jobs=_needed_jobs(connection, job) if of_job.unmet else (),
        layers=_needed_layers(connection, job, layer),
        tasks=tasks,
        tasks_left=tasks_left,
        limits=tuple(limit for limit in limits(connection) if limit.name in names),
        not_before=found.not_before if found.not_before <= now + policy.longest_pause else 0.0,
        last_exit=found.last_attempt.exit_class if found.last_attempt else None,
        failed_on=failed_on(connection, job, number),
        failed_tasks=failed_tasks(connection, [job]).get(job, {}),
        block_after=policy.block_after,
        busy=frozenset(attempt.worker for attempt in running(connection)),
        ahead=_ahead(connection, of_job, number),
    )


def next_wake(connection: Connection, now: float, policy: Policy) -> float | None:
    """See Queue.next_wake."""
    first = connection.execute(
        select(func.min(_task.not_before)).where(
            _task.state == literal_column("'ready'"),
            _task.not_before > literal_column("0"),
            _task.not_before > now,
            _task.not_before <= now + policy.longest_pause,
        )
    ).scalar_one()
    return None if first is None else float(first)


def _first_waiting(connection: Connection, of_job: Row[*tuple[Any, ...]]) -> int | None:
    """The task to explain a job by; None if it runs or has ended."""
    if of_job.running or JobState(of_job.state).ended:
        return None
    for state in (TaskState.READY, TaskState.BLOCKED):
        query = select(func.min(_task.number)).where(_task.job == of_job.number, _task.state == state.value)
        number = connection.execute(query).scalar_one()
        if number is not None:
            return int(number)
    return None


def _needed_jobs(connection: Connection, job: int) -> tuple[tuple[int, str], ...]:
    need = schema.job_need.c
    rows = connection.execute(
        select(need.needs, case((and_(_job.paused, _job.state == JobState.QUEUED.value), "paused"), else_=_job.state))
        .select_from(schema.job_need.outerjoin(schema.job, _job.number == need.needs))
        .where(need.job == job, or_(_job.state.is_(None), _job.state != JobState.SUCCEEDED.value))
        .order_by(need.needs)
    )
    return tuple((number, state or "gone") for number, state in rows)


def _needed_layers(connection: Connection, job: int, layer: int) -> tuple[WaitedLayer, ...]:
    need = schema.layer_need.c
    rows = connection.execute(
        select(_layer.name, _layer.tasks_left, _layer.total)
        .join_from(schema.layer_need, schema.layer, and_(_layer.job == need.job, _layer.number == need.needs))
        .where(need.job == job, need.layer == layer, _layer.tasks_left > 0)
        .order_by(_layer.number)
    )
    return tuple(WaitedLayer(name, left, total) for name, left, total in rows)


def _needed_tasks(connection: Connection, job: int, task: int) -> tuple[tuple[tuple[int, TaskState], ...], int]:
    """The first few that are not done, and how many there are."""
    need = schema.task_need.c
    needed = select(need.needs).where(need.job == job, need.task == task)
    rows = connection.execute(
        select(_task.number, _task.state)
        .where(_task.job == job, _task.number.in_(needed), _task.state.not_in(DONE_STATES))
        .order_by(_task.number)
    ).all()
    return tuple((number, TaskState(state)) for number, state in rows[:_NAMED]), len(rows)


def _limits_of(connection: Connection, job: int, layer: int) -> set[str]:
    of = schema.layer_limit.c
    return set(connection.execute(select(of.name).where(of.job == job, of.layer == layer)).scalars())


def _ahead(connection: Connection, of_job: Row[*tuple[Any, ...]], task: int) -> int:
    """READY tasks that come before this one: of jobs that come before its job, and of its own."""
    earlier = or_(_job.priority > of_job.priority, and_(_job.priority == of_job.priority, _job.number < of_job.number))
    others = connection.execute(
        select(func.coalesce(func.sum(_job.ready), 0)).where(text(schema.OPEN_FOR_CLAIMS), earlier)
    ).scalar_one()
    own = connection.execute(
        select(func.count()).where(
            _task.job == of_job.number, _task.state == TaskState.READY.value, _task.number < task
        )
    ).scalar_one()
    return int(others) + int(own)
