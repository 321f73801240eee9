"""Footlight against the references of an independent renderer: stage, translator and core, by mean and by 8x8 tiles."""

from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import footlight_core
from footlight_server.images.texture import read_image
from footlight_server.usd.open import open_stage
from footlight_server.usd.request import TranslateRequest
from footlight_server.usd.translate import translate
from tests.images import statistics

HERE = Path(__file__).parent
NAMES = sorted(path.stem for path in (HERE / "stages").glob("*.usda"))
REPLICATES = 24
SPP = 32  # of one replicate
MAX_DEPTH = 6  # edges, as in make_references.py
# The references are sums of 512 samples in single precision: where there is no noise, this is what they are good for.
SINGLE_PRECISION_SUM = 512 * 2.0**-24


def render(name: str, seeds: range, strategy: str = "mis") -> npt.NDArray[np.float64]:
    """Independent renders (len(seeds), H, W, 3) of a stage."""
    scene = footlight_core.Scene()
    report = translate(
        open_stage(HERE / "stages" / f"{name}.usda"),
        scene,
        TranslateRequest(),
        load_image=lambda path, admit: read_image(Path(path), admit=admit),
    )
    assert not report.left_out, report.left_out
    images = []
    for seed in seeds:
        options = footlight_core.RenderOptions(
            width=report.width,
            height=report.height,
            seed=seed,
            max_depth=MAX_DEPTH,
            pixel_filter="box",
            filter_width=1.0,
            strategy=strategy,
        )
        renderer = footlight_core.Renderer(scene, options)
        assert renderer.render(0, SPP, 0, renderer.tiles)
        assert not any(renderer.stats()["guards"].values())
        images.append(renderer.read("color"))
    return np.stack(images).astype(np.float64)


@cache
def footlight(name: str) -> statistics.Image:
    return statistics.of_replicates(render(name, range(1, REPLICATES + 1)))


def reference(name: str) -> statistics.Image:
    return statistics.read_reference(HERE / "references" / f"{name}.exr")


def agreement(image: statistics.Image, expected: statistics.Image) -> statistics.Verdict:
    return statistics.compare(image, expected, rounding=SINGLE_PRECISION_SUM)


@pytest.mark.parametrize("name", NAMES)
def test_mean_and_tiles_agree(name: str, tmp_path: Path) -> None:
    image, expected = footlight(name), reference(name)
    verdict = agreement(image, expected)
    if verdict.differ:
        statistics.write_failure(tmp_path, image, expected)
    assert not verdict.differ, f"{verdict}; images in {tmp_path}"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_one_percent_of_bias_would_be_rejected(name: str, factor: float) -> None:
    """The comparison above has the power that it claims, on these very images."""
    assert agreement(statistics.scaled(footlight(name), factor), reference(name)).differ


def test_every_stage_has_a_reference() -> None:
    assert {path.stem for path in (HERE / "references").glob("*.exr")} == set(NAMES)


def test_references_are_small() -> None:
    assert sum(path.stat().st_size for path in (HERE / "references").glob("*.exr")) < 3_000_000
