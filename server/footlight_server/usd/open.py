"""Opens a stage, or says why not in one sentence that names the file."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Tf, Usd

from footlight_server.usd.errors import StageLimitError, StageMalformedError, StageNotFoundError, StageUnreadableError
from footlight_server.usd.scan import scan_layers

_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
# Parse errors quote the line they fell over; it may come from a file the caller is not allowed to read.
_QUOTED_SOURCE = re.compile(r"\s*(?:\(at sub-part[^)]*\)\s*)?\bat '.*?'(?= in <|\s*$)", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True, slots=True)
class OpenLimits:
    """Upper limits for the files of a stage; time and memory are limited by the worker process."""

    text_bytes: int = 2 << 30
    layers: int = 20_000


@dataclass(frozen=True, slots=True)
class OpenedStage:
    """A stage (Usd.Stage), and what could not be composed into it: one line each."""

    stage: Any
    composition_errors: tuple[str, ...]


def open_stage(path: Path, *, roots: Sequence[Path] = (), limits: OpenLimits | None = None) -> OpenedStage:
    """Opens the stage at `path` with all payloads loaded.

    Args:
        path: a .usd, .usda, .usdc or .usdz file.
        roots: if not empty, the file and every layer it uses must lie below one of these directories.
        limits: of its layers.

    Raises:
        StageNotFoundError, StageUnreadableError, StageMalformedError, StageLimitError: with path and reason.
    """
    limits = limits or OpenLimits()
    _check_file(path)
    check_below(path, roots)
    scan_layers(path, max_text_bytes=limits.text_bytes, max_layers=limits.layers)
    # A truncated crate file that is memory-mapped kills the process (SIGBUS); read calls fail cleanly.
    os.environ.setdefault("USDC_USE_PREAD", "1")
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
    except Tf.ErrorException as error:
        raise StageMalformedError(f"{path}: {reason_of(error)}") from None
    if not stage:
        raise StageMalformedError(f"{path}: USD cannot open it as a stage")
    layers = stage.GetUsedLayers()
    if len(layers) > limits.layers:
        raise StageLimitError(f"{path}: uses {len(layers)} layers, allowed are {limits.layers}")
    for layer in layers:
        if layer.realPath:
            check_below(Path(layer.realPath.split("[", 1)[0]), roots)
    errors = tuple(sorted({hide_source(str(error)) for error in stage.GetCompositionErrors()}))
    return OpenedStage(stage, errors)


def check_below(path: Path, roots: Sequence[Path]) -> None:
    """Raises StageUnreadableError unless `path`, with links resolved, lies below one of the roots (none: anywhere)."""
    real = path.resolve()
    if roots and not any(real.is_relative_to(root.resolve()) for root in roots):
        raise StageUnreadableError(f"{path}: outside the directories this server may read")


def hide_source(message: str) -> str:
    """A USD message in one line, without the source text that it quotes."""
    return " ".join(_QUOTED_SOURCE.sub("", message).split())


def _check_file(path: Path) -> None:
    if not path.exists():
        raise StageNotFoundError(f"{path}: no such file")
    if not path.is_file():
        raise StageUnreadableError(f"{path}: not a file")
    if not os.access(path, os.R_OK):
        raise StageUnreadableError(f"{path}: may not be read")
    if path.suffix.lower() not in _SUFFIXES:
        raise StageMalformedError(f"{path}: not a stage, its name must end in {', '.join(_SUFFIXES)}")
    if path.stat().st_size == 0:
        raise StageMalformedError(f"{path}: is empty")


def reason_of(error: Tf.ErrorException) -> str:
    """The last thing USD says about what went wrong, in one line."""
    commentaries = [hide_source(str(entry.commentary)) for entry in error.args]
    wanted = [c for c in commentaries if c and not c.startswith("Failed to open layer")]
    return wanted[-1] if wanted else "not a USD layer, or a damaged one"
