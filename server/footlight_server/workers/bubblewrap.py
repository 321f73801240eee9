"""The command that runs a worker inside bubblewrap: nothing is there but what it runs on and what its task names."""

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from footlight.worker.v1 import worker_pb2
from footlight_server.workers.limits import worker_environment
from footlight_server.workers.runtime import runtime_paths, system_links

# A place of its own in memory, and [bytes] how much that takes at most.
_TEMPORARY = "/tmp"  # noqa: S108 - nobody else sees it
_TEMPORARY_SIZE = 64 << 20
# Namespaces of its own: no network, no other processes, no signals to them. Not --new-session: whoever starts it makes
# it a session of its own, and all of it shall die when that process group is killed.
_WALLS = ("--unshare-all", "--die-with-parent", "--cap-drop", "ALL", "--proc", "/proc", "--dev", "/dev")


def find_program() -> str | None:
    """Path of bubblewrap, if it is installed."""
    return shutil.which("bwrap")


def environment(surroundings: Mapping[str, str]) -> dict[str, str]:
    """Of what runs inside: it can read it, and gets no names of folders that are not there."""
    return worker_environment(surroundings) | {"HOME": _TEMPORARY, "TMPDIR": _TEMPORARY, "PATH": "/usr/bin:/bin"}


def command(program: str, confinement: worker_pb2.Confinement, inner: Sequence[str]) -> list[str]:
    """`inner`, run inside. The paths of `confinement` have to exist; they have the same names inside."""
    temporary = ["--size", str(_TEMPORARY_SIZE), "--tmpfs", _TEMPORARY]
    links = [part for link, target in system_links().items() for part in ("--symlink", str(target), str(link))]
    binds = [
        *_binds("--ro-bind", runtime_paths()),
        *_binds("--ro-bind", map(Path, confinement.read_paths)),
        *_binds("--bind", map(Path, confinement.write_paths)),
    ]
    return [program, *_WALLS, *temporary, *links, *binds, "--remount-ro", "/", "--chdir", "/", "--", *inner]


def _binds(how: str, paths: Iterable[Path]) -> Iterator[str]:
    """Each path under the name it is known by and, if that leads over links, the one it has."""
    for path in paths:
        for name in dict.fromkeys((path, path.resolve())):
            yield from (how, str(name), str(name))
