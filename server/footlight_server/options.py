"""The command line of the server: what may be asked for, and the settings that come of it."""

import argparse
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path

from footlight_server.api.address import AddressError, check_address, is_local
from footlight_server.api.tls import Tls, check_tls
from footlight_server.sessions.machine import Patience
from footlight_server.settings import Quota, RayCluster, Settings, StageBudget
from footlight_server.workers.limits import physical_memory

DEFAULT_ADDRESS = "127.0.0.1:50051"
# [1] Of the machine's memory, for one worker.
_MEMORY_SHARE = 0.8
_DAY = 86400.0
# Where `footlight cluster up` starts one.
_RAY_ADDRESS = "127.0.0.1:6380"
_DATABASES = ("sqlite:///", "postgresql://")
_VARIABLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
# With these a job would decide what code its workers run.
_CODE_VARIABLES = ("LD_", "PYTHON", "PXR_PLUGINPATH", "GLIBC_TUNABLES", "BASH_ENV")
# Option, lowest, highest.
_RANGES = (
    ("--workers", 1, 256),
    ("--farm-workers", 0, 256),
    ("--quota-jobs", 0, 1 << 40),
    ("--quota-tasks", 0, 1 << 40),
    ("--quota-bytes", 0, 1 << 30),
    ("--keep-blobs", 0, 36_500),
    ("--drain-seconds", 0, 86_400),
    *((f"--max-{limit.name}", 0, 1 << 60) for limit in fields(StageBudget)),
)


@dataclass(frozen=True, slots=True)
class Launch:
    """What is asked for of a server process besides its settings.

    Attributes:
        addresses: to listen on.
        tls: for those that are not local; None if all are.
        metrics: HOST:PORT on loopback for Prometheus; empty: none.
    """

    addresses: tuple[str, ...]
    tls: Tls | None
    metrics: str
    settings: Settings


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """The command line. Exits with a message if it is wrong."""
    parser = argparse.ArgumentParser(prog="footlight-server", description="Renders USD stages as a service.")
    add = parser.add_argument
    add(
        "--listen",
        action="append",
        metavar="ADDR",
        help=f"HOST:PORT or unix:PATH, may be repeated; beyond loopback with TLS and tokens only ({DEFAULT_ADDRESS})",
    )
    add("--tls-cert", type=Path, metavar="PEM", help="certificate chain for addresses beyond loopback")
    add("--tls-key", type=Path, metavar="PEM", help="its private key")
    add("--tls-client-ca", type=Path, metavar="PEM", help="clients there have to show a certificate of this CA besides")
    add("--workers", type=int, default=1, metavar="N", help="renders at the same time")
    add("--root", action="append", default=[], type=Path, metavar="DIR", help="stages have to lie below one of these")
    add("--scratch", type=Path, metavar="DIR", help="where results are kept while the server runs")
    add("--worker-memory", type=float, metavar="GB", help="that one worker may hold; 0: no limit")
    add("--open-seconds", type=float, default=300.0, metavar="S", help="limit for opening a stage")
    farm = parser.add_argument_group("farm")
    add = farm.add_argument
    add("--data", type=Path, metavar="DIR", help="where the queue and what it made is kept")
    add("--database", default="", metavar="URL", help="sqlite:///PATH or postgresql://…; default: a file in --data")
    add("--farm-workers", type=int, default=1, metavar="N", help="tasks at the same time; 0: start nothing")
    add(
        "--output-root",
        action="append",
        default=[],
        type=Path,
        metavar="DIR",
        help="images of jobs have to lie below one of these",
    )
    add("--allow-env", action="append", default=[], metavar="NAME", help="a variable that jobs may set for workers")
    add("--executor", choices=["local", "ray"], default="local", help="where tasks run: here, or in a Ray cluster")
    add("--ray-address", default="", metavar="ADDR", help=f"head of the cluster ({_RAY_ADDRESS})")
    add("--ray-token-file", type=Path, metavar="FILE", help="the cluster's token")
    add("--ray-tls-cert", type=Path, metavar="PEM", help="this node's certificate, for a cluster of several machines")
    add("--ray-tls-key", type=Path, metavar="PEM", help="its private key")
    add("--ray-tls-ca", type=Path, metavar="PEM", help="the authority of all nodes' certificates")
    add("--drain-seconds", type=float, default=30.0, metavar="S", help="for running tasks when the server stops")
    guests = parser.add_argument_group("guests")
    add = guests.add_argument
    add("--trust-scenes", action="store_true", help="open uploaded stages without a sandbox")
    add("--quota-jobs", type=int, default=0, metavar="N", help="unfinished jobs, and renders, of one user; 0: no limit")
    add("--quota-tasks", type=int, default=0, metavar="N", help="unfinished tasks of one user; 0: no limit")
    add("--quota-bytes", type=float, default=0.0, metavar="GB", help="uploads of one user; 0: no limit")
    add("--keep-blobs", type=float, default=7.0, metavar="DAYS", help="uploads that nothing needs")
    for limit in fields(StageBudget):
        add(
            f"--max-{limit.name}",
            type=int,
            default=limit.default,
            metavar="N",
            help=f"{limit.name} of an uploaded stage; 0: no limit ({limit.default})",
        )
    add = parser.add_argument
    add("--metrics", default="", metavar="ADDR", help="HOST:PORT on loopback where Prometheus finds /metrics")
    add("--log-format", choices=["text", "json"], default="text", help="of the log on stderr")
    add("--private", action="store_true", help="stop when standard input is closed; no farm")
    add("--verbose", action="store_true", help="log more")
    return parser.parse_args(arguments)


