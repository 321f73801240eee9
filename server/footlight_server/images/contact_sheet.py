"""A contact sheet: the thumbnails of a layer in rows, as one PNG."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
from numpy.typing import NDArray

from footlight_server.images.exr import write_image
from footlight_server.images.files import ImageError

Picture = NDArray[np.uint8]

# [pixels] Of the whole sheet at most, and between two pictures.
_WIDEST = 4096
_GAP = 4
# [1] sRGB of what is between the pictures, and of a frame whose thumbnail cannot be read.
_GROUND = 32
_MISSING = (96, 32, 32)


@dataclass(frozen=True, slots=True)
class Grid:
    """[pixels] Where pictures go: `columns` in a row, each in a cell `width` x `height` with a gap after it."""

    columns: int
    rows: int
    width: int
    height: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the sheet."""
        return self.columns * (self.width + _GAP) + _GAP, self.rows * (self.height + _GAP) + _GAP

    def corner(self, index: int) -> tuple[int, int]:
        """x, y of a picture's upper left."""
        row, column = divmod(index, self.columns)
        return _GAP + column * (self.width + _GAP), _GAP + row * (self.height + _GAP)


def arrange(count: int, width: int, height: int) -> Grid:
    """A grid for pictures of that size, about as many rows as columns, not wider than a sheet may be."""
    columns = max(1, math.ceil(math.sqrt(count)))
    fitting = max(1, min(width, (_WIDEST - _GAP) // columns - _GAP))
    return Grid(columns, math.ceil(count / columns), fitting, max(1, round(height * fitting / width)))


def write_contact_sheet(path: Path, thumbnails: Sequence[Path]) -> None:
    """The thumbnails in their order, row by row; the first that can be read gives the shape of the cells.

    Raises ImageError naming the file, or if none can be read.
    """
    shape = next((picture.shape for picture in map(_read, thumbnails) if picture is not None), None)
    if shape is None:
        raise ImageError(f"{path}: none of {len(thumbnails)} thumbnails can be read")
    grid = arrange(len(thumbnails), shape[1], shape[0])
    width, height = grid.size
    sheet: Picture = np.full((height, width, 3), _GROUND, np.uint8)
    for index, thumbnail in enumerate(thumbnails):
        picture = _read(thumbnail)
        x, y = grid.corner(index)
        cell = sheet[y : y + grid.height, x : x + grid.width]
        cell[:] = _MISSING if picture is None else _fit(picture, grid)
    write_image(path, oiio.ImageSpec(width, height, 3, oiio.UINT8), sheet)


def _read(path: Path) -> Picture | None:
    """(H, W, 3), or None."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        oiio.geterror()  # fetched, or it is printed at exit
        return None
    pixels = image.read_image(0, 0, 0, 3, oiio.UINT8)
    image.close()
    return None if pixels is None or pixels.ndim != 3 or pixels.shape[2] != 3 else np.asarray(pixels, np.uint8)


def _fit(picture: Picture, grid: Grid) -> Picture:
    """The picture in a cell's size."""
    if picture.shape[:2] == (grid.height, grid.width):
        return picture
    source = oiio.ImageBuf(np.ascontiguousarray(picture))
    target = oiio.ImageBuf(oiio.ImageSpec(grid.width, grid.height, 3, oiio.UINT8))
    if not oiio.ImageBufAlgo.resize(target, source, filtername="triangle"):
        raise ImageError(f"a picture cannot be made smaller: {target.geterror()}")
    return np.asarray(target.get_pixels(oiio.UINT8), np.uint8).reshape(grid.height, grid.width, 3)
