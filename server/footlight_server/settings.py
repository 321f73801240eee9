"""What the operator decides about a server."""

from dataclasses import dataclass
from pathlib import Path

from footlight_server.sessions.machine import Patience


@dataclass(frozen=True, slots=True)
class Settings:
    """Limits and places.

    Attributes:
        workers: renders at the same time; the others wait.
        roots: directories that stages have to lie below; empty: anywhere.
        scratch: directory for results, exists.
        worker_memory: [bytes] that one worker may hold; 0: no limit.
        patience: how long a worker may be silent.
        private: serves one client, which holds the other end of stdin.
    """

    workers: int
    roots: tuple[Path, ...]
    scratch: Path
    worker_memory: int
    patience: Patience
    private: bool
