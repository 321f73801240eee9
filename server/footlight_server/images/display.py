"""Pictures for looking at: linear Rec.709 through OpenColorIO into an 8-bit PNG."""

import os
from functools import cache
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import PyOpenColorIO as ocio  # noqa: N813 its documentation's name
from numpy.typing import NDArray

from footlight_server.images.exr import write_image
from footlight_server.images.files import ImageError

Pixels = NDArray[np.float32]

BUILT_IN_CONFIG = "ocio://default"
# The rendering space, by its name in OpenColorIO's built-in configs.
RENDERING_SPACE = "Linear Rec.709 (sRGB)"
# Pixels that are not finite are to be seen, not taken for black or white.
NOT_FINITE = (255, 0, 255)


def write_png(path: Path, color: Pixels, alpha: Pixels | None = None, view: str = "") -> None:
    """Write linear Rec.709 `color` (H, W, 3), premultiplied by `alpha` (H, W, 1) if given, as a PNG.

    Without a `view` the encoding is plain sRGB; with one it is that view of the default display of `$OCIO`,
    or of OpenColorIO's built-in config. PNG wants straight alpha: colour is divided by alpha before it is
    encoded; where alpha is zero it stays as it is. Pixels that are not finite become magenta. The file
    appears whole or not at all. Raises ImageError naming the file, or the view and those allowed.
    """
    picture = encode(color, alpha, view)
    height, width, channels = picture.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    write_image(path, spec, picture)


def encode(color: Pixels, alpha: Pixels | None = None, view: str = "") -> NDArray[np.uint8]:
    """The picture: 8-bit RGB (H, W, 3), or RGBA (H, W, 4) with straight alpha. As `write_png`."""
    finite: NDArray[np.bool_] = np.all(np.isfinite(color), axis=2)
    shown: Pixels = np.where(finite[..., np.newaxis], color, 0).astype(np.float32)
    if alpha is not None:
        opacity = np.clip(np.nan_to_num(alpha, nan=1.0), 0, 1).astype(np.float32)
        np.divide(shown, opacity, out=shown, where=opacity > 0)
    _processor(view).applyRGB(shown)
    picture = _to_8_bit(shown)
    picture[~finite] = NOT_FINITE
    return picture if alpha is None else np.concatenate([picture, _to_8_bit(opacity)], axis=2)


def check_view(view: str) -> None:
    """Raise ImageError unless `view` is empty or a view of the default display; the message lists those."""
    _processor(view)


def _to_8_bit(values: Pixels) -> NDArray[np.uint8]:
    scaled: Pixels = np.rint(np.clip(values, 0, 1) * np.float32(255))
    return scaled.astype(np.uint8)


def _processor(view: str) -> ocio.CPUProcessor:
    return _view(view, os.environ.get("OCIO") or BUILT_IN_CONFIG) if view else _srgb_encoding()


@cache
def _srgb_encoding() -> ocio.CPUProcessor:
    # IEC 61966-2-1: linear near black, then offset 0.055 and exponent 2.4; no change of primaries.
    curve = ocio.ExponentWithLinearTransform(
        gamma=[2.4, 2.4, 2.4, 1.0], offset=[0.055, 0.055, 0.055, 0.0], direction=ocio.TRANSFORM_DIR_INVERSE
    )
    return ocio.Config.CreateRaw().getProcessor(curve).getDefaultCPUProcessor()


@cache
def _view(view: str, config_path: str) -> ocio.CPUProcessor:
    try:
        config = ocio.Config.CreateFromFile(config_path)
        display = config.getDefaultDisplay()
        views = list(config.getViews(display))
        if view not in views:
            allowed = ", ".join(repr(name) for name in views)
            raise ImageError(f"view {view!r} is not a view of display {display!r}; allowed: {allowed}")
        built_in = ocio.Config.CreateFromFile(BUILT_IN_CONFIG)
        source = ocio.Config.IdentifyBuiltinColorSpace(config, built_in, RENDERING_SPACE)
        transform = ocio.DisplayViewTransform(src=source, display=display, view=view)
        return config.getProcessor(transform).getDefaultCPUProcessor()
    except (ocio.Exception, ocio.ExceptionMissingFile) as error:
        raise ImageError(f"OpenColorIO config {config_path}: {error}") from error
