"""What the operator decides about a server."""

from dataclasses import dataclass, field
from pathlib import Path

from footlight_server.sessions.machine import Patience


@dataclass(frozen=True, slots=True)
class Quota:
    """What one user may have at a time; 0: no limit.

    Attributes:
        jobs: that have not ended.
        tasks: that have not ended.
        bytes: [bytes] of uploads.
    """

    jobs: int = 0
    tasks: int = 0
    bytes: int = 0


@dataclass(frozen=True, slots=True)
class StageBudget:
    """What a stage that is not trusted may hold; 0: no limit."""

    prims: int = 1_000_000
    instances: int = 20_000_000
    points: int = 200_000_000
    texels: int = 1 << 30


@dataclass(frozen=True, slots=True)
class RayCluster:
    """A Ray cluster to join.

    Attributes:
        address: HOST:PORT of its head.
        token_file: its token; None: where `footlight cluster up` puts it.
        certificate, key, authority: PEM files for a cluster of several machines; None for one of this machine alone.
    """

    address: str
    token_file: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    authority: Path | None = None


@dataclass(frozen=True, slots=True)
class Settings:
    """Limits and places.

    Attributes:
        workers: renders at the same time; the others wait.
        roots: directories that stages have to lie below; empty: anywhere.
        scratch: directory for results, exists.
        worker_memory: [bytes] that one worker may hold; 0: no limit.
        patience: how long a worker may be silent.
        private: serves one client, which holds the other end of stdin; it has no farm and no uploads.
        data: directory for what outlives the server, exists unless the server is private.
        database: URL of the queue, `sqlite:///PATH` or `postgresql://…`.
        farm_workers: lanes of the farm on this machine; 0: nothing of the queue is started here.
        output_roots: directories that images of jobs have to lie below; empty: anywhere.
        output_mode: permissions of images of jobs outside of `data`; what is in it is for the server only.
        allowed_environment: names of variables that a job may set for its workers.
        trust_scenes: stages that were uploaded are opened without a sandbox.
        quota: what one user may have.
        keep_blobs: [s] how long an upload is kept that nothing needs.
        budget: what a stage that is not trusted may hold.
        drain: [s] for running tasks to end when the server stops.
        ray: where tasks run; None: in processes of this machine.
    """

    workers: int
    roots: tuple[Path, ...]
    scratch: Path
    worker_memory: int
    patience: Patience
    private: bool
    data: Path = Path()
    database: str = ""
    farm_workers: int = 1
    output_roots: tuple[Path, ...] = ()
    output_mode: int = 0o644
    allowed_environment: frozenset[str] = frozenset()
    trust_scenes: bool = False
    quota: Quota = field(default_factory=Quota)
    keep_blobs: float = 7 * 86400.0
    budget: StageBudget = field(default_factory=StageBudget)
    drain: float = 30.0
    ray: RayCluster | None = None
