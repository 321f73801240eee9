"""The commands and their options; what they do is in modules loaded when a command runs, so that --help is quick."""

from pathlib import Path
from typing import Annotated, Literal, Optional

import typer

from footlight.cli import exits

EPILOG = "Exit codes: " + "; ".join(f"{code.value} {text}" for code, text in exits.HELP.items()) + "."

app = typer.Typer(
    name="footlight",
    help="Render USD stages and watch them converge. Progress goes to stderr, results to files or stdout.",
    epilog=EPILOG,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Stage = Annotated[
    Path, typer.Argument(metavar="STAGE", help="The root layer: .usd, .usda, .usdc or .usdz, on the server's machine.")
]
Server = Annotated[
    str,
    typer.Option(
        metavar="ADDR", help="A running server, HOST:PORT or unix:PATH. Without it one is started for this call."
    ),
]
Camera = Annotated[
    str,
    typer.Option(
        metavar="PATH",
        help="Prim path of the camera. Default: the one of the render settings, else the first, "
        "else one that frames the stage.",
    ),
]
Frame = Annotated[
    Optional[float],  # noqa: UP045 typer reads it at run time
    typer.Option(metavar="T", help="Time code at which everything is read. Default: the stage's start."),
]
Strict = Annotated[bool, typer.Option("--strict", help="Fail on what would be left out of the image.")]


def _version(asked: bool) -> None:
    if asked:
        from footlight import __version__  # noqa: PLC0415

        typer.echo(f"footlight {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    del version


@app.command(epilog=EPILOG)
def render(
    stage: Stage,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.exr", help="The EXR to write; - for stdout.")],
    server: Server = "",
    camera: Camera = "",
    frame: Frame = None,
    size: Annotated[
        str,
        typer.Option(
            metavar="WxH", help="Width and height in pixels, as in 1920x1080. Default: the stage's, else 1280x720."
        ),
    ] = "",
    spp: Annotated[int, typer.Option(min=1, metavar="N", help="Samples per pixel.")] = 64,
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="Same seed, same image, bit for bit.")] = 0,
    max_depth: Annotated[int, typer.Option(min=1, metavar="N", help="The longest path from the camera, in edges.")] = 8,
    threads: Annotated[
        int, typer.Option(min=0, metavar="N", help="Threads to use; 0 for all. The image does not depend on it.")
    ] = 0,
    pixel_filter: Annotated[
        Literal["box", "gaussian", "blackman-harris"], typer.Option(help="Reconstruction filter.")
    ] = "blackman-harris",
    strategy: Annotated[
        Literal["mis", "light", "bsdf"],
        typer.Option(help="How light is found: light and BSDF sampling joined, or one of them alone."),
    ] = "mis",
    aov: Annotated[
        Optional[list[str]],  # noqa: UP045 typer reads it at run time
        typer.Option(
            metavar="NAME",
            help="Another image to write besides color and alpha: depth, normal, albedo, position, error, "
            "sample_count. May be repeated.",
        ),
    ] = None,
    strict: Strict = False,
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
    view: Annotated[
        str,
        typer.Option(metavar="NAME", help="OpenColorIO view for --png, of the server's $OCIO or the built-in config."),
    ] = "",
    keep_partial: Annotated[
        bool, typer.Option("--keep-partial", help="On Ctrl-C, write the image as far as it has converged.")
    ] = False,
) -> None:
    """Render STAGE to an EXR.

    Ctrl-C cancels the render on the server; a second one leaves at once.
    """
    from footlight.cli.render import Outputs, run_render  # noqa: PLC0415
    from footlight.cli.report import reporting  # noqa: PLC0415

    with reporting():
        outputs = Outputs(output, png, stats)
        run_render(
            outputs,
            server,
            keep_partial=keep_partial,
            stage=stage,
            camera=camera,
            time_code=frame,
            size=_parse_size(size),
            spp=spp,
            seed=seed,
            max_depth=max_depth,
            threads=threads,
            pixel_filter=pixel_filter,
            strategy=strategy,
            aovs=aov or (),
            strict=strict,
            png=png is not None,
            view=_needs_png(view, png),
        )


@app.command(epilog=EPILOG)
def explain(
    stage: Stage,
    *,
    server: Server = "",
    camera: Camera = "",
    frame: Frame = None,
    strict: Strict = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Say what STAGE calls for, without rendering.

    The effects and the prims that asked for them, the pipeline that results, what was assumed, and what was left out
    and why.
    """
    from footlight.cli.explain import run_explain  # noqa: PLC0415
    from footlight.cli.report import reporting  # noqa: PLC0415

    with reporting():
        run_explain(server, as_json=json, stage=stage, camera=camera, time_code=frame, strict=strict)


@app.command(epilog=EPILOG)
def serve(
    *,
    listen: Annotated[
        str, typer.Option(metavar="ADDR", help="Where to listen: a loopback HOST:PORT or unix:PATH.")
    ] = "127.0.0.1:50051",
    workers: Annotated[int, typer.Option(min=1, metavar="N", help="Renders that run at the same time.")] = 1,
    root: Annotated[
        Optional[list[Path]],  # noqa: UP045 typer reads it at run time
        typer.Option(metavar="DIR", help="Only stages below this directory. May be repeated. Default: anywhere."),
    ] = None,
) -> None:
    """Run the render service until Ctrl-C. Needs the footlight-server package."""
    from footlight.cli.report import reporting  # noqa: PLC0415
    from footlight.cli.serve import run_serve  # noqa: PLC0415

    with reporting():
        run_serve(listen, workers, root or [])


def _parse_size(text: str) -> tuple[int, int] | None:
    if not text:
        return None
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and int(width) > 0 and int(height) > 0):
        raise typer.BadParameter(f"{text!r} is not WIDTHxHEIGHT in pixels, as in 1920x1080", param_hint="--size")
    return int(width), int(height)


def _needs_png(view: str, png: Path | None) -> str:
    if view and png is None:
        raise typer.BadParameter("is for the picture of --png, which is not asked for", param_hint="--view")
    return view


def main() -> None:
    """Entry point of the `footlight` script."""
    app(prog_name="footlight")
