"""Gathers a stage and all it refers to in one directory; the one place of the client that needs pxr."""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from footlight.errors import FootlightError


class CollectError(FootlightError):
    """The stage's files cannot be gathered; the message names the file at fault, or what is not installed."""


@dataclass(frozen=True, slots=True)
class Collected:
    """A stage whose references stay below `root`: `stage_path` is relative to it.

    `unresolved` are the references that lead nowhere, as they were on this machine; the render will report them.
    """

    root: Path
    stage_path: str
    unresolved: tuple[str, ...] = ()


@contextlib.contextmanager
def collected(stage: Path) -> Iterator[Collected]:
    """Copies of the stage, its layers, textures, volumes, clips and packages, in a directory that goes with the block.

    Copies, so that the stage may be edited while they are sent; they need the room of all files in $TMPDIR. References
    out of the stage's directory are changed to lead into the copy. Raises CollectError.
    """
    if not stage.is_file():
        raise CollectError(f"{stage}: no such file")
    try:
        with tempfile.TemporaryDirectory(prefix="footlight-upload-") as directory:
            yield _collect(stage.absolute(), Path(directory))
    except OSError as error:
        raise CollectError(f"{stage}: cannot be collected: {error}") from error


def _collect(stage: Path, root: Path) -> Collected:
    try:
        # Here, so that everything else of the client works without it.
        from pxr import Sdf, Tf, UsdUtils  # noqa: PLC0415
    except ImportError:
        if stage.suffix.lower() != ".usdz":
            raise CollectError(
                "collecting a stage's files takes USD's Python module: pip install usd-core "
                "(a .usdz, which holds all its files, can be uploaded without)"
            ) from None
        shutil.copyfile(stage, root / stage.name)
        return Collected(root, stage.name)
    # While it lives it takes USD's warnings, which would go to standard error.
    warnings = UsdUtils.CoalescingDiagnosticDelegate()
    asset = Sdf.AssetPath(str(stage))
    try:
        whole = UsdUtils.LocalizeAsset(asset, str(root))
        unresolved = () if whole else tuple(str(path) for path in UsdUtils.ComputeAllDependencies(asset)[2])
    except Tf.ErrorException as error:
        # Without the place in USD's sources: `Error in '…' at line … in file … : '…'`.
        why = "; ".join(each.commentary for each in error.args if isinstance(each, Tf.Error)) or str(error)
        raise CollectError(f"{stage}: cannot be collected: {' '.join(why.split())}") from None
    said = [diagnostic.commentary for diagnostic in warnings.TakeUncoalescedDiagnostics()]
    if not (root / stage.name).is_file() or not (whole or unresolved):
        raise CollectError(f"{stage}: cannot be collected: {'; '.join(said) or 'USD does not say why'}")
    return Collected(root, stage.name, unresolved)
