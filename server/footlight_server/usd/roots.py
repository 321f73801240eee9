"""Where the files of a stage may lie: below the roots that the server was given, with links resolved."""

from collections.abc import Sequence
from pathlib import Path

from footlight_server.usd.errors import StageUnreadableError

OUTSIDE = "outside the directories this server may read"


def check_below(path: Path, roots: Sequence[Path]) -> None:
    """Raises StageUnreadableError unless `path`, with links resolved, lies below one of the roots (none: anywhere)."""
    if not is_below(path, roots):
        raise StageUnreadableError(f"{path}: {OUTSIDE}")


def is_below(path: Path, roots: Sequence[Path]) -> bool:
    """Whether `path`, with links resolved, lies below one of the roots (none: anywhere)."""
    real = path.resolve()
    return not roots or any(real.is_relative_to(root.resolve()) for root in roots)


def file_of(layer: str) -> Path:
    """The file a layer is in, by its identifier or path: for one in a package, the package."""
    return Path(layer.split("[", 1)[0])
