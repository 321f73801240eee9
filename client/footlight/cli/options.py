"""Options that several commands share, declared once. A group is a dataclass; `command` spreads it over a command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Optional

import typer

from footlight.cli import parse

DEFAULT_SERVER = "127.0.0.1:50051"

Stage = Annotated[
    Path, typer.Argument(metavar="STAGE", help="The root layer: .usd, .usda, .usdc or .usdz, on the server's machine.")
]
JobName = Annotated[str, typer.Argument(metavar="JOB", help="A job: 12 or jobs/12.")]
AsJson = Annotated[bool, typer.Option("--json", help="JSON on stdout, by the names of the .proto files.")]
Upload = Annotated[
    bool,
    typer.Option(
        "--upload", help="Send STAGE and all it refers to; later changes do not matter. Needs pxr on this machine."
    ),
]
PathRules = Annotated[
    Optional[list[str]],  # noqa: UP045 typer reads it at run time
    typer.Option(
        "--path-map",
        metavar="FROM=TO",
        help="A directory here and what it is on the server. May be repeated; $FOOTLIGHT_PATH_MAP holds more, "
        "separated by semicolons.",
    ),
]


@dataclass(frozen=True, slots=True)
class Connection:
    """Which server, and who one is there."""

    PANEL: ClassVar = "Connection"

    server: Annotated[
        str, typer.Option(metavar="ADDR", envvar="FOOTLIGHT_SERVER", help="The server, HOST:PORT or unix:PATH.")
    ] = DEFAULT_SERVER
    token: Annotated[
        str,
        typer.Option(
            metavar="SECRET",
            envvar="FOOTLIGHT_TOKEN",
            help="Who one is, beyond this machine. Others can read a command line; better put it into the variable.",
        ),
    ] = ""
    ca: Annotated[
        str,
        typer.Option(metavar="PEM", envvar="FOOTLIGHT_CA", help="Certificates that the server's has to be signed by."),
    ] = ""
    cert: Annotated[
        str,
        typer.Option(
            metavar="PEM", envvar="FOOTLIGHT_CERT", help="One's own certificate, where the server asks for it."
        ),
    ] = ""
    key: Annotated[str, typer.Option(metavar="PEM", envvar="FOOTLIGHT_KEY", help="The private key of --cert.")] = ""


@dataclass(frozen=True, slots=True)
class MappedConnection(Connection):
    """With a view of the server's files."""

    path_map: PathRules = None


@dataclass(frozen=True, slots=True)
class OwnConnection(MappedConnection):
    """Or a server for this call alone."""

    server: Annotated[
        str,
        typer.Option(
            metavar="ADDR",
            envvar="FOOTLIGHT_SERVER",
            help="A running server, HOST:PORT or unix:PATH. Without it one is started for this call.",
        ),
    ] = ""


@dataclass(frozen=True, slots=True)
class StageOptions:
    """What is read of a stage."""

    PANEL: ClassVar = "Rendering"

    stage: Stage
    camera: Annotated[
        str,
        typer.Option(
            metavar="PATH",
            help="Prim path of the camera. Default: the one of the render settings, else the first, "
            "else one that frames the stage.",
        ),
    ] = ""
    strict: Annotated[bool, typer.Option("--strict", help="Fail on what would be left out of the image.")] = False

    def arguments(self) -> dict[str, Any]:
        """For render_spec."""
        return {"stage": self.stage, "camera": self.camera, "strict": self.strict}


@dataclass(frozen=True, slots=True)
class RenderOptions(StageOptions):
    """How an image is made of it."""

    PANEL: ClassVar = "Rendering"

    size: Annotated[
        str,
        typer.Option(
            metavar="WxH", help="Width and height in pixels, as in 1920x1080. Default: the stage's, else 1280x720."
        ),
    ] = ""
    spp: Annotated[int, typer.Option(min=1, metavar="N", help="Samples per pixel.")] = 64
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="Same seed, same image, bit for bit.")] = 0
    max_depth: Annotated[int, typer.Option(min=1, metavar="N", help="The longest path from the camera, in edges.")] = 8
    threads: Annotated[
        int, typer.Option(min=0, metavar="N", help="Threads to use; 0 for all. The image does not depend on it.")
    ] = 0
    pixel_filter: Annotated[
        Literal["box", "gaussian", "blackman-harris"], typer.Option(help="Reconstruction filter.")
    ] = "blackman-harris"
    strategy: Annotated[
        Literal["mis", "light", "bsdf"],
        typer.Option(help="How light is found: light and BSDF sampling joined, or one of them alone."),
    ] = "mis"
    aov: Annotated[
        Optional[list[str]],  # noqa: UP045 typer reads it at run time
        typer.Option(
            metavar="NAME",
            help="Another image to write besides color and alpha: depth, normal, albedo, position, error, "
            "sample_count. May be repeated.",
        ),
    ] = None
    view: Annotated[
        str,
        typer.Option(metavar="NAME", help="OpenColorIO view for --png, of the server's $OCIO or the built-in config."),
    ] = ""

    def arguments(self) -> dict[str, Any]:
        """For render_spec."""
        return {
            **StageOptions.arguments(self),
            "size": parse.size(self.size),
            "spp": self.spp,
            "seed": self.seed,
            "max_depth": self.max_depth,
            "threads": self.threads,
            "pixel_filter": self.pixel_filter,
            "strategy": self.strategy,
            "aovs": self.aov or (),
            "view": self.view,
        }


@dataclass(frozen=True, slots=True)
class TaskChoice:
    """Some tasks of a job."""

    layer: Annotated[str, typer.Option(metavar="NAME", help="Tasks of this layer only.")] = ""
    frames: Annotated[
        str, typer.Option(metavar="RANGE", help="Tasks that hold one of these frames only, as in 1001-1010.")
    ] = ""
