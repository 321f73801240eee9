"""`footlight render`, `footlight explain`: one image now."""

from pathlib import Path
from typing import Annotated, Optional

import typer

from footlight.cli.options import AsJson, OwnConnection, RenderOptions, StageOptions, Upload

Frame = Annotated[
    Optional[float],  # noqa: UP045 typer reads it at run time
    typer.Option(metavar="T", help="Time code at which everything is read. Default: the stage's start."),
]


def render(
    options: RenderOptions,
    connection: OwnConnection,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.exr", help="The EXR to write; - for stdout.")],
    frame: Frame = None,
    stats: Annotated[
        Optional[Path],  # noqa: UP045 typer reads it at run time
        typer.Option(metavar="FILE.json", help="Write what the render cost: seconds, rays, effects, guards, memory."),
    ] = None,
    png: Annotated[
        Optional[Path],  # noqa: UP045 typer reads it at run time
        typer.Option(
            metavar="FILE", help="Also write a picture for looking at, plain sRGB unless --view names a view."
        ),
    ] = None,
    upload: Upload = False,
    keep_partial: Annotated[
        bool, typer.Option("--keep-partial", help="On Ctrl-C, write the image as far as it has converged.")
    ] = False,
) -> None:
    """Render STAGE to an EXR.

    Ctrl-C cancels the render on the server; a second one leaves at once.
    """
    from footlight.cli.render import Outputs, run_render  # noqa: PLC0415

    if options.view and png is None:
        raise typer.BadParameter("is for the picture of --png, which is not asked for", param_hint="--view")
    arguments = {**options.arguments(), "time_code": frame, "png": png is not None}
    run_render(Outputs(output, png, stats), connection, arguments, upload=upload, keep_partial=keep_partial)


def explain(
    options: StageOptions,
    connection: OwnConnection,
    *,
    frame: Frame = None,
    as_json: AsJson = False,
) -> None:
    """Say what STAGE calls for, without rendering.

    The effects and the prims that asked for them, the pipeline that results, what was assumed, and what was left out
    and why.
    """
    from footlight.cli.explain import run_explain  # noqa: PLC0415

    run_explain(connection, {**options.arguments(), "time_code": frame}, as_json=as_json)
