"""Read an image file as linear Rec.709 texels: dome textures."""

import stat
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
from numpy.typing import NDArray

from footlight_server.images.files import ImageError

ColorSpace = Literal["auto", "raw", "sRGB"]
Texels = NDArray[np.float32]

# [texels] 16384 x 8192: a large dome; 1.5 GB as float32.
TEXEL_BUDGET = 1 << 27


def read_image(
    path: Path,
    color_space: ColorSpace = "auto",
    texel_budget: int = TEXEL_BUDGET,
    admit: Callable[[int], None] | None = None,
) -> Texels:
    """Texels (H, W, 3), first row at the top, linear Rec.709, of any format OpenImageIO reads.

    The header is checked before any texel is read: more than `texel_budget` texels are refused, and `admit` is
    told how many there are, so that it may refuse them with an exception of its own. One channel
    becomes grey, two are grey and alpha, of more the first three count; alpha is left out. `auto` decodes
    sRGB where the file says so, and where it has 8-bit integers and says nothing; floating point is linear.
    Texels that are not finite are passed on as they are. Raises ImageError naming the file and the reason.
    """
    # Only regular files: a FIFO would hang, a device never end.
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror}") from error
    if not stat.S_ISREG(mode):
        raise ImageError(f"{path}: cannot be read: not a regular file")
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ImageError(f"{path}: cannot be read: {oiio.geterror()}")
    try:
        _check(path, source.spec(), texel_budget)
        if admit is not None:
            admit(source.spec().width * source.spec().height)
        return _read(path, source, color_space)
    finally:
        source.close()


def _check(path: Path, spec: oiio.ImageSpec, texel_budget: int) -> None:
    size = f"{spec.width}x{spec.height}"
    if spec.deep or spec.depth > 1:
        raise ImageError(f"{path}: cannot be read: deep images and volumes are not textures")
    if spec.width < 1 or spec.height < 1 or spec.nchannels < 1:
        raise ImageError(f"{path}: cannot be read: {size} texels, {spec.nchannels} channels")
    if spec.width * spec.height > texel_budget:
        raise ImageError(f"{path}: cannot be read: {size} texels; at most {texel_budget} are allowed")


def _read(path: Path, source: oiio.ImageInput, color_space: ColorSpace) -> Texels:
    spec = source.spec()
    channels = 1 if spec.nchannels < 3 else 3
    pixels = source.read_image(0, 0, 0, channels, oiio.FLOAT)
    if pixels is None:
        raise ImageError(f"{path}: cannot be read: {source.geterror() or oiio.geterror()}")
    texels: Texels = np.ascontiguousarray(np.broadcast_to(pixels, (spec.height, spec.width, 3)), np.float32)
    return srgb_to_linear(texels) if _is_srgb(spec, color_space) else texels


def _is_srgb(spec: oiio.ImageSpec, color_space: ColorSpace) -> bool:
    if color_space != "auto":
        return color_space == "sRGB"
    if spec.format in (oiio.FLOAT, oiio.HALF, oiio.DOUBLE):
        return False
    said = spec.get_string_attribute("oiio:ColorSpace").lower()
    return said.startswith("srgb") if said else bool(spec.format == oiio.UINT8)


def srgb_to_linear(encoded: Texels) -> Texels:
    """IEC 61966-2-1, the piecewise curve, continued as an odd function below zero. Any shape."""
    size = np.abs(encoded)
    linear = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    return np.copysign(linear, encoded).astype(np.float32)
