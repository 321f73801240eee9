"""The image comparison has power: equal means pass, a bias of 1 %, a wrong tile or another reference does not."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from tests.images import statistics

REFERENCES = sorted((Path(__file__).parent / "references").glob("*.exr"))
SHAPE = (64, 96, 3)


def noisy(seed: int, replicates: int = 16, bias: np.ndarray | float = 1.0) -> np.ndarray:
    """Renders of a picture with mean 1 (times bias) and a relative sd of 1 per sample, 32 of them per pixel."""
    random = np.random.default_rng(seed)
    return random.gamma(32.0, 1 / 32.0, (replicates, *SHAPE)) * bias


def test_equal_means_pass() -> None:
    for seed in range(20):
        verdict = statistics.compare(
            statistics.of_replicates(noisy(2 * seed)), statistics.of_replicates(noisy(2 * seed + 1))
        )
        assert not verdict.differ, verdict


def test_p_values_are_uniform() -> None:
    """Under equal means the fraction of p below x is x: the variances are neither too large nor too small."""
    below = []
    for seed in range(30):
        a, b = statistics.of_replicates(noisy(2 * seed)), statistics.of_replicates(noisy(2 * seed + 1))
        below.append(statistics.probabilities(a.tiles, b.tiles, statistics.ROUNDING)[1].ravel())
    p = np.concatenate(below)
    for x in (0.01, 0.1, 0.5):
        assert abs((p < x).mean() - x) < 5.2 * np.sqrt(x * (1 - x) / p.size)


def test_one_percent_brighter_is_rejected() -> None:
    a, b = statistics.of_replicates(noisy(1)), statistics.of_replicates(noisy(2))
    assert statistics.compare(statistics.scaled(a, 1.01), b).differ
    assert statistics.compare(statistics.scaled(a, 0.99), b).differ


def test_one_tile_five_percent_brighter_is_rejected() -> None:
    bias = np.ones(SHAPE)
    bias[16:24, 40:48] = 1.15
    verdict = statistics.compare(statistics.of_replicates(noisy(1, bias=bias)), statistics.of_replicates(noisy(2)))
    assert verdict.differ
    assert "x 40.., y 16.." in verdict.where


def test_noiseless_pixels_must_agree_to_rounding() -> None:
    flat = np.full((4, *SHAPE), 0.5)
    assert not statistics.compare(statistics.of_replicates(flat), statistics.of_replicates(flat * (1 + 1e-7))).differ
    assert statistics.compare(statistics.of_replicates(flat), statistics.of_replicates(flat * (1 + 1e-4))).differ


def test_failure_leaves_image_reference_and_difference(tmp_path: Path) -> None:
    image = statistics.of_replicates(noisy(1))
    statistics.write_failure(tmp_path, image, statistics.scaled(image, 1.1))
    assert {p.name for p in tmp_path.iterdir()} == {
        f"{name}.{suffix}" for name in ("image", "reference", "difference") for suffix in ("exr", "png")
    }


def test_a_reference_without_errors_is_refused(tmp_path: Path) -> None:
    statistics.write_failure(tmp_path, statistics.of_replicates(noisy(1)), statistics.of_replicates(noisy(2)))
    with pytest.raises(ValueError, match="a reference holds"):
        statistics.read_reference(tmp_path / "image.exr")


def test_every_reference_is_rejected_by_every_other() -> None:
    references = {path.stem: statistics.read_reference(path) for path in REFERENCES}
    assert len(references) >= 7
    for a, b in itertools.combinations(references, 2):
        if references[a].pixels.shape == references[b].pixels.shape:
            assert statistics.compare(references[a], references[b]).differ, (a, b)
