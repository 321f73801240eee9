"""`footlight pause`, `resume`, `cancel`, `retry`, `skip`, `prune`."""

import sys
from collections.abc import Callable, Sequence

import typer

from footlight.cli.connect import connect
from footlight.cli.options import Connection
from footlight.cli.parse import duration
from footlight.cli.report import note, usage
from footlight.cli.tables import write_json
from footlight.cli.words import count, job_word, size
from footlight.jobs import Job
from footlight.names import job_name, job_of, job_or_task_name
from footlight.plain import plain
from footlight.v1 import job_pb2


def run_pause(connection: Connection, names: Sequence[str], *, as_json: bool) -> None:
    """Pause the jobs."""
    _steer(connection, names, Job.pause, as_json=as_json)


def run_resume(connection: Connection, names: Sequence[str], *, as_json: bool) -> None:
    """Resume the jobs."""
    _steer(connection, names, Job.resume, as_json=as_json)


def run_cancel(connection: Connection, names: Sequence[str], *, as_json: bool) -> None:
    """Cancel the jobs."""
    _steer(connection, names, Job.cancel, as_json=as_json)


def _steer(
    connection: Connection, names: Sequence[str], action: Callable[[Job], job_pb2.Job], *, as_json: bool
) -> None:
    """Do it to one after the other; the first that cannot be ends it, and what was done before is said."""
    with usage():
        names = [job_name(name) for name in names]
    jobs: list[job_pb2.Job] = []
    with connect(connection) as client:
        try:
            jobs.extend(action(client.farm.job(name)) for name in names)
        finally:
            if as_json:
                write_json([plain(job) for job in jobs])
            else:
                sys.stdout.writelines(f"{job.name}: {job_word(job)}\n" for job in jobs)


def run_retry(connection: Connection, names: Sequence[str], layer: str, frames: str, *, as_json: bool) -> None:
    """Retry tasks of the jobs, or single tasks."""

    def retry(job: Job, tasks: Sequence[str]) -> int:
        return job.retry(tasks=tasks, layer=layer, frames=frames)

    _choose(connection, names, retry, "to be tried again", as_json=as_json)


def run_skip(
    connection: Connection, names: Sequence[str], layer: str, frames: str, *, every: bool, as_json: bool
) -> None:
    """Skip tasks of the jobs, or single tasks; a job alone chooses nothing."""
    with usage():
        whole = [name for name in map(job_or_task_name, names) if job_of(name) == name]
    if whole and not (layer or frames or every):
        raise typer.BadParameter(
            f"{whole[0]} alone chooses nothing; name tasks, as in 12/3, or --frames, --layer or --all", param_hint="JOB"
        )

    def skip(job: Job, tasks: Sequence[str]) -> int:
        if tasks or layer or frames:
            return job.skip(tasks=tasks, layer=layer, frames=frames)
        return sum(job.skip(layer=each.name) for each in job.get().spec.layers)

    _choose(connection, names, skip, "skipped", as_json=as_json)


def _choose(
    connection: Connection,
    names: Sequence[str],
    action: Callable[[Job, Sequence[str]], int],
    done: str,
    *,
    as_json: bool,
) -> None:
    """Tasks of one job go in one call. Prints how many have changed, also where a later job ends it."""
    with usage():
        names = [job_or_task_name(name) for name in names]
    tasks = {job_of(name): [task for task in names if job_of(task) == job_of(name) != task] for name in names}
    changed: dict[str, int] = {}
    with connect(connection) as client:
        try:
            for job, chosen in tasks.items():
                changed[job] = action(client.farm.job(job), chosen)
        finally:
            if as_json:
                write_json([{"job": job, "changed": number} for job, number in changed.items()])
            else:
                sys.stdout.writelines(f"{job}: {count(number, 'task')} {done}\n" for job, number in changed.items())


def run_prune(connection: Connection, names: Sequence[str], older_than: str, *, dry_run: bool, as_json: bool) -> None:
    """Prune these jobs, or all of an age."""
    seconds = duration(older_than, "--older-than")
    if bool(names) == bool(older_than):
        raise typer.BadParameter("name jobs, or --older-than TIME, and not both", param_hint="JOB")
    with usage():
        names = [job_name(name) for name in names]
    with connect(connection) as client:
        answer = client.farm.prune(names, older_than=seconds, dry_run=dry_run)
    if as_json:
        write_json(plain(answer))
        return
    sys.stdout.writelines(f"{name}\n" for name in answer.jobs)
    # Nothing has been measured in a dry run.
    done = "would be pruned" if dry_run else f"pruned, {size(answer.freed_bytes)} freed"
    note(f"{count(len(answer.jobs), 'job')} {done}")
