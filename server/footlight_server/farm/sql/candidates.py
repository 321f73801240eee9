"""Chooses what a lane may take next: of each job the first task, in the order of claims."""

from collections.abc import Iterator, Sequence
from itertools import count, groupby
from typing import Any

from sqlalchemy import Select, bindparam, exists, func, or_, select, text
from sqlalchemy.sql.elements import ColumnElement

from footlight_server.farm.blocklist import usable_lanes
from footlight_server.farm.model import Lane
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.lanes import failed_tasks
from footlight_server.farm.sql.limits import full_limits
from footlight_server.farm.sql.transaction import Transaction

_job, _layer, _task, _failure = schema.job.c, schema.layer.c, schema.task.c, schema.lane_failure.c

# [jobs] Looked at in turn: almost always the first has a task for the lane. If not, more at once.
_PAGES = (1, 16, 256)
# Before all jobs; priorities are at most 100.
_BEGIN = {"priority": 2**31 - 1, "number": 0}

_SELECT_JOBS = (
    select(_job.number, _job.priority)
    .where(
        text(schema.OPEN_FOR_CLAIMS),
        or_(
            _job.priority < bindparam("priority"),
            (_job.priority == bindparam("priority")) & (_job.number > bindparam("number")),
        ),
    )
    .order_by(_job.priority.desc(), _job.number)
    .limit(bindparam("size"))
)

# Not delayed. A time further ahead than any delay was written before the clock was set back: it does not count.
_IS_DUE = or_(_task.not_before <= bindparam("now"), _task.not_before > bindparam("horizon"))
_FAILED_HERE = exists().where(
    _failure.job == _task.job, _failure.task == _task.number, _failure.lane == bindparam("lane")
)
_LANES_FAILED_ON = (
    select(func.count())
    .select_from(schema.lane_failure)
    .where(
        _failure.job == _task.job,
        _failure.task == _task.number,
        _failure.lane.in_(bindparam("usable", expanding=True)),
    )
    .scalar_subquery()
)


def _first_tasks(*conditions: ColumnElement[bool]) -> Select[Any, Any]:
    """Of each layer of these jobs that no limit holds back the first task, if there is one.

    ix_task_claim has them in order.
    """
    first = (
        select(_task.number)
        .where(
            _task.job == _layer.job, _task.layer == _layer.number, text(f"task.{schema.IS_READY}"), _IS_DUE, *conditions
        )
        .order_by(_task.number)
        .limit(1)
        .correlate(schema.layer)
        .scalar_subquery()
    )
    held_back = exists().where(
        schema.layer_limit.c.job == _layer.job,
        schema.layer_limit.c.layer == _layer.number,
        schema.layer_limit.c.name.in_(bindparam("full", expanding=True)),
    )
    return select(_layer.job, first).where(_layer.job.in_(bindparam("jobs", expanding=True)), ~held_back)


_SELECT_FIRST = _first_tasks()
# Where tasks have failed: as farm/blocklist.py says of `may_take`.
_SELECT_FIRST_ALLOWED = _first_tasks(or_(~_FAILED_HERE, bindparam("usable_count") <= _LANES_FAILED_ON))


def candidates(transaction: Transaction, lane: Lane, live: Sequence[str]) -> Iterator[tuple[int, int]]:
    """(job, task) that the lane may take. `live`: names of the lanes there are."""
    connection, policy = transaction.connection, transaction.policy
    full = full_limits(connection, lane.host)
    after = _BEGIN
    for turn in count():
        size = _PAGES[min(turn, len(_PAGES) - 1)]
        page = connection.execute(_SELECT_JOBS, {**after, "size": size}).all()
        if not page:
            return
        after = {"priority": page[-1].priority, "number": page[-1].number}
        failed = failed_tasks(connection, [row.number for row in page])

        def usable_for(number: int, failed: dict[int, dict[str, int]] = failed) -> tuple[str, ...]:
            return usable_lanes(live, failed[number], policy.block_after) if number in failed else ()

        # Jobs of which nothing has failed use all lanes; they are `()` here.
        for usable, jobs in groupby((row.number for row in page), key=usable_for):
            if not usable or lane.name in usable:
                yield from _first_of_each(transaction, list(jobs), lane, full, usable)


def _first_of_each(
    transaction: Transaction, jobs: Sequence[int], lane: Lane, full: Sequence[str], usable: Sequence[str]
) -> Iterator[tuple[int, int]]:
    """`usable`: the lanes these jobs use; empty if nothing of them has failed yet."""
    values: dict[str, object] = {
        "jobs": jobs,
        "full": full,
        "now": transaction.now,
        "horizon": transaction.now + transaction.policy.longest_pause,
    }
    if usable:
        values |= {"lane": lane.name, "usable": usable, "usable_count": len(usable)}
    first: dict[int, int] = {}
    statement = _SELECT_FIRST_ALLOWED if usable else _SELECT_FIRST
    for job, task in transaction.connection.execute(statement, values):
        if task is not None:
            first[job] = min(task, first.get(job, task))
    return ((job, first[job]) for job in jobs if job in first)
