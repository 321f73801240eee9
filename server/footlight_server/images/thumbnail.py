"""Thumbnails: a small PNG of the colour, for lists and contact sheets."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
from numpy.typing import NDArray

from footlight_server.images.display import write_png
from footlight_server.images.files import ImageError

Pixels = NDArray[np.float32]

# [pixels] Said in the protocol.
WIDTH = 320


def write_thumbnail(path: Path, color: Pixels) -> None:
    """Linear Rec.709 `color` (H, W, 3) as a PNG, plain sRGB, at most 320 pixels wide and as high as it is then.

    Raises ImageError naming the file.
    """
    write_png(path, shrink(color, WIDTH))


def shrink(color: Pixels, width: int) -> Pixels:
    """The image (h, w, 3) at most so many [pixels] wide, each pixel the mean of those it stands for; else as it is."""
    height, full, channels = color.shape
    if full <= width:
        return np.ascontiguousarray(color)
    source = oiio.ImageBuf(np.ascontiguousarray(color))
    spec = oiio.ImageSpec(width, max(1, round(height * width / full)), channels, oiio.FLOAT)
    target = oiio.ImageBuf(spec)
    if not oiio.ImageBufAlgo.resize(target, source, filtername="box", filterwidth=0.0):
        raise ImageError(f"a thumbnail cannot be made: {target.geterror()}")
    pixels = target.get_pixels(oiio.FLOAT)
    assert pixels is not None
    return np.asarray(pixels, np.float32).reshape(spec.height, spec.width, channels)
