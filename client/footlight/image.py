"""Tiles as numpy arrays, and the image they add up to."""

from dataclasses import dataclass

import numpy as np
import zstandard
from numpy.typing import NDArray

from footlight.errors import ProtocolError
from footlight.v1 import tile_pb2

Pixels = NDArray[np.float32]

_HALF = np.dtype("<f2")
_FLOAT = np.dtype("<f4")


@dataclass(frozen=True, slots=True)
class Tile:
    """A rectangle of one AOV, at the image's full resolution.

    `x`, `y` [pixels] is its upper left corner, origin at the top left of the image. `pixels` (height, width, C)
    float32, linear Rec.709 where it is colour. `scale` [pixels] is 1, or the edge of the squares that a coarse
    first image consists of. `samples` [samples per pixel], 0 while coarse.
    """

    aov: str
    x: int
    y: int
    scale: int
    samples: int
    pixels: Pixels


@dataclass(frozen=True, slots=True)
class TileBatch:
    """Tiles that came together. A new `epoch` makes those of the epoch before worthless."""

    epoch: int
    sequence: int
    width: int
    height: int
    tiles: tuple[Tile, ...]


class LiveImage:
    """The image as far as it has come: the newest tile wins.

    `pixels[aov]` is (H, W, C) float32 and changes with every `add`; copy it to keep it. Pixels not yet seen are 0.
    """

    def __init__(self) -> None:
        self.pixels: dict[str, Pixels] = {}
        self._epoch = -1

    def add(self, batch: TileBatch) -> None:
        """Take the tiles in. Raises ProtocolError for one that lies outside the image."""
        if batch.epoch != self._epoch:
            self.pixels, self._epoch = {}, batch.epoch
        for tile in batch.tiles:
            height, width, channels = tile.pixels.shape
            if tile.x + width > batch.width or tile.y + height > batch.height:
                raise ProtocolError(f"a tile at {tile.x},{tile.y} of {width}x{height} is outside the image")
            image = self.pixels.get(tile.aov)
            if image is None:
                image = np.zeros((batch.height, batch.width, channels), np.float32)
                self.pixels[tile.aov] = image
            image[tile.y : tile.y + height, tile.x : tile.x + width] = tile.pixels


def decode_batch(message: tile_pb2.TileBatch) -> TileBatch:
    """The batch with its tiles decoded. Raises ProtocolError for data that is not what the tile says."""
    tiles = tuple(decode_tile(tile) for tile in message.tiles)
    return TileBatch(message.epoch, message.sequence, message.image_width, message.image_height, tiles)


def decode_tile(message: tile_pb2.Tile) -> Tile:
    """The tile as an array. Raises ProtocolError as `decode_batch`."""
    scale = max(message.scale, 1)
    rows, columns = -(-message.height // scale), -(-message.width // scale)
    count = rows * columns * message.channels
    if message.encoding == tile_pb2.TILE_ENCODING_FLOAT:
        planes: NDArray[np.floating] = np.frombuffer(_sized(message.data, count * _FLOAT.itemsize), _FLOAT)
    else:
        planes = _unshuffle(_decompress(message.data, count * _HALF.itemsize))
    planar = planes.reshape(message.channels, rows, columns)
    pixels: Pixels = np.ascontiguousarray(planar.transpose(1, 2, 0), dtype=np.float32)
    if scale > 1:
        pixels = pixels.repeat(scale, axis=0).repeat(scale, axis=1)[: message.height, : message.width]
    return Tile(message.aov, message.x, message.y, scale, message.samples, pixels)


def _unshuffle(data: bytes) -> NDArray[np.float16]:
    """Numbers whose low bytes come first and whose high bytes follow."""
    by_significance = np.frombuffer(data, np.uint8).reshape(_HALF.itemsize, -1)
    numbers: NDArray[np.float16] = np.ascontiguousarray(by_significance.T).view(_HALF).reshape(-1)
    return numbers


def _decompress(data: bytes, size: int) -> bytes:
    # The frame's own claim is checked first: decompress would allocate whatever it says.
    try:
        claimed = zstandard.frame_content_size(data)
        if claimed not in (-1, size):
            raise ProtocolError(f"a tile holds {claimed} bytes instead of {size}")
        return _sized(zstandard.ZstdDecompressor().decompress(data, max_output_size=size), size)
    except zstandard.ZstdError as error:
        raise ProtocolError(f"a tile cannot be decompressed: {error}") from error


def _sized(data: bytes, size: int) -> bytes:
    if len(data) != size:
        raise ProtocolError(f"a tile holds {len(data)} bytes instead of {size}")
    return data
