"""`footlight why`: what a job or task waits for."""

import sys
from collections.abc import Iterator

from footlight.cli.connect import connect
from footlight.cli.job import tasks
from footlight.cli.options import Connection
from footlight.cli.report import note, usage
from footlight.cli.tables import write_json
from footlight.cli.words import complaint, job_word, task_word
from footlight.job_calls import has_ended
from footlight.jobs import Job
from footlight.names import job_of, job_or_task_name, number_of, short
from footlight.v1 import job_pb2


def run_why(connection: Connection, name: str, *, as_json: bool) -> None:
    """Print the reasons, the first to be mended first; of what does not wait, say what it does."""
    with usage():
        name = job_or_task_name(name)
    with connect(connection) as client:
        job = client.farm.job(job_of(name))
        reasons = job.why(name)
        instead = [] if reasons or as_json else list(_instead(job, name))
    if as_json:
        write_json({"name": name, "reasons": [*reasons]})
        return
    sys.stdout.writelines(f"{reason}\n" for reason in reasons)
    for line in instead:
        note(line)


def _instead(job: Job, name: str) -> Iterator[str]:
    """What it does; of a job that runs also what the first of its tasks waits for that does not."""
    if name != job.name:
        # The number of a task is its place among the tasks of its job.
        *_, task = job.tasks(count=number_of(name))
        yield of_task(task)
        return
    yield of_job(job.get())
    waiting = [task for state in ("ready", "blocked") for task in job.tasks(states=[state], count=1)]
    for task in waiting[:1]:
        yield from (f"{short(task.name)}: {reason}" for reason in job.why(task.name))


def of_job(job: job_pb2.Job) -> str:
    """What a job does that waits for nothing."""
    if not has_ended(job):
        return f"{job.name} is {job_word(job)}: {tasks(job.tasks)}"
    more = f"; `footlight job {short(job.name)}` shows what failed" if job.tasks.failed else ""
    return f"{job.name} has ended: {job_word(job)}{more}"


def of_task(task: job_pb2.Task) -> str:
    """What a task does that waits for nothing."""
    match task.state:
        case job_pb2.TASK_STATE_RUNNING:
            return f"{task.name} is running on {task.last_attempt.worker}"
        case job_pb2.TASK_STATE_FAILED:
            how = complaint(task.last_attempt)
            return f"{task.name} has failed: {how}; `footlight retry {short(task.name)}` gives it another round"
        case _:
            return f"{task.name} has ended: {task_word(task)}"
