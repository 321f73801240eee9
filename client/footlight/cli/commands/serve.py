"""`footlight serve`: the options of the server, grouped as its manual has them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Optional

import typer

Listen = Optional[list[str]]  # noqa: UP045 typer reads it at run time
Paths = Optional[list[Path]]  # noqa: UP045
File = Optional[Path]  # noqa: UP045
Number = Optional[float]  # noqa: UP045
Whole = Optional[int]  # noqa: UP045


@dataclass(frozen=True, slots=True)
class ServiceOptions:
    """Where it listens, and what single renders may take."""

    PANEL: ClassVar = "Service"

    listen: Annotated[
        Listen,
        typer.Option(
            metavar="ADDR",
            help="HOST:PORT or unix:PATH. May be repeated. Beyond loopback with --tls-cert and tokens only.",
            show_default="127.0.0.1:50051",
        ),
    ] = None
    tls_cert: Annotated[File, typer.Option(metavar="PEM", help="Certificate chain for addresses beyond loopback.")] = (
        None
    )
    tls_key: Annotated[File, typer.Option(metavar="PEM", help="Its private key.")] = None
    tls_client_ca: Annotated[
        File, typer.Option(metavar="PEM", help="Clients there have to show a certificate of this CA besides a token.")
    ] = None
    workers: Annotated[int, typer.Option(min=1, metavar="N", help="Renders that run at the same time.")] = 1
    root: Annotated[
        Paths, typer.Option(metavar="DIR", help="Only stages below this directory. May be repeated. Default: anywhere.")
    ] = None
    scratch: Annotated[
        File,
        typer.Option(metavar="DIR", help="Where results are kept while the server runs. Default: a temporary one."),
    ] = None
    worker_memory: Annotated[
        Number,
        typer.Option(
            min=0, metavar="GB", help="That one worker may hold; 0: no limit.", show_default="80 % of the machine"
        ),
    ] = None
    open_seconds: Annotated[
        Number, typer.Option(metavar="S", help="Limit for opening a stage.", show_default="300")
    ] = None
    metrics: Annotated[
        str, typer.Option(metavar="ADDR", help="A loopback HOST:PORT where Prometheus finds /metrics.")
    ] = ""
    log_format: Annotated[Literal["text", "json"], typer.Option(help="Of the log on stderr.")] = "text"


@dataclass(frozen=True, slots=True)
class FarmOptions:
    """The queue, and where its tasks run."""

    PANEL: ClassVar = "Farm queue"

    data: Annotated[
        File,
        typer.Option(
            metavar="DIR",
            help="Where the queue and what it made is kept.",
            show_default="$XDG_DATA_HOME/footlight or ~/.local/share/footlight",
        ),
    ] = None
    database: Annotated[
        str,
        typer.Option(metavar="URL", help="sqlite:///PATH or postgresql://…", show_default="a file in --data"),
    ] = ""
    farm_workers: Annotated[
        int, typer.Option(min=0, metavar="N", help="Tasks of the queue that run at the same time; 0: none is started.")
    ] = 1
    executor: Annotated[Literal["local", "ray"], typer.Option(help="Where tasks run: here, or on a Ray cluster.")] = (
        "local"
    )
    ray_address: Annotated[
        str, typer.Option(metavar="ADDR", help="Head of the cluster.", show_default="one on this machine")
    ] = ""
    ray_token_file: Annotated[File, typer.Option(metavar="FILE", help="The cluster's token.")] = None
    ray_tls_cert: Annotated[
        File, typer.Option(metavar="PEM", help="This node's certificate, for a cluster of several machines.")
    ] = None
    ray_tls_key: Annotated[File, typer.Option(metavar="PEM", help="Its private key.")] = None
    ray_tls_ca: Annotated[File, typer.Option(metavar="PEM", help="The authority of all nodes' certificates.")] = None
    output_root: Annotated[
        Paths,
        typer.Option(
            metavar="DIR", help="Images of jobs only below this directory. May be repeated. Default: anywhere."
        ),
    ] = None
    allow_env: Annotated[
        Listen, typer.Option(metavar="NAME", help="A variable that jobs may set for workers. May be repeated.")
    ] = None
    drain_seconds: Annotated[
        Number, typer.Option(min=0, metavar="S", help="For running tasks when the server stops.", show_default="30")
    ] = None


@dataclass(frozen=True, slots=True)
class GuestOptions:
    """What stages and users that are not trusted may do. Numbers left out are the server's own."""

    PANEL: ClassVar = "Uploaded stages and quotas"

    trust_scenes: Annotated[bool, typer.Option("--trust-scenes", help="Open uploaded stages without a sandbox.")] = (
        False
    )
    quota_jobs: Annotated[
        Whole, typer.Option(min=0, metavar="N", help="Unfinished jobs of one user; 0: no limit.", show_default="0")
    ] = None
    quota_tasks: Annotated[
        Whole, typer.Option(min=0, metavar="N", help="Unfinished tasks of one user; 0: no limit.", show_default="0")
    ] = None
    quota_bytes: Annotated[
        Number, typer.Option(min=0, metavar="GB", help="Uploads of one user; 0: no limit.", show_default="0")
    ] = None
    keep_blobs: Annotated[
        Number,
        typer.Option(min=0, metavar="DAYS", help="Uploads that nothing needs are kept so long.", show_default="7"),
    ] = None
    max_prims: Annotated[Whole, typer.Option(min=0, metavar="N", help="Prims of an uploaded stage; 0: no limit.")] = (
        None
    )
    max_instances: Annotated[
        Whole, typer.Option(min=0, metavar="N", help="Instances of an uploaded stage; 0: no limit.")
    ] = None
    max_points: Annotated[Whole, typer.Option(min=0, metavar="N", help="Points of an uploaded stage; 0: no limit.")] = (
        None
    )
    max_texels: Annotated[Whole, typer.Option(min=0, metavar="N", help="Texels of an uploaded stage; 0: no limit.")] = (
        None
    )


def serve(service: ServiceOptions, farm: FarmOptions, guests: GuestOptions) -> None:
    """Run the render service and its farm queue until Ctrl-C. Needs the footlight-server package."""
    from footlight.cli.serve import run_serve  # noqa: PLC0415

    run_serve(service, farm, guests)
