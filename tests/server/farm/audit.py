"""Whether a queue's database contradicts itself: everything that is kept is counted anew."""

from collections import Counter

from sqlalchemy import Connection, select

from footlight_server.farm.model import JobState, TaskCounts, TaskState
from footlight_server.farm.queue import Queue
from footlight_server.farm.sql import schema
from footlight_server.farm.transitions import DONE_STATES, job_state


async def audit(queue: Queue) -> None:
    """Fails with what is wrong."""
    assert await queue._read(contradictions) == []


def contradictions(connection: Connection) -> list[str]:
    """What does not agree, in words."""
    jobs = {row.number: row for row in connection.execute(select(schema.job))}
    layers = {(row.job, row.number): row for row in connection.execute(select(schema.layer))}
    tasks = {(row.job, row.number): row for row in connection.execute(select(schema.task))}
    running = Counter(
        (row.job, row.task, row.number)
        for row in connection.execute(select(schema.attempt).where(schema.attempt.c.ended.is_(None)))
    )
    done = {key for key, row in tasks.items() if row.state in DONE_STATES}
    needs: Counter[tuple[int, int]] = Counter(
        (row.job, row.task) for row in connection.execute(select(schema.task_need)) if (row.job, row.needs) not in done
    )
    left = Counter((row.job, row.layer) for key, row in tasks.items() if key not in done)
    layer_needs: Counter[tuple[int, int]] = Counter(
        (row.job, row.layer) for row in connection.execute(select(schema.layer_need)) if left[row.job, row.needs]
    )
    succeeded = {number for number, row in jobs.items() if row.state == JobState.SUCCEEDED}
    # A job that is gone and was needed had succeeded: others are not pruned.
    job_needs: Counter[int] = Counter(
        row.job
        for row in connection.execute(select(schema.job_need))
        if row.needs in jobs and row.needs not in succeeded
    )
    images = Counter(row.job for row in connection.execute(select(schema.frame)) if not row.part)
    blame = Counter((row.job, row.lane) for row in connection.execute(select(schema.lane_failure)))
    wrong = []

    def same(what: str, kept: object, counted: object) -> None:
        if kept != counted:
            wrong.append(f"{what}: kept {kept}, counted {counted}")

    for number, row in jobs.items():
        counted = Counter(task.state for task in tasks.values() if task.job == number)
        counts = TaskCounts(**{state.value: counted[state.value] for state in TaskState})
        same(f"counts of job {number}", TaskCounts(*(getattr(row, name) for name in TaskCounts.__slots__)), counts)
        waits = job_needs[number] > 0
        state = job_state(counts, started=row.started is not None, cancelling=row.cancelling, waits=waits)
        same(f"state of job {number}", row.state, state.value)
        same(f"end of job {number}", row.ended is not None, state.ended)
        same(f"jobs that job {number} waits for", row.unmet, job_needs[number])
        same(f"images of job {number}", row.frames_done, images[number])
    for (job, number), row in layers.items():
        same(f"tasks left of layer {job}/{number}", row.tasks_left, left[job, number])
        same(f"layers that {job}/{number} waits for", row.unmet, layer_needs[job, number])
    for (job, number), row in tasks.items():
        same(f"tasks that {job}/{number} waits for", row.unmet, needs[job, number])
        gated = bool(row.unmet or layers[job, row.layer].unmet or jobs[job].unmet)
        if row.state in {"blocked", "ready"}:
            same(f"whether {job}/{number} waits", row.state, "blocked" if gated else "ready")
        same(f"running attempts of {job}/{number}", running[job, number, row.attempt], int(row.state == "running"))
        if row.stop and row.state != "running":
            wrong.append(f"{job}/{number} is {row.state} and shall stop")
    if strangers := [key for key in running if key[:2] not in tasks or tasks[key[:2]].attempt != key[2]]:
        wrong.append(f"attempts that run and are not current: {strangers}")
    kept_blame = {(row.job, row.lane): row.tasks for row in connection.execute(select(schema.lane_blame))}
    same("blame of lanes", kept_blame, dict(blame))
    return wrong
