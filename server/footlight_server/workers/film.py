"""Pixels in memory shared by worker and server: one float32 plane per AOV, each height x width x channels."""

import fcntl
import mmap
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# [pixels] Edge of a tile, as in the core.
TILE = 64
# [bytes] Where a plane may begin: a cache line.
_ALIGN = 64
# [pixels] As of a RenderSpec; [planes], [channels] more than there are AOVs. For films that others describe.
_LONGEST_EDGE, _MOST_PIXELS = 32768, 1 << 28
_MOST_PLANES, _MOST_CHANNELS = 64, 16


@dataclass(frozen=True, slots=True)
class Plane:
    """One AOV in the film: its channels, and [bytes] where it begins."""

    name: str
    channels: int
    offset: int


@dataclass(frozen=True, slots=True)
class Box:
    """[pixels] A tile's rectangle, origin at the top left."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class FilmShape:
    """[pixels] The image and its planes."""

    width: int
    height: int
    planes: tuple[Plane, ...]

    @property
    def bytes(self) -> int:
        """Of the whole film."""
        return max((p.offset + 4 * self.width * self.height * p.channels for p in self.planes), default=0)

    def check(self) -> None:
        """Raise ValueError for what no film has."""
        edges = min(self.width, self.height) >= 1 and max(self.width, self.height) <= _LONGEST_EDGE
        if not edges or self.width * self.height > _MOST_PIXELS:
            raise ValueError(f"a film of {self.width}x{self.height} pixels")
        if len(self.planes) > _MOST_PLANES or any(not 1 <= plane.channels <= _MOST_CHANNELS for plane in self.planes):
            raise ValueError("a film of planes that no image has")

    @property
    def columns(self) -> int:
        """Tiles in a row."""
        return -(-self.width // TILE)

    @property
    def tiles(self) -> int:
        """Tiles in the image."""
        return self.columns * -(-self.height // TILE)

    def box(self, tile: int) -> Box:
        """The rectangle of a tile; tiles count row by row from the top left."""
        y, x = (TILE * i for i in divmod(tile, self.columns))
        return Box(x, y, min(TILE, self.width - x), min(TILE, self.height - y))


def shape_of(width: int, height: int, channels: Sequence[tuple[str, int]]) -> FilmShape:
    """The layout of a film that holds these AOVs (name, channels)."""
    planes: list[Plane] = []
    offset = 0
    for name, count in channels:
        planes.append(Plane(name, count, offset))
        offset += 4 * width * height * count
        offset += -offset % _ALIGN
    return FilmShape(width, height, tuple(planes))


def _views(shape: FilmShape, memory: mmap.mmap) -> Iterator[tuple[str, NDArray[np.float32]]]:
    for plane in shape.planes:
        size = (shape.height, shape.width, plane.channels)
        pixels = np.frombuffer(memory, np.float32, size[0] * size[1] * size[2], plane.offset)
        yield plane.name, pixels.reshape(size)


@dataclass(frozen=True, slots=True)
class Film:
    """`planes[name]` is (height, width, channels) float32; the shared memory lives as long as one of these views."""

    shape: FilmShape
    planes: Mapping[str, NDArray[np.float32]]


def create_film(shape: FilmShape) -> tuple[Film, int]:
    """A film of zeros, its size sealed, and its descriptor, which the caller closes. Takes memory as it is written."""
    descriptor = os.memfd_create("footlight-film", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(descriptor, shape.bytes)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        memory = mmap.mmap(descriptor, shape.bytes)
    except BaseException:
        os.close(descriptor)
        raise
    return Film(shape, dict(_views(shape, memory))), descriptor


def open_film(shape: FilmShape, descriptor: int) -> Film:
    """The server's view, read only. Closes the descriptor.

    Raises ValueError if the memory is smaller than the shape or could shrink: reading it would then kill the server.
    """
    try:
        shape.check()
        if not fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK:
            raise ValueError("the worker's film could shrink")
        if os.fstat(descriptor).st_size < shape.bytes:
            raise ValueError("the worker's film is smaller than its shape")
        memory = mmap.mmap(descriptor, shape.bytes, prot=mmap.PROT_READ)
    finally:
        os.close(descriptor)
    return Film(shape, dict(_views(shape, memory)))
