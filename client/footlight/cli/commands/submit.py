"""`footlight submit`: a job for the farm queue."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Optional

import typer

from footlight.cli.options import AsJson, MappedConnection, RenderOptions, Upload


@dataclass(frozen=True, slots=True)
class JobOptions:
    """What a job is, besides how its frames are rendered."""

    PANEL: ClassVar = "Job"

    frames: Annotated[
        str,
        typer.Option(
            metavar="RANGE",
            help="1001-1100; 1-10x2 every second; 1-10y3 all but every third; 1-100:4 all, coarse first; 1,5,9-12. "
            "Default: one frame at the stage's own time.",
        ),
    ] = ""
    output: Annotated[
        str,
        typer.Option(
            "-o",
            "--output",
            metavar="PATTERN",
            help="The EXR of each frame on the server's machine, with #### or $F4 or <frame> for its number. "
            "Default: the server keeps the images for `footlight fetch`.",
        ),
    ] = ""
    png: Annotated[
        bool, typer.Option("--png", help="Also make a picture of each frame, for `footlight fetch --format png`.")
    ] = False
    name: Annotated[str, typer.Option(metavar="TITLE", help="For people. Default: the stage's file name.")] = ""
    show: Annotated[str, typer.Option(metavar="NAME", help="The production it belongs to.")] = ""
    shot: Annotated[str, typer.Option(metavar="NAME", help="The shot it belongs to.")] = ""
    layer: Annotated[str, typer.Option(metavar="NAME", help="Name of its layer.", show_default="main")] = ""
    priority: Annotated[
        Optional[int],  # noqa: UP045 typer reads it at run time
        typer.Option(min=0, max=100, metavar="0-100", help="Higher first.", show_default="50"),
    ] = None
    chunk: Annotated[int, typer.Option(min=1, metavar="N", help="Frames in one task.")] = 1
    split: Annotated[
        int,
        typer.Option(
            min=1, metavar="N", help="Share the samples of each frame out to so many workers; the image is the same."
        ),
    ] = 1
    tag: Annotated[
        Optional[list[str]],  # noqa: UP045 typer reads it at run time
        typer.Option(metavar="WORD", help="To find it by. May be repeated."),
    ] = None
    comment: Annotated[str, typer.Option(metavar="TEXT", help="For people.")] = ""
    depends: Annotated[
        Optional[list[str]],  # noqa: UP045 typer reads it at run time
        typer.Option(metavar="JOB", help="A job that has to succeed before. May be repeated."),
    ] = None
    limit: Annotated[
        Optional[list[str]],  # noqa: UP045 typer reads it at run time
        typer.Option(metavar="NAME", help="A limit that its running tasks count for. May be repeated."),
    ] = None
    retries: Annotated[
        Optional[int],  # noqa: UP045 typer reads it at run time
        typer.Option(
            min=0, max=100, metavar="N", help="How often a task is tried again after a failure.", show_default="2"
        ),
    ] = None
    timeout: Annotated[
        str, typer.Option(metavar="TIME", help="The longest a frame may take: 90s, 15m, 2h.", show_default="no limit")
    ] = ""
    stall_timeout: Annotated[
        str,
        typer.Option(metavar="TIME", help="The longest a frame may go without progress.", show_default="the server's"),
    ] = ""
    env: Annotated[
        Optional[list[str]],  # noqa: UP045 typer reads it at run time
        typer.Option(
            metavar="NAME=VALUE",
            help="A variable for the workers, of those that the server allows; NAME alone for its value here. "
            "May be repeated.",
        ),
    ] = None
    paused: Annotated[bool, typer.Option("--paused", help="Begin paused; `footlight resume` starts it.")] = False


def submit(
    options: RenderOptions,
    job: JobOptions,
    connection: MappedConnection,
    *,
    upload: Upload = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="Check everything, say what would come of it, submit nothing; --upload still sends."
        ),
    ] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Stay and watch, as `footlight watch` does.")] = False,
    as_json: AsJson = False,
) -> None:
    """Put a job into the farm queue: the frames of STAGE. Its name comes on stdout.

    Ctrl-C during --watch leaves the job running.
    """
    from footlight.cli.submit import run_submit  # noqa: PLC0415

    if options.view and not job.png:
        raise typer.BadParameter("is for the pictures of --png, which are not asked for", param_hint="--view")
    run_submit(connection, options, job, upload=upload, dry_run=dry_run, watch=watch, as_json=as_json)
