"""`footlight tasks`: the tasks of a job, or the attempts at one of them, as a table."""

from collections.abc import Sequence
from itertools import islice

from footlight.cli.connect import connect
from footlight.cli.options import Connection
from footlight.cli.report import note, usage
from footlight.cli.tables import write_json, write_table
from footlight.cli.words import (
    complaint,
    exit_word,
    frames_of,
    lasted,
    moment,
    progress_of,
    samples_of,
    size,
    task_word,
)
from footlight.client import Client
from footlight.names import job_of, job_or_task_name, number_of, short
from footlight.plain import plain
from footlight.v1 import job_pb2

TASKS = ("TASK", "LAYER", "FRAMES", "SAMPLES", "STATE", "DONE", "TRIES", "WORKER", "TIME", "REMARK")
ATTEMPTS = ("ATTEMPT", "WORKER", "STARTED", "TIME", "ENDED AS", "MEMORY", "MESSAGE")


def run_tasks(
    connection: Connection, name: str, states: Sequence[str], layer: str, count: int, *, as_json: bool
) -> None:
    """Print at most `count` tasks of a job, 0 for all of them, or all attempts at a task."""
    with usage():
        name = job_or_task_name(name)
    with connect(connection) as client:
        if job_of(name) != name:
            _attempts(client.farm.job(job_of(name)).attempts(name), as_json=as_json)
        else:
            _tasks(client, name, states, layer, count, as_json=as_json)


def _tasks(client: Client, name: str, states: Sequence[str], layer: str, count: int, *, as_json: bool) -> None:
    with usage():
        # One more tells whether there are more.
        found = client.farm.job(name).tasks(states=states, layer=layer, count=count + 1 if count else None)
        tasks = list(islice(found, count + 1 if count else None))
    more, tasks = bool(count and len(tasks) > count), tasks[: count or None]
    if as_json:
        write_json([plain(task) for task in tasks])
        return
    write_table(TASKS, map(_row, tasks), right=("TASK", "DONE", "TRIES", "TIME"), fold=("REMARK",))
    if not tasks:
        note("no such tasks")
    elif more:
        note(f"the first {count}; --count N shows more, --count 0 all")


def _row(task: job_pb2.Task) -> tuple[str, ...]:
    merge = task.kind == job_pb2.TASK_KIND_MERGE
    return (
        short(task.name),
        task.layer,
        frames_of(task),
        "merge" if merge else samples_of(task),
        task_word(task),
        f"{task.frames_done}/{len(task.frames)}",
        str(task.attempts),
        task.last_attempt.worker,
        lasted(task.last_attempt),
        _remark(task),
    )


def _remark(task: job_pb2.Task) -> str:
    if task.state == job_pb2.TASK_STATE_RUNNING:
        return progress_of(task)
    ended = task.last_attempt.exit_class
    return (
        "" if ended in (job_pb2.EXIT_CLASS_UNSPECIFIED, job_pb2.EXIT_CLASS_SUCCEEDED) else complaint(task.last_attempt)
    )


def _attempts(attempts: list[job_pb2.Attempt], *, as_json: bool) -> None:
    if as_json:
        write_json([plain(attempt) for attempt in attempts])
        return
    rows = [
        (
            str(number_of(attempt.name)),
            attempt.worker,
            moment(attempt, "start_time"),
            lasted(attempt),
            exit_word(attempt),
            size(attempt.peak_memory_bytes) if attempt.peak_memory_bytes else "",
            attempt.message,
        )
        for attempt in attempts
    ]
    write_table(ATTEMPTS, rows, right=("ATTEMPT", "TIME", "MEMORY"), fold=("MESSAGE",))
    if not attempts:
        note("no attempts yet; `footlight why` says what the task waits for")
