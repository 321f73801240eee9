"""Laws of emissive meshes: their faces are lights, and rays and light samples agree on them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.laws import scenes
from tests.laws.scenes import Light, Material, Mesh, Stage
from tests.laws.test_agreement import COUNT, SIZE, assert_same_mean, assert_told_apart

GLOW = (6.0, 5.0, 4.0)
FLOOR = scenes.quad((-2, 0, 2), (4, 0, 0), (0, 0, -4), Material((0.7, 0.6, 0.5)))
CAMERA = scenes.Camera(scenes.look_at((0.0, 0.75, 3.0), (0.0, 0.25, 0.0)))


def panel(**more: object) -> Mesh:
    """A square of side 0.5 that faces down, 1 above the floor."""
    glow = Material((0.0, 0.0, 0.0), emissive_color=GLOW, **more)  # type: ignore[arg-type]
    return scenes.quad((-0.25, 1, -0.25), (0.5, 0, 0), (0, 0, 0.5), glow)


def lit_by(*meshes: Mesh, lights: tuple[Light, ...] = ()) -> Stage:
    return Stage(CAMERA, (FLOOR, *meshes), lights, max_depth=3)


@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_mt13_strategies_agree_on_emissive_faces(opacity: float) -> None:
    """MT13: a partly opaque panel is no light and found by chance; the mean is the same whichever way."""
    stage = lit_by(panel(opacity=opacity))
    images = {
        strategy: scenes.replicates(stage, COUNT, seed=100 * k, spp=128, strategy=strategy, **SIZE)
        for k, strategy in enumerate(("mis", "light", "bsdf"))
    }
    for a, b in itertools.combinations(images, 2):
        assert_same_mean(images[a], images[b], f"{a} and {b}")
    if opacity == 1.0:  # light found by chance is too noisy to tell 3 %
        assert_told_apart(images["mis"], images["light"])


def test_emissive_square_is_a_rect_light() -> None:
    """A panel that emits from both sides lights what is below it as a rect light of the same radiance does."""
    down = scenes.chain(scenes.rotate("x", -90), scenes.translate(0.0, 1.0, 0.0))
    by_mesh = scenes.replicates(lit_by(panel()), COUNT, seed=1, spp=64, **SIZE)
    by_light = scenes.replicates(lit_by(lights=(scenes.rect(down, 0.5, 0.5, GLOW),)), COUNT, seed=100, spp=64, **SIZE)
    assert_same_mean(by_mesh, by_light, "panel and rect light")


def test_mt8_instances_of_an_emissive_mesh() -> None:
    """MT8: two instances, which are found by chance, light the floor as two baked copies, which are sampled."""
    places = np.stack([scenes.translate(-0.75, 0.0, 0.0), scenes.translate(0.75, 0.0, 0.0)])
    instanced = lit_by(replace(panel(), transforms=places))
    a = scenes.replicates(instanced, COUNT, seed=1, spp=256, **SIZE)
    b = scenes.replicates(scenes.flattened(instanced), COUNT, seed=100, spp=64, **SIZE)
    assert_same_mean(a, b, "instances and copies")


def test_sampling_emissive_faces_pays() -> None:
    """The same panel found by chance alone is many times noisier."""
    spread = {
        strategy: scenes.replicates(lit_by(panel()), COUNT, spp=32, strategy=strategy, **SIZE).var(axis=0).mean()
        for strategy in ("mis", "bsdf")
    }
    assert spread["mis"] < 0.2 * spread["bsdf"]
