"""Tiles: what a server encodes as the .proto says is what the client shows, and nothing else passes."""

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from footlight.errors import ProtocolError
from footlight.image import LiveImage, TileBatch, decode_batch, decode_tile
from footlight.v1 import tile_pb2


def encoded(
    pixels: np.ndarray, *, exact: bool = False, scale: int = 1, size: tuple[int, int] | None = None
) -> tile_pb2.Tile:
    """A tile by the words of tile.proto: planar, low bytes then high bytes, one zstd frame."""
    height, width, channels = pixels.shape
    if exact:
        data, encoding = pixels.transpose(2, 0, 1).astype("<f4").tobytes(), tile_pb2.TILE_ENCODING_FLOAT
    else:
        numbers = np.frombuffer(pixels.transpose(2, 0, 1).astype("<f2").tobytes(), np.uint8)
        data = zstandard.compress(numbers[0::2].tobytes() + numbers[1::2].tobytes(), 1)
        encoding = tile_pb2.TILE_ENCODING_HALF_SHUFFLE_ZSTD
    width, height = size or (width, height)
    return tile_pb2.Tile(
        aov="color", x=0, y=0, width=width, height=height, scale=scale, channels=channels, encoding=encoding, data=data
    )


TILES = arrays.arrays(
    np.float32,
    st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 4)),
    elements=st.floats(-6e4, 6e4, width=16),
)


@settings(deadline=None)
@given(TILES)
def test_half_tiles_come_back(pixels: np.ndarray) -> None:
    assert decode_tile(encoded(pixels)).pixels.tobytes() == pixels.astype(np.float16).astype(np.float32).tobytes()


@settings(deadline=None)
@given(TILES)
def test_float_tiles_come_back_exactly(pixels: np.ndarray) -> None:
    assert decode_tile(encoded(pixels, exact=True)).pixels.tobytes() == pixels.tobytes()


@settings(deadline=None)
@given(st.integers(1, 64), st.integers(1, 64), st.sampled_from([2, 4, 8]))
def test_a_coarse_tile_covers_its_rectangle(width: int, height: int, scale: int) -> None:
    coarse = (
        np.arange(-(-height // scale) * -(-width // scale) * 3, dtype=np.float32).reshape(-(-height // scale), -1, 3)
        % 2048
    )  # the integers that float16 holds exactly
    tile = decode_tile(encoded(coarse, scale=scale, size=(width, height)))
    assert tile.pixels.shape == (height, width, 3)
    for y, x in ((0, 0), (height - 1, width - 1)):
        assert tile.pixels[y, x].tolist() == coarse[y // scale, x // scale].tolist()


def damaged(kind: str) -> tile_pb2.Tile:
    good = encoded(np.ones((4, 4, 3), np.float32))
    match kind:
        case "cut":
            good.data = good.data[:-3]
        case "noise":
            good.data = b"\x01\x02\x03\x04" * 8
        case "empty":
            good.data = b""
        case "too large":
            good.data = zstandard.compress(bytes(1 << 20))
        case "too small":
            good.data = zstandard.compress(bytes(10))
        case "size unsaid":
            good.data = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1 << 20))
        case "float":
            good.encoding = tile_pb2.TILE_ENCODING_FLOAT
    return good


@pytest.mark.parametrize("kind", ["cut", "noise", "empty", "too large", "too small", "size unsaid", "float"])
def test_damaged_tiles_are_refused(kind: str) -> None:
    with pytest.raises(ProtocolError, match="a tile"):
        decode_tile(damaged(kind))


def batch(*tiles: tile_pb2.Tile, epoch: int = 1, width: int = 8, height: int = 4) -> TileBatch:
    return decode_batch(
        tile_pb2.TileBatch(epoch=epoch, sequence=1, image_width=width, image_height=height, tiles=tiles)
    )


def test_the_newest_tile_wins_and_an_epoch_forgets() -> None:
    image = LiveImage()
    one, two = (encoded(np.full((4, 4, 3), value, np.float32)) for value in (1, 2))
    two.x = 4
    image.add(batch(one, two))
    assert image.pixels["color"].shape == (4, 8, 3)
    assert image.pixels["color"][0, :, 0].tolist() == [1, 1, 1, 1, 2, 2, 2, 2]
    two.x = 0
    image.add(batch(two))
    assert image.pixels["color"][0, :, 0].tolist() == [2] * 8
    image.add(batch(one, epoch=2))
    assert image.pixels["color"][0, :, 0].tolist() == [1, 1, 1, 1, 0, 0, 0, 0]


def test_a_tile_outside_the_image_is_refused() -> None:
    tile = encoded(np.ones((4, 4, 3), np.float32))
    tile.x = 5
    with pytest.raises(ProtocolError, match="outside the image"):
        LiveImage().add(batch(tile))
