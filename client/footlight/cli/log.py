"""`footlight log`: the log of an attempt."""

import sys

import typer

from footlight.cli.connect import connect
from footlight.cli.options import Connection
from footlight.cli.report import usage
from footlight.cli.tables import write_json_line
from footlight.jobs import Job
from footlight.names import attempt_or_task_name, job_name, job_of, short


def run_log(connection: Connection, name: str, *, follow: bool, as_json: bool) -> None:
    """Copy the log to stdout, as it comes."""
    with connect(connection) as client:
        name = _task(client.farm.job(job_name(name)), name) if _is_job(name) else _attempt(name)
        for piece in client.farm.job(job_of(name)).log(name, follow=follow):
            if as_json:
                write_json_line({"name": name, "text": piece.decode(errors="replace")})
            else:
                sys.stdout.buffer.write(piece)
                sys.stdout.buffer.flush()


def _attempt(name: str) -> str:
    with usage():
        return attempt_or_task_name(name)


def _is_job(name: str) -> bool:
    try:
        job_name(name)
    except ValueError:
        return False
    return True


def _task(job: Job, said: str) -> str:
    """The only task of a job. Raises typer.BadParameter that helps to choose one."""
    tasks = list(job.tasks(count=2))
    if len(tasks) == 1:
        return tasks[0].name
    failed = [short(task.name) for task in job.tasks(states=["failed"], count=5)][:5]
    hint = f"; {', '.join(failed)} failed" if failed else ""
    raise typer.BadParameter(f"{job.name} has several tasks; name one, as in {said}/1{hint}", param_hint="JOB/TASK")
