"""Puts a job into the queue, in a handful of statements however many tasks it has."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice

from sqlalchemy import Table, insert, select

from footlight_server.farm.model import Job, JobPlan, JobState, TaskCounts, TaskKind, TaskPlan
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.reads import job_numbered, job_of_request
from footlight_server.farm.sql.rows import frames_to
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.transitions import initial, job_state
from footlight_server.sessions.errors import JobNotFoundError, RequestIdReusedError

# [rows] At once: enough to be fast, few enough to be small.
_BATCH = 5000

_Rows = Iterable[Mapping[str, object]]


def create_job(transaction: Transaction, plan: JobPlan) -> Job:
    """See Queue.create_job. Raises ValueError for a plan that contradicts itself."""
    if plan.request_id and (made := job_of_request(transaction.connection, plan.user, plan.request_id)):
        if made.spec != plan.spec:
            raise RequestIdReusedError(f"request_id {plan.request_id} made another job before: jobs/{made.number}")
        return made
    _check(plan)
    return job_numbered(transaction.connection, _insert(transaction, plan))


def _check(plan: JobPlan) -> None:
    names = {layer.name for layer in plan.layers}
    if len(names) != len(plan.layers):
        raise ValueError("layers of one name")
    if unknown := {task.layer for task in plan.tasks} - names:
        raise ValueError(f"tasks of layers that are not there: {sorted(unknown)}")
    if any(not 0 <= need < index for index, task in enumerate(plan.tasks) for need in task.needs):
        raise ValueError("a task needs one that does not come before it")
    images = Counter((plan.tasks[i].layer, frame) for i in _images(plan) for frame in plan.tasks[i].frames)
    if twice := [image for image, count in images.items() if count > 1]:
        raise ValueError(f"frames that two tasks make: {twice[:3]}")


def _images(plan: JobPlan) -> list[int]:
    """Indices of the tasks whose frames are images, not parts of one."""
    parts = _parts(plan.tasks)
    return [index for index in range(len(plan.tasks)) if index not in parts]


def _parts(tasks: Iterable[TaskPlan]) -> frozenset[int]:
    return frozenset(need for task in tasks if task.kind is TaskKind.MERGE for need in task.needs)


def _insert(transaction: Transaction, plan: JobPlan) -> int:
    waits_for = _unmet_jobs(transaction, plan)
    layer_number = {layer.name: number for number, layer in enumerate(plan.layers)}
    totals = Counter(layer_number[task.layer] for task in plan.tasks)
    # A layer without tasks is done from the start.
    layer_needs = {
        number: sorted({layer_number[name] for name in layer.depends}) for number, layer in enumerate(plan.layers)
    }
    layer_unmet = {number: sum(totals[need] > 0 for need in needs) for number, needs in layer_needs.items()}
    gated = [bool(waits_for or layer_unmet[layer_number[task.layer]] or task.needs) for task in plan.tasks]
    counts = TaskCounts(blocked=sum(gated), ready=len(gated) - sum(gated))
    state = job_state(counts, started=False, cancelling=False, waits=bool(waits_for))
    number: int = transaction.connection.execute(
        insert(schema.job).returning(schema.job.c.number),
        {
            "title": plan.title,
            "user": plan.user,
            "state": state.value,
            "paused": plan.paused,
            "priority": plan.priority,
            "retries": plan.retries,
            "show": plan.show,
            "shot": plan.shot,
            "request_id": plan.request_id,
            "created": transaction.now,
            "ended": transaction.now if state.ended else None,
            "unmet": len(waits_for),
            "blocked": counts.blocked,
            "ready": counts.ready,
            "frames_total": sum(len(plan.tasks[index].frames) for index in _images(plan)),
        },
    ).scalar_one()

    def add(table: Table, rows: _Rows) -> None:
        given = iter(rows)
        while batch := [{"job": number, **row} for row in islice(given, _BATCH)]:
            transaction.connection.execute(insert(table), batch)

    add(schema.job_spec, [{"spec": plan.spec}])
    add(schema.job_tag, [{"tag": tag} for tag in dict.fromkeys(plan.tags)])
    add(schema.job_bundle, [{"digest": digest} for digest in dict.fromkeys(plan.bundles)])
    add(schema.job_need, [{"needs": need} for need in dict.fromkeys(plan.depends)])
    add(schema.layer_spec, [{"layer": number, "spec": layer.spec} for number, layer in enumerate(plan.layers)])
    add(
        schema.layer,
        [
            {
                "number": index,
                "name": layer.name,
                "total": totals[index],
                "tasks_left": totals[index],
                "unmet": layer_unmet[index],
            }
            for index, layer in enumerate(plan.layers)
        ],
    )
    add(schema.layer_need, [{"layer": index, "needs": need} for index, needs in layer_needs.items() for need in needs])
    add(
        schema.layer_limit,
        [{"layer": index, "name": name} for index, of in enumerate(plan.layers) for name in dict.fromkeys(of.limits)],
    )
    add(schema.task, _task_rows(plan, layer_number, gated))
    add(
        schema.task_need,
        ({"task": index + 1, "needs": need + 1} for index, task in enumerate(plan.tasks) for need in set(task.needs)),
    )
    transaction.job_changed(number, state)
    return number


def _task_rows(plan: JobPlan, layer_number: Mapping[str, int], gated: list[bool]) -> Iterator[Mapping[str, object]]:
    parts = _parts(plan.tasks)
    for index, task in enumerate(plan.tasks):
        yield {
            "number": index + 1,
            "layer": layer_number[task.layer],
            "kind": task.kind.value,
            "part": index in parts,
            "frames": frames_to(task.frames),
            "sample_begin": task.sample_begin,
            "sample_end": task.sample_end,
            "state": initial(gated=gated[index]).state.value,
            "unmet": len(set(task.needs)),
        }


def _unmet_jobs(transaction: Transaction, plan: JobPlan) -> list[int]:
    """Of the jobs it depends on, those that have not succeeded. Raises JobNotFoundError."""
    if not plan.depends:
        return []
    query = select(schema.job.c.number, schema.job.c.state).where(schema.job.c.number.in_(plan.depends))
    found = {row.number: row.state for row in transaction.connection.execute(query)}
    for number in plan.depends:
        if number not in found:
            raise JobNotFoundError(f"no job jobs/{number} to depend on")
    return [number for number, state in found.items() if state != JobState.SUCCEEDED]
