"""The first image of a large render: one sample in each square of 8x8 pixels, at once."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

# [pixels] Edge of a square.
SCALE = 8
# [tiles] Smaller images are as quick at full size.
_LARGE = 256
# [triangles] A second renderer builds its own tree over the scene: 0.1 s for this many.
_QUICK = 300_000


class CoarseRenderer(Protocol):
    """The part of the core's Renderer that is needed here."""

    tiles: int

    def render(self, sample_begin: int, sample_end: int, tile_begin: int, tile_end: int) -> bool:
        """Take samples."""
        ...

    def read(self, aov: str) -> NDArray[np.float32]:
        """The image so far."""
        ...


def worth_it(tiles: int, triangles: int) -> bool:
    """A coarse image comes well before the first pass over the whole one would be done."""
    return tiles > _LARGE and triangles <= _QUICK


def coarse_image(width: int, height: int, build: Callable[[int, int], CoarseRenderer]) -> NDArray[np.float32]:
    """`color` (ceil(height / SCALE), ceil(width / SCALE), 3); `build` makes a renderer of a size [pixels]."""
    renderer = build(-(-width // SCALE), -(-height // SCALE))
    renderer.render(0, 1, 0, renderer.tiles)
    return renderer.read("color")