def check_launch(options: argparse.Namespace, scratch: Path, umask: int = 0o022) -> Launch:
    """What to start. Raises ValueError naming the option, its value and what is allowed.

    `umask`: the operator's, for what others shall see.
    """
    given = options.listen or [DEFAULT_ADDRESS]
    tls = check_tls(options.tls_cert, options.tls_key, options.tls_client_ca)
    addresses = tuple(check_address(address, tls=tls is not None) for address in given)
    if tls is not None and all(is_local(address) for address in addresses):
        raise AddressError(
            "--tls-cert: every --listen is a loopback address or a unix socket, which are served without TLS and "
            "without tokens; listen on another address, such as 0.0.0.0:50052, besides"
        )
    for address in addresses:
        if options.private and not is_local(address):
            raise AddressError(f"--listen {address}: a private server listens on loopback and unix sockets only")
        if addresses.count(address) > 1 and not address.endswith(":0"):
            raise AddressError(f"--listen {address}: given twice")
    if options.metrics:
        _check_metrics(options.metrics)
    return Launch(addresses, tls, options.metrics, check_settings(options, scratch, umask))


def check_settings(options: argparse.Namespace, scratch: Path, umask: int) -> Settings:
    """The settings. Raises ValueError naming the option, its value and what is allowed."""
    _check_ranges(options)
    memory = physical_memory() * _MEMORY_SHARE if options.worker_memory is None else options.worker_memory * 2**30
    if not 0 <= memory < 2**60:
        raise ValueError(f"--worker-memory {options.worker_memory:g}: allowed is 0 and up")
    for name, roots in (("--root", options.root), ("--output-root", options.output_root)):
        for root in roots:
            if not root.is_dir():
                raise ValueError(f"{name} {root}: not a directory")
    data = (options.data or default_data(os.environ)).absolute()
    return Settings(
        workers=options.workers,
        roots=tuple(root.resolve() for root in options.root),
        scratch=scratch,
        worker_memory=int(memory),
        patience=Patience(opening=options.open_seconds),
        private=options.private,
        data=data,
        database="" if options.private else _database(options.database, data),
        farm_workers=options.farm_workers,
        output_roots=tuple(root.resolve() for root in options.output_root),
        output_mode=0o666 & ~umask,
        allowed_environment=frozenset(_variable(name) for name in options.allow_env),
        trust_scenes=options.trust_scenes,
        quota=Quota(options.quota_jobs, options.quota_tasks, int(options.quota_bytes * 2**30)),
        keep_blobs=options.keep_blobs * _DAY,
        budget=StageBudget(options.max_prims, options.max_instances, options.max_points, options.max_texels),
        drain=options.drain_seconds,
        ray=_ray(options),
    )


def default_data(surroundings: Mapping[str, str]) -> Path:
    """Where a user's data belongs (XDG Base Directory Specification)."""
    home = surroundings.get("XDG_DATA_HOME", "")
    # The specification: a relative path there is to be ignored.
    base = Path(home) if home.startswith("/") else Path.home() / ".local" / "share"
    return base / "footlight"


def _check_metrics(address: str) -> None:
    """Prometheus asks without TLS and without a token."""
    if address.startswith("unix:") or not is_local(address):
        raise AddressError(f"--metrics {address}: not a loopback address, HOST:PORT")


def _check_ranges(options: argparse.Namespace) -> None:
    for option, low, high in _RANGES:
        value = getattr(options, option.removeprefix("--").replace("-", "_"))
        if not low <= value <= high:
            raise ValueError(f"{option} {value:g}: allowed are {low} to {high}")
    if not 0 < options.open_seconds <= _DAY:
        raise ValueError(f"--open-seconds {options.open_seconds:g}: allowed is over 0 to {_DAY:g}")


def _database(url: str, data: Path) -> str:
    from footlight_server.farm.places import Places  # noqa: PLC0415 a private server has no use for it

    if url and not url.startswith(_DATABASES):
        raise ValueError(f"--database: has to begin with {' or '.join(_DATABASES)}")  # it may hold a password
    return url or f"sqlite:///{Places(data).database}"


def _variable(name: str) -> str:
    if not _VARIABLE.fullmatch(name):
        raise ValueError(f"--allow-env {name}: not the name of a variable")
    if name.startswith(_CODE_VARIABLES):
        raise ValueError(f"--allow-env {name}: would let whoever submits a job decide what code its workers run")
    return name


def _ray(options: argparse.Namespace) -> RayCluster | None:
    files = (options.ray_tls_cert, options.ray_tls_key, options.ray_tls_ca)
    if options.executor != "ray":
        if options.ray_address or options.ray_token_file or any(files):
            raise ValueError("--ray-address, --ray-token-file, --ray-tls-…: are for --executor ray")
        return None
    if find_spec("ray") is None:
        raise ValueError("--executor ray: Ray is not installed; pip install 'footlight-server[ray]'")
    if any(files) and not all(files):
        raise ValueError("--ray-tls-cert, --ray-tls-key and --ray-tls-ca: give all three, or none")
    return RayCluster(options.ray_address or _RAY_ADDRESS, options.ray_token_file, *files)
