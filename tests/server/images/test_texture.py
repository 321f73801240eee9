"""Textures arrive linear whatever the format, and bad files are refused by name before they cost anything."""

import os
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight_server.images.files import ImageError
from footlight_server.images.texture import read_image, srgb_to_linear


def write(path: Path, pixels: np.ndarray, kind: str) -> Path:
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    assert output.close()
    return path


@pytest.mark.parametrize(
    ("name", "kind", "linear", "step"),
    [
        ("a.exr", "float", True, 1e-7),
        ("a.exr", "half", True, 1e-3),
        ("a.hdr", "float", True, 1e-2),
        ("a.tif", "float", True, 1e-7),
        ("a.png", "uint8", False, 1 / 255),
        ("a.tif", "uint8", False, 1 / 255),
        ("a.png", "uint16", False, 1 / 65535),
    ],
)
def test_texels_are_linear_and_top_down(tmp_path: Path, name: str, kind: str, linear: bool, step: float) -> None:
    ramp = np.linspace(0.05, 0.95, 24, dtype=np.float32).reshape(2, 4, 3)
    texels = read_image(write(tmp_path / name, ramp, kind))
    assert texels.dtype == np.float32
    assert texels.flags.c_contiguous
    expected = ramp if linear else srgb_to_linear(ramp)
    # The slope of the sRGB curve is at most 2.275, at white.
    np.testing.assert_allclose(texels, expected, atol=step * 2.3)


@pytest.mark.parametrize("channels", [1, 2, 4, 6])
def test_other_channel_counts(tmp_path: Path, channels: int) -> None:
    pixels = np.random.default_rng(1).random((3, 5, channels), np.float32)
    texels = read_image(write(tmp_path / "a.exr", pixels, "float"))
    expected = pixels[..., [0, 0, 0]] if channels < 3 else pixels[..., :3]
    assert texels.tobytes() == np.ascontiguousarray(expected).tobytes()


def test_what_is_not_finite_is_passed_on(tmp_path: Path) -> None:
    pixels = np.ones((2, 2, 3), np.float32)
    pixels[0, 0], pixels[1, 1] = np.nan, np.inf
    texels = read_image(write(tmp_path / "a.exr", pixels, "float"))
    np.testing.assert_array_equal(texels, pixels)


def test_the_color_space_can_be_said(tmp_path: Path) -> None:
    path = write(tmp_path / "a.png", np.full((1, 1, 3), 0.5, np.float32), "uint8")
    assert read_image(path, "raw")[0, 0, 0] == pytest.approx(128 / 255)
    assert read_image(path, "sRGB")[0, 0, 0] == pytest.approx(0.2158605, abs=1e-6)


def test_the_curve_meets_the_standard() -> None:
    # IEC 61966-2-1: both pieces, their joint, and the ends.
    encoded = np.array([0, 0.02, 0.04045, 0.5, 1, -0.5], np.float32)
    expected = [0, 0.02 / 12.92, 0.04045 / 12.92, 0.21404114, 1, -0.21404114]
    np.testing.assert_allclose(srgb_to_linear(encoded), expected, rtol=1e-6)
    wrong = encoded.astype(np.float64).clip(0) ** 2.2
    assert not np.allclose(wrong, expected, rtol=1e-3)


def bad_files(directory: Path) -> dict[str, tuple[Path, str]]:
    noise = np.random.default_rng(1).random((64, 64, 3), np.float32)
    whole = write(directory / "whole.exr", noise, "float").read_bytes()
    cut, text, header = directory / "cut.exr", directory / "text.exr", directory / "header.exr"
    cut.write_bytes(whole[: len(whole) // 2])
    text.write_text("this is no image")
    header.write_bytes(whole[:200])
    fifo = directory / "fifo.exr"
    os.mkfifo(fifo)
    return {
        "missing": (directory / "missing.exr", "No such file"),
        "directory": (directory, "not a regular file"),
        "fifo": (fifo, "not a regular file"),
        "device": (Path("/dev/zero"), "not a regular file"),
        "cut": (cut, "."),
        "text": (text, "."),
        "header": (header, "."),
    }


@pytest.mark.parametrize("kind", ["missing", "directory", "fifo", "device", "cut", "text", "header"])
def test_bad_files_are_refused_by_name(tmp_path: Path, kind: str) -> None:
    path, reason = bad_files(tmp_path)[kind]
    with pytest.raises(ImageError, match=reason) as error:
        read_image(path)
    assert str(error.value).startswith(f"{path}: cannot be read: ")


def test_size_is_checked_before_texels(tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", np.zeros((8, 16, 3), np.float32), "float")
    assert read_image(path, texel_budget=128).shape == (8, 16, 3)
    with pytest.raises(ImageError, match="16x8 texels; at most 127 are allowed"):
        read_image(path, texel_budget=127)
