"""Laws about the film: sums that lose nothing, guards that count, an error figure that is right."""

import numpy as np
import pytest

from tests.laws import scenes
from tests.laws.scenes import SUITE, Camera, Material, Stage

SIZE = {"width": 48, "height": 48}


def test_f01_ten_thousand_equal_samples_keep_their_value() -> None:
    """F01: in single precision a million samples of 1.1 add up to 1 % too much."""
    stage = Stage(Camera(np.eye(4)), (), (scenes.dome((1.1, 0.3, 7.7)),))
    pixels = scenes.image(stage, width=8, height=8, spp=10_000)
    expected = np.array([1.1, 0.3, 7.7], np.float32)
    assert np.abs(pixels / expected - 1).max() < 1.2e-7


def test_f01_control_single_precision_drifts() -> None:
    total = np.cumsum(np.full(10_000, 1.1, np.float32), dtype=np.float32)[-1]
    assert abs(float(total) / 11_000 - 1) > 1e-6


@pytest.mark.parametrize("name", ["gallery", "sky", "room"])
def test_c2_the_error_figure_is_honest(name: str) -> None:
    """The error AOV against what independent seeds really scatter by, over the whole picture."""
    count = 16
    renders = [scenes.run(SUITE[name](), spp=32, seed=s, aovs=["color", "error"], **SIZE) for s in range(count)]
    images = np.stack([r.read("color") for r in renders]).astype(np.float64)
    claimed = np.stack([r.read("error") for r in renders]).astype(np.float64)
    ratio = np.sqrt((claimed**2).mean() / images.var(0, ddof=1).mean())
    assert 0.8 < ratio < 1.6, f"claimed over real error {ratio}"


def test_c2_a_noiseless_image_has_no_error() -> None:
    stage = Stage(Camera(np.eye(4)), (), (scenes.dome(),))
    render = scenes.run(stage, aovs=["color", "error"], **SIZE)
    assert (render.read("error") == 0).all()
    assert render.error()["mean"] == 0


def test_the_error_falls_with_the_samples() -> None:
    aovs = ["color", "error"]
    errors = [scenes.run(scenes.room(), spp=spp, aovs=aovs, **SIZE).error()["mean"] for spp in (16, 256)]
    assert 2.5 < errors[0] / errors[1] < 16


@pytest.mark.parametrize("name", SUITE)
def test_f03_no_guard_fires(name: str) -> None:
    """F03: over the suite, with every strategy, not one sample is bad."""
    for strategy in ("mis", "light", "bsdf"):
        render = scenes.run(SUITE[name](), spp=64, strategy=strategy, **SIZE)
        assert np.isfinite(render.read("color")).all()
        assert (render.read("color") >= 0).all()


def test_f03_guards_are_counters_that_exist() -> None:
    """A law about counters that are not there would hold by itself."""
    counters = scenes.renderer(scenes.room()).stats()["guards"]
    assert len(counters) >= 3
    assert all(isinstance(v, int) for v in counters.values())


def test_sample_count_and_alpha() -> None:
    ball = scenes.icosphere(Material(), 3)
    stage = Stage(Camera(scenes.translate(0.0, 0.0, 4.0), focal_length=36.0), (ball,), ())
    render = scenes.run(stage, spp=64, aovs=["color", "alpha", "sample_count"], **SIZE)
    assert (render.read("sample_count") == 64).all()
    alpha = render.read("alpha")
    assert alpha.min() == 0
    assert alpha.max() == 1
    # A unit sphere from 4: its outline has the tangent 1/sqrt(15) in a view that is one wide.
    area = np.pi / 15
    assert abs(alpha.mean() - area) < 0.01


def test_read_tile_is_a_part_of_read() -> None:
    render = scenes.run(scenes.room(), spp=2, width=130, height=70)
    whole = render.read("color")
    for tile in range(render.tiles):
        row, column = divmod(tile, 3)
        part = render.read_tile("color", tile)
        assert np.array_equal(part, whole[64 * row : 64 * row + 64, 64 * column : 64 * column + 64])


def test_cancelled_render_says_so() -> None:
    renderer = scenes.renderer(scenes.room(), width=256, height=256)
    renderer.cancel()
    assert renderer.render(0, 1_000_000, 0, renderer.tiles) is False


def test_f11_foreign_states_are_refused() -> None:
    """F11: bytes of another film, of no film, or of a part of one are refused and leave the film as it was."""
    here = scenes.run(scenes.room(), spp=4, width=32, height=32)
    before = here.read("color").copy()
    other = scenes.run(scenes.room(), spp=4, width=16, height=32)
    state: bytes = here.state()
    for wrong in (other.state(), b"", b"no film", state[:-1], state[: len(state) // 2], state + b"x"):
        with pytest.raises(ValueError, match=r"film|state"):
            here.merge(wrong)
        assert np.array_equal(before, here.read("color"))
