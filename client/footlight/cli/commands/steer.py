"""Steering jobs: `footlight pause`, `resume`, `cancel`, `retry`, `skip`, `prune`."""

from typing import Annotated, Optional

import typer

from footlight.cli.options import AsJson, Connection, TaskChoice

JobNames = Annotated[list[str], typer.Argument(metavar="JOB", help="Jobs: 12 or jobs/12.")]
Names = Annotated[list[str], typer.Argument(metavar="JOB[/TASK]", help="Jobs or single tasks: 12 or 12/3.")]


def pause(names: JobNames, connection: Connection, *, as_json: AsJson = False) -> None:
    """Start nothing new of these jobs; what runs goes on."""
    from footlight.cli.steer import run_pause  # noqa: PLC0415

    run_pause(connection, names, as_json=as_json)


def resume(names: JobNames, connection: Connection, *, as_json: AsJson = False) -> None:
    """Let paused jobs go on."""
    from footlight.cli.steer import run_resume  # noqa: PLC0415

    run_resume(connection, names, as_json=as_json)


def cancel(names: JobNames, connection: Connection, *, as_json: AsJson = False) -> None:
    """Stop jobs; images that are there stay. A job that has ended is left alone."""
    from footlight.cli.steer import run_cancel  # noqa: PLC0415

    run_cancel(connection, names, as_json=as_json)


def retry(names: Names, choice: TaskChoice, connection: Connection, *, as_json: AsJson = False) -> None:
    """Give tasks that failed, were skipped or cancelled another round.

    Frames that have an image are not rendered again. Opens a job again that has ended.
    """
    from footlight.cli.steer import run_retry  # noqa: PLC0415

    run_retry(connection, names, choice.layer, choice.frames, as_json=as_json)


def skip(
    names: Names,
    choice: TaskChoice,
    connection: Connection,
    *,
    every: Annotated[bool, typer.Option("--all", help="All tasks of the job that have not succeeded.")] = False,
    as_json: AsJson = False,
) -> None:
    """Give up on tasks: they count as done for what depends on them. Needs a task, --layer, --frames or --all."""
    from footlight.cli.steer import run_skip  # noqa: PLC0415

    run_skip(connection, names, choice.layer, choice.frames, every=every, as_json=as_json)


def prune(
    connection: Connection,
    *,
    names: Annotated[
        Optional[list[str]],  # noqa: UP045 typer reads it at run time
        typer.Argument(metavar="JOB", help="Jobs that have ended.", show_default=False),
    ] = None,
    older_than: Annotated[
        str, typer.Option(metavar="TIME", help="All jobs that ended longer ago than this: 12h, 30d.")
    ] = "",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would go, and leave it.")] = False,
    as_json: AsJson = False,
) -> None:
    """Forget jobs that have ended, with their logs and the images the server keeps. Images at an --output path stay."""
    from footlight.cli.steer import run_prune  # noqa: PLC0415

    run_prune(connection, names or [], older_than, dry_run=dry_run, as_json=as_json)
