"""Laws of tiles as bytes: they come back as they went, and batches stay small."""

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from footlight_server.sessions.encoding import Encoding, TileEncoder, encode
from footlight_server.sessions.tile_queue import TileKey, TileVersion
from footlight_server.workers.film import Film, FilmShape, shape_of

MESSAGE = 256 << 10


def decode_half(data: bytes, height: int, width: int, channels: int) -> NDArray[np.float32]:
    """As the comment in tile.proto says, byte by byte."""
    raw = zstandard.ZstdDecompressor().decompress(data)
    low, high = raw[: len(raw) // 2], raw[len(raw) // 2 :]
    joined = bytes(byte for pair in zip(low, high, strict=True) for byte in pair)
    planes = np.frombuffer(joined, "<f2").reshape(channels, height, width)
    return planes.transpose(1, 2, 0).astype(np.float32)


@given(hnp.arrays(np.float32, st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 4))))
def test_pixels_come_back_as_half_floats(pixels: NDArray[np.float32]) -> None:
    data = encode(pixels, Encoding.HALF_SHUFFLE_ZSTD, zstandard.ZstdCompressor(level=1))
    expected = np.clip(pixels, -65504, 65504).astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(decode_half(data, *pixels.shape), expected)


@given(hnp.arrays(np.float32, st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 4))))
def test_float_is_exact(pixels: NDArray[np.float32]) -> None:
    data = encode(pixels, Encoding.FLOAT, zstandard.ZstdCompressor())
    back = np.frombuffer(data, "<f4").reshape(pixels.shape[2], *pixels.shape[:2]).transpose(1, 2, 0)
    np.testing.assert_array_equal(back, pixels)


def film_of(width: int, height: int) -> Film:
    shape: FilmShape = shape_of(width, height, [("color", 3)])
    noise = np.random.default_rng(1).random((height, width, 3), np.float32)
    return Film(shape, {"color": noise})


@pytest.mark.parametrize("encoding", Encoding)
def test_batches_stay_below_the_limit_and_cover_the_image(encoding: Encoding) -> None:
    film = film_of(1000, 700)
    encoder = TileEncoder(film)
    due = {TileKey("color", tile): TileVersion(1, 1) for tile in range(film.shape.tiles)}
    covered = np.zeros((700, 1000), int)
    while due:
        batch = encoder.encode_batch(due.items(), encoding, 240 << 10)
        assert sum(len(tile.data) + 100 for tile in batch.tiles) <= MESSAGE
        for tile in batch.tiles:
            covered[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] += 1
        due = dict(list(due.items())[len(batch.tiles) :])
    assert (covered == 1).all()


def test_a_version_is_encoded_once() -> None:
    film = film_of(64, 64)
    encoder = TileEncoder(film)
    due = {TileKey("color", 0): TileVersion(1, 1)}
    first = encoder.encode_batch(due.items(), Encoding.FLOAT, MESSAGE).tiles[0].data
    film.planes["color"][:] = 0
    assert encoder.encode_batch(due.items(), Encoding.FLOAT, MESSAGE).tiles[0].data is first
    newer = {TileKey("color", 0): TileVersion(2, 1)}
    assert encoder.encode_batch(newer.items(), Encoding.FLOAT, MESSAGE).tiles[0].data != first


def test_a_coarse_tile_has_a_pixel_for_each_square() -> None:
    film = film_of(100, 70)
    encoder = TileEncoder(film)
    last = film.shape.tiles - 1  # 36 x 6 pixels
    tile = encoder.encode_batch([(TileKey("color", last), TileVersion(0, 8))], Encoding.FLOAT, MESSAGE).tiles[0]
    assert (tile.width, tile.height) == (36, 6)
    assert len(tile.data) == 4 * 3 * 5 * 1
