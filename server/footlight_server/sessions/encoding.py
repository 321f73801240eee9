"""Tiles as bytes: half floats, planar, byte-shuffled, zstd; or plain float32. Each tile version is encoded once."""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
import zstandard
from numpy.typing import NDArray

from footlight_server.sessions.tile_queue import TileKey, TileVersion
from footlight_server.workers.film import Film

# [bytes] Encoded tiles that are kept for other viewers of the same render.
_CACHE_BYTES = 16 << 20
# zstd level: 1 is as good as any on noise and the fastest (0.1 ms a tile).
_LEVEL = 1
_HALF_MAX = 65504.0


class Encoding(Enum):
    """Names and meaning as in the protocol's TileEncoding."""

    HALF_SHUFFLE_ZSTD = auto()
    FLOAT = auto()


@dataclass(frozen=True, slots=True)
class EncodedTile:
    """[pixels] A rectangle of an AOV and its pixels as bytes."""

    aov: str
    x: int
    y: int
    width: int
    height: int
    channels: int
    version: TileVersion
    encoding: Encoding
    data: bytes


@dataclass(frozen=True, slots=True)
class Batch:
    """Tiles of one image of this size [pixels]."""

    image_width: int
    image_height: int
    tiles: list[EncodedTile]


def encode(pixels: NDArray[np.float32], encoding: Encoding, compressor: zstandard.ZstdCompressor) -> bytes:
    """The bytes of (height, width, channels) pixels, as the protocol describes them."""
    planar = np.ascontiguousarray(pixels.transpose(2, 0, 1))
    if encoding is Encoding.FLOAT:
        return planar.astype("<f4", copy=False).tobytes()
    half = np.clip(planar, -_HALF_MAX, _HALF_MAX).astype("<f2")
    shuffled = np.ascontiguousarray(half.reshape(-1).view(np.uint8).reshape(-1, 2).T)
    return compressor.compress(shuffled.data)


class TileEncoder:
    """Encodes tiles of one film. One thread at a time."""

    def __init__(self, film: Film) -> None:
        self._film = film
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._cache: OrderedDict[tuple[TileKey, TileVersion, Encoding], bytes] = OrderedDict()
        self._cached = 0

    @property
    def film_bytes(self) -> int:
        """[bytes] Of the pixels behind it."""
        return self._film.shape.bytes

    def has(self, aov: str, tiles: Iterable[int]) -> bool:
        """The film has all of these tiles."""
        return aov in self._film.planes and all(tile < self._film.shape.tiles for tile in tiles)

    def encode_batch(self, tiles: Iterable[tuple[TileKey, TileVersion]], encoding: Encoding, most: int) -> Batch:
        """As many of `tiles` as fit into `most` bytes, in order, at least one."""
        chosen: list[EncodedTile] = []
        size = 0
        for key, version in tiles:
            encoded = self._encode(key, version, encoding)
            size += len(encoded.data)
            if chosen and size > most:
                break
            chosen.append(encoded)
        return Batch(self._film.shape.width, self._film.shape.height, chosen)

    def _encode(self, tile: TileKey, version: TileVersion, encoding: Encoding) -> EncodedTile:
        box = self._film.shape.box(tile.tile)
        plane = self._film.planes[tile.aov]
        key = (tile, version, encoding)
        data = self._cache.get(key)
        if data is None:
            rows, columns = -(-box.height // version.scale), -(-box.width // version.scale)
            pixels = plane[box.y : box.y + rows, box.x : box.x + columns]
            data = encode(pixels, encoding, self._compressor)
            self._keep(key, data)
        return EncodedTile(tile.aov, box.x, box.y, box.width, box.height, plane.shape[2], version, encoding, data)

    def _keep(self, key: tuple[TileKey, TileVersion, Encoding], data: bytes) -> None:
        self._cache[key] = data
        self._cached += len(data)
        while self._cached > _CACHE_BYTES:
            _, dropped = self._cache.popitem(last=False)
            self._cached -= len(dropped)
