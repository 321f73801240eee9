"""Pictures: the sRGB curve, views of OpenColorIO by name, straight alpha, nothing lost in silence."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight_server.images.display import check_view, encode, write_png
from footlight_server.images.files import ImageError
from footlight_server.images.texture import read_image, srgb_to_linear

GREYS = np.linspace(0, 1, 256, dtype=np.float32)


def grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(values.astype(np.float32).reshape(1, -1, 1), 3, axis=2)


def test_every_code_value_survives() -> None:
    linear = grey(srgb_to_linear(GREYS))
    np.testing.assert_array_equal(encode(linear)[0, :, 0], np.arange(256))


def test_values_beyond_the_display_are_clamped() -> None:
    assert encode(grey(np.array([-1.0, 0.0, 1.0, 50.0])))[0, :, 1].tolist() == [0, 0, 255, 255]


@pytest.mark.parametrize("lost", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_magenta(lost: float) -> None:
    color = np.full((1, 2, 3), 0.5, np.float32)
    color[0, 1, 2] = lost
    picture = encode(color)
    assert picture[0, 1].tolist() == [255, 0, 255]
    assert picture[0, 0].tolist() == [188, 188, 188]


def test_alpha_is_straight() -> None:
    color = grey(np.array([0.5, 0.25, 0.0, 0.1]))
    alpha = np.array([1, 0.5, 0, 0], np.float32).reshape(1, 4, 1)
    picture = encode(color, alpha)
    half = round(255 * 0.5)
    assert picture[0, 0].tolist() == [188, 188, 188, 255]
    assert picture[0, 1].tolist() == [188, 188, 188, half]
    assert picture[0, 2].tolist() == [0, 0, 0, 0]
    assert picture[0, 3, 0] == encode(grey(np.array([0.1])))[0, 0, 0]


def test_arguments_are_left_alone() -> None:
    color, alpha = grey(GREYS), np.full((1, 256, 1), 0.5, np.float32)
    before = color.copy()
    encode(color, alpha)
    np.testing.assert_array_equal(color, before)


def test_the_untoned_view_is_the_plain_curve() -> None:
    # The built-in config's own way to sRGB, through other primaries and back, is an independent reference.
    linear = grey(srgb_to_linear(GREYS))
    apart = encode(linear).astype(int) - encode(linear, view="Un-tone-mapped")
    assert np.abs(apart).max() <= 1


def test_a_named_view_is_used() -> None:
    assert encode(grey(np.array([4.0])), view="ACES 2.0 - SDR 100 nits (Rec.709)")[0, 0, 0] < 255


def test_an_unknown_view_lists_those_allowed() -> None:
    with pytest.raises(ImageError, match=r"'Filmic' is not a view of display .*allowed: .*'Un-tone-mapped'"):
        check_view("Filmic")


def test_the_config_of_the_environment_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("OCIO", "ocio://studio-config-v2.1.0_aces-v1.3_ocio-v2.3")
    check_view("ACES 1.0 - SDR Video")
    monkeypatch.setenv("OCIO", str(tmp_path / "missing.ocio"))
    with pytest.raises(ImageError, match=r"missing\.ocio"):
        check_view("ACES 1.0 - SDR Video")


def test_a_png_is_written_whole(tmp_path: Path) -> None:
    linear = grey(srgb_to_linear(GREYS))
    write_png(tmp_path / "a.png", linear)
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), linear, atol=1e-5)
    alpha = np.full((1, 256, 1), 0.5, np.float32)
    write_png(tmp_path / "b.png", linear * alpha, alpha)
    image = oiio.ImageInput.open(str(tmp_path / "b.png"))
    assert image is not None
    assert image.spec().nchannels == 4
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.png", "b.png"]
