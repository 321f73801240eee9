"""Where tasks have failed: what a lane is blamed for, and which jobs do not use it any more."""

from collections.abc import Sequence

from sqlalchemy import Connection, bindparam, delete, func, insert, select, update

from footlight_server.farm.model import Attempt
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.transaction import Transaction

_failure, _blame = schema.lane_failure.c, schema.lane_blame.c

_SELECT_BLAME = select(_blame.job, _blame.lane, _blame.tasks).where(_blame.job.in_(bindparam("jobs", expanding=True)))


def failed_tasks(connection: Connection, jobs: Sequence[int]) -> dict[int, dict[str, int]]:
    """By job and lane: how many tasks of the job failed there, where any did."""
    found: dict[int, dict[str, int]] = {}
    for job, lane, tasks in connection.execute(_SELECT_BLAME, {"jobs": jobs}):
        found.setdefault(job, {})[lane] = tasks
    return found


def failed_on(connection: Connection, job: int, task: int) -> frozenset[str]:
    """The lanes on which a task failed."""
    query = select(_failure.lane).where(_failure.job == job, _failure.task == task)
    return frozenset(connection.execute(query).scalars())


def blame_lane(transaction: Transaction, attempt: Attempt) -> None:
    """An attempt failed in a way that may be its lane's fault. Once per task and lane."""
    connection = transaction.connection
    this = {"job": attempt.job, "lane": attempt.worker}
    if attempt.worker in failed_on(connection, attempt.job, attempt.task):
        return
    connection.execute(insert(schema.lane_failure), {**this, "task": attempt.task})
    counted = connection.execute(
        update(schema.lane_blame)
        .where(_blame.job == attempt.job, _blame.lane == attempt.worker)
        .values(tasks=_blame.tasks + 1)
    )
    if not counted.rowcount:
        connection.execute(insert(schema.lane_blame), {**this, "tasks": 1})


def forget_blame(transaction: Transaction, job: int, tasks: Sequence[int]) -> None:
    """These tasks begin anew."""
    connection = transaction.connection
    blamed = set(connection.execute(select(_failure.task).where(_failure.job == job).distinct()).scalars())
    if not blamed & set(tasks):
        return
    connection.execute(
        delete(schema.lane_failure).where(_failure.job == job, _failure.task == bindparam("the_task")),
        [{"the_task": task} for task in blamed & set(tasks)],
    )
    connection.execute(delete(schema.lane_blame).where(_blame.job == job))
    still = (
        select(_failure.job, _failure.lane, func.count())
        .where(_failure.job == job)
        .group_by(_failure.job, _failure.lane)
    )
    connection.execute(insert(schema.lane_blame).from_select(["job", "lane", "tasks"], still))


def blocked_jobs(connection: Connection, lane: str, block_after: int) -> list[int]:
    """Jobs that have not ended of which so many tasks failed on the lane."""
    query = (
        select(_blame.job)
        .join_from(schema.lane_blame, schema.job)
        .where(_blame.lane == lane, _blame.tasks >= block_after, schema.job.c.ended.is_(None))
        .order_by(_blame.job)
    )
    return list(connection.execute(query).scalars())
