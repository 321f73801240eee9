"""Thumbnails and contact sheets: what a pixel of a small picture stands for, and where pictures lie on a sheet."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight_server.images.contact_sheet import arrange, write_contact_sheet
from footlight_server.images.display import encode
from footlight_server.images.files import ImageError
from footlight_server.images.thumbnail import WIDTH, shrink, write_thumbnail


def read(path: Path) -> np.ndarray:
    pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
    assert pixels is not None
    return np.asarray(pixels)


def test_a_pixel_of_a_thumbnail_is_the_mean_of_those_it_stands_for() -> None:
    image = np.random.default_rng(1).random((720, 1280, 3), np.float32)
    small = shrink(image, 320)
    means = image.reshape(180, 4, 320, 4, 3).astype(np.float64).mean((1, 3))
    assert np.abs(small - means).max() < 1e-6
    assert np.abs(image[::4, ::4] - means).max() > 0.1, "the mutant that takes every fourth pixel"


@pytest.mark.parametrize(("size", "small"), [((40, 100), (40, 100)), ((1, 5000), (1, 320)), ((641, 640), (320, 320))])
def test_the_shape_is_kept_and_nothing_grows(size: tuple[int, int], small: tuple[int, int]) -> None:
    shape = shrink(np.zeros((*size, 3), np.float32), WIDTH).shape
    assert abs(shape[0] - small[0]) <= 1
    assert shape[1:] == (small[1], 3)


def test_a_thumbnail_shows_what_is_not_finite(tmp_path: Path) -> None:
    image = np.full((80, 640, 3), 0.18, np.float32)
    image[40, 320] = np.nan
    write_thumbnail(tmp_path / "a.png", image)
    pixels = read(tmp_path / "a.png")
    assert pixels.shape == (40, 320, 3)
    assert tuple(pixels[20, 160]) == (255, 0, 255)
    assert (pixels[0] == encode(image[:1, :1])).all()


@given(st.integers(1, 20_000), st.integers(1, 320), st.integers(1, 4000))
def test_pictures_on_a_sheet_lie_apart_and_inside(count: int, width: int, height: int) -> None:
    grid = arrange(count, width, height)
    assert grid.columns * grid.rows >= count
    assert grid.size[0] <= 4096
    x, y = grid.corner(count - 1)
    assert x + grid.width < grid.size[0]
    assert y + grid.height < grid.size[1]
    if count > 1:
        here, there = grid.corner(0), grid.corner(1)
        assert there[0] - here[0] > grid.width or there[1] - here[1] > grid.height


def test_a_sheet_holds_the_pictures_in_order_and_marks_what_is_missing(tmp_path: Path) -> None:
    greys = [0.1, 0.4, 0.9]
    paths = [tmp_path / f"{i}.png" for i in range(3)]
    for path, grey in zip(paths, greys, strict=True):
        write_thumbnail(path, np.full((24, 32, 3), grey, np.float32))
    paths[1].write_bytes(b"no picture")
    sheet = tmp_path / "sheet.png"
    write_contact_sheet(sheet, paths)
    pixels, grid = read(sheet), arrange(3, 32, 24)
    assert pixels.shape == (grid.size[1], grid.size[0], 3)
    for index in range(3):
        x, y = grid.corner(index)
        cell = pixels[y : y + grid.height, x : x + grid.width]
        expected = (96, 32, 32) if index == 1 else encode(np.full((1, 1, 3), greys[index], np.float32))[0, 0]
        assert (cell == expected).all()
        assert (pixels[y - 1, x - 1] == 32).all()


def test_a_sheet_of_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="none of 1 thumbnails"):
        write_contact_sheet(tmp_path / "sheet.png", [tmp_path / "gone.png"])
