"""Opens a stage, or says why not in one sentence that names the file."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd

from footlight_server.usd.diagnostics import plain, plain_diagnostics
from footlight_server.usd.errors import StageLimitError, StageMalformedError, StageNotFoundError, StageUnreadableError
from footlight_server.usd.roots import check_below, file_of, is_below
from footlight_server.usd.scan import scan_folder, scan_layers
from footlight_server.usd.unfold import Unfolding

_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


@dataclass(frozen=True, slots=True)
class OpenLimits:
    """Upper limits for the files of a stage; time and memory are limited by the worker process.

    Attributes:
        text_bytes: of one text layer.
        layers: that are used.
        prims: that references may unfold to, told before they do; 0: no limit.
        every_file: look at all files below the roots beforehand, not only at those that text layers name.
    """

    text_bytes: int = 2 << 30
    layers: int = 20_000
    prims: int = 0
    every_file: bool = False


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
    check_below(path, roots)
    _check_file(path)
    if limits.every_file and roots:
        for root in roots:
            scan_folder(root, max_text_bytes=limits.text_bytes)
    else:
        scan_layers(path, max_text_bytes=limits.text_bytes, max_layers=limits.layers)
    # A truncated crate file that is memory-mapped kills the process (SIGBUS); read calls fail cleanly.
    os.environ.setdefault("USDC_USE_PREAD", "1")
    try:
        with plain_diagnostics(roots):
            # What it has opened stays so until the stage is: nothing is read twice.
            unfolding = _check_prims(path, roots, limits.prims) if limits.prims else None
            stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
            del unfolding
    except Tf.ErrorException as error:
        raise StageMalformedError(f"{path}: {reason_of(error, roots)}") from None
    if not stage:
        raise StageMalformedError(f"{path}: USD cannot open it as a stage")
    check_layers(stage, roots, limits.layers)
    errors = {plain(str(error), roots) for error in stage.GetCompositionErrors()}
    return OpenedStage(stage, tuple(sorted(errors)))


def check_layers(stage: Any, roots: Sequence[Path], most: int = 0) -> None:
    """Raises StageLimitError, or StageUnreadableError unless all layers that are open by now lie below the roots.

    No look beforehand says where all references lead: expressions in them are evaluated as they are composed, and the
    layers of value clips are opened as values are asked for. `most` layers are allowed; 0: any number.
    """
    layers = stage.GetUsedLayers()
    if 0 < most < len(layers):
        path = stage.GetRootLayer().identifier
        raise StageLimitError(f"{path}: uses {len(layers)} layers, allowed are {most}")
    for layer in layers:
        if layer.realPath:
            check_below(file_of(layer.realPath), roots)


def _check_prims(path: Path, roots: Sequence[Path], most: int) -> Unfolding | None:
    layer = Sdf.Layer.FindOrOpen(str(path))
    if not layer:
        return None
    unfolding = Unfolding(layer, most, lambda identifier: is_below(file_of(identifier), roots))
    unfolding.check()
    return unfolding


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


def reason_of(error: Tf.ErrorException, roots: Sequence[Path]) -> str:
    """The last thing USD says about what went wrong, in one line."""
    commentaries = [plain(str(entry.commentary), roots) for entry in error.args]
    wanted = [c for c in commentaries if c and not c.startswith("Failed to open layer")]
    return wanted[-1] if wanted else "not a USD layer, or a damaged one"
