"""Looking at the queue: `footlight jobs`, `job`, `tasks`, `log`, `watch`, `why`, `fetch`, `workers`."""

from typing import Annotated, Literal, Optional

import typer

from footlight.cli.options import AsJson, Connection, JobName, MappedConnection

Words = Optional[list[str]]  # noqa: UP045 typer reads it at run time
JobOrTask = Annotated[str, typer.Argument(metavar="JOB[/TASK]", help="A job or one of its tasks: 12 or 12/3.")]


def jobs(
    connection: Connection,
    *,
    state: Annotated[
        Words,
        typer.Option(
            metavar="STATE",
            help="queued (those that are paused too), running, succeeded, failed, cancelling, cancelled. "
            "May be repeated.",
        ),
    ] = None,
    user: Annotated[str, typer.Option(metavar="NAME", help="Jobs of this user only.")] = "",
    show: Annotated[str, typer.Option(metavar="NAME", help="Jobs of this production only.")] = "",
    shot: Annotated[str, typer.Option(metavar="NAME", help="Jobs of this shot only.")] = "",
    tag: Annotated[str, typer.Option(metavar="WORD", help="Jobs with this tag only.")] = "",
    count: Annotated[int, typer.Option("-n", "--count", min=1, metavar="N", help="At most so many.")] = 50,
    as_json: AsJson = False,
) -> None:
    """List jobs, newest first."""
    from footlight.cli.jobs import run_jobs  # noqa: PLC0415

    run_jobs(connection, count, as_json=as_json, states=state or (), user=user, show=show, shot=shot, tag=tag)


def job(name: JobName, connection: MappedConnection, *, as_json: AsJson = False) -> None:
    """Show one job: its state, its layers, what has failed and why."""
    from footlight.cli.job import run_job  # noqa: PLC0415

    run_job(connection, name, as_json=as_json)


def tasks(
    name: JobOrTask,
    connection: Connection,
    *,
    state: Annotated[
        Words,
        typer.Option(
            metavar="STATE", help="blocked, ready, running, succeeded, failed, skipped, cancelled. May be repeated."
        ),
    ] = None,
    layer: Annotated[str, typer.Option(metavar="NAME", help="Tasks of this layer only.")] = "",
    count: Annotated[int, typer.Option("-n", "--count", min=0, metavar="N", help="At most so many; 0 for all.")] = 100,
    as_json: AsJson = False,
) -> None:
    """List the tasks of a job, or all attempts at one task."""
    from footlight.cli.tasks import run_tasks  # noqa: PLC0415

    run_tasks(connection, name, state or [], layer, count, as_json=as_json)


def log(
    name: Annotated[
        str,
        typer.Argument(metavar="JOB/TASK[/ATTEMPT]", help="12/3 for the last attempt at task 3, 12/3/1 for the first."),
    ],
    connection: Connection,
    *,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Stay until the attempt has ended.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print the log of an attempt. With --json one object for each piece."""
    from footlight.cli.log import run_log  # noqa: PLC0415

    run_log(connection, name, follow=follow, as_json=as_json)


def watch(
    name: JobName,
    connection: MappedConnection,
    *,
    tev: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT",
            help="Send the running frames, as they converge, to a viewer that speaks tev's protocol: tev "
            "(localhost:14158) or HDRView. Needs footlight[tev].",
        ),
    ] = "",
    after: Annotated[
        Optional[int],  # noqa: UP045 typer reads it at run time
        typer.Option(
            min=0, metavar="ID", help="Only events after this one, for --json.", show_default="from the beginning"
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Watch a job until it has ended: exit code 0 if it succeeded, 1 if it failed, 130 if it was cancelled.

    Goes on by itself when the server comes back after a restart. Ctrl-C leaves the job running. With --json one object
    for each event, from the beginning of the job.
    """
    from footlight.cli.watch import run_watch  # noqa: PLC0415

    if after is not None and not as_json:
        raise typer.BadParameter("is for --json, which is not asked for", param_hint="--after")
    run_watch(connection, name, tev=tev, after=after or 0, as_json=as_json)


def why(name: JobOrTask, connection: Connection, *, as_json: AsJson = False) -> None:
    """Say why a job or task is not running; the first line is what has to change first."""
    from footlight.cli.why import run_why  # noqa: PLC0415

    run_why(connection, name, as_json=as_json)


def fetch(
    name: JobName,
    connection: MappedConnection,
    *,
    output: Annotated[
        str,
        typer.Option(
            "-o",
            "--output",
            metavar="PATTERN",
            help="Where to: a directory, or a file name with #### or $F4 or <frame>, and <layer>.",
        ),
    ] = ".",
    image_format: Annotated[
        Literal["exr", "png", "thumbnail", "contact-sheet"], typer.Option("--format", help="Which image of each frame.")
    ] = "exr",
    layer: Annotated[str, typer.Option(metavar="NAME", help="Frames of this layer only.")] = "",
    frame: Annotated[
        Optional[list[int]],  # noqa: UP045 typer reads it at run time
        typer.Option(metavar="N", help="This frame only. May be repeated."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fetch the images of a job as far as they are done. EXR files that are here already are left alone."""
    from footlight.cli.fetch import run_fetch  # noqa: PLC0415

    run_fetch(connection, name, output, image_format, layer, frame or [], as_json=as_json)


def workers(connection: Connection, *, as_json: AsJson = False) -> None:
    """List the places where tasks can run, and what they do."""
    from footlight.cli.workers import run_workers  # noqa: PLC0415

    run_workers(connection, as_json=as_json)
