"""Gives tasks to lanes: each becomes RUNNING in a new attempt."""

from collections.abc import Sequence

from sqlalchemy import bindparam, insert, select

from footlight_server.farm.model import Attempt, Claim, Lane, TaskKind, TaskState
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.candidates import candidates
from footlight_server.farm.sql.job_change import JobChange
from footlight_server.farm.sql.rows import SELECT_TASKS, task_of
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.transitions import Taken

_job, _task = schema.job.c, schema.task.c

_INSERT_ATTEMPT = insert(schema.attempt)
_SELECT_TASK = SELECT_TASKS.where(_task.job == bindparam("the_job"), _task.number == bindparam("the_task"))
_SELECT_SPECS = select(schema.job_spec.c.spec, schema.layer_spec.c.spec, _job.user).where(
    _job.number == bindparam("the_job"),
    schema.job_spec.c.job == _job.number,
    schema.layer_spec.c.job == _job.number,
    schema.layer_spec.c.layer == bindparam("the_layer"),
)
_SELECT_DONE = select(schema.frame.c.frame).where(
    schema.frame.c.job == bindparam("the_job"), schema.frame.c.task == bindparam("the_task")
)
_SELECT_NEEDS = (
    select(schema.task_need.c.needs)
    .where(schema.task_need.c.job == bindparam("the_job"), schema.task_need.c.task == bindparam("the_task"))
    .order_by(schema.task_need.c.needs)
)


def claim_many(transaction: Transaction, lanes: Sequence[Lane], live_lanes: Sequence[Lane]) -> list[Claim]:
    """See Queue.claim_many."""
    live = sorted({lane.name for lane in (*lanes, *live_lanes)})
    claims = (_claim(transaction, lane, live) for lane in lanes)
    return [claim for claim in claims if claim is not None]


def _claim(transaction: Transaction, lane: Lane, live: Sequence[str]) -> Claim | None:
    for job, task in candidates(transaction, lane, live):
        claim = _take(transaction, lane, job, task)
        if claim is not None:
            return claim
    return None


def _take(transaction: Transaction, lane: Lane, job: int, task: int) -> Claim | None:
    change = JobChange(transaction, job)
    row = change.task(task)
    if row is None or row.status.state is not TaskState.READY:
        return None
    [taken] = change.step([row], Taken())
    attempt = Attempt(job, task, taken.status.attempt, lane.name, lane.host, transaction.now)
    transaction.connection.execute(
        _INSERT_ATTEMPT,
        {
            "job": job,
            "task": task,
            "number": attempt.number,
            "worker": attempt.worker,
            "host": attempt.host,
            "started": attempt.started,
        },
    )
    change.write()
    return _claim_of(transaction, attempt, row.layer)


def _claim_of(transaction: Transaction, attempt: Attempt, layer: int) -> Claim:
    """With what running it takes."""
    connection = transaction.connection
    this = {"the_job": attempt.job, "the_task": attempt.task}
    task = task_of(connection.execute(_SELECT_TASK, this).one())
    job_spec, layer_spec, user = connection.execute(_SELECT_SPECS, {"the_job": attempt.job, "the_layer": layer}).one()
    done = connection.execute(_SELECT_DONE, this).scalars() if task.frames_done else ()
    needs = connection.execute(_SELECT_NEEDS, this).scalars() if task.kind is TaskKind.MERGE else ()
    return Claim(
        task=task,
        attempt=attempt,
        layer_spec=bytes(layer_spec),
        job_spec=bytes(job_spec),
        user=user,
        done=frozenset(done),
        needs_from=tuple(needs),
    )
