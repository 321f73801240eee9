"""Furnaces: scenes whose radiance has a closed form, so that lost or made energy shows as a number."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.laws import scenes
from tests.laws.scenes import Camera, Material, Points, Stage

SIZE = {"width": 24, "height": 24}
ROUNDING = 2e-6  # relative; single precision over a path of eight edges


def lone(material: Material, *, smooth: bool = False) -> Stage:
    """One ball under a white dome of radiance one."""
    ball = scenes.sphere(material, 48, 24, smooth=True) if smooth else scenes.icosphere(material, 2)
    return Stage(Camera(scenes.look_at((0.5, 1.0, 4.0), (0.0, 0.0, 0.0)), focal_length=60.0), (ball,), (scenes.dome(),))


def on_surface(stage: Stage, **options: Any) -> Points:
    """Colours (N, 3) of the pixels that the surface fills, known by their first-hit albedo."""
    aovs = ["color", "albedo", "normal"]
    render = scenes.run(stage, aovs=aovs, **SIZE, **options)
    filled = np.linalg.norm(render.read("normal"), axis=-1) > 0.9
    pixels: Points = render.read("color")[filled]
    assert len(pixels) > 100
    return pixels


def whole_pixels(stage: Stage, reflectance: float, **options: Any) -> Points:
    """Colours (N, 3) of the pixels in which every sample hits a Lambert surface of that reflectance."""
    render = scenes.run(stage, aovs=["color", "albedo"], **SIZE, **options)
    filled = np.abs(render.read("albedo")[..., 0] - reflectance) < 1e-6
    pixels: Points = render.read("color")[filled]
    assert len(pixels) > 100
    return pixels


@pytest.mark.parametrize("reflectance", [1.0, 0.5, 0.1])
def test_lambert_reflects_exactly_its_reflectance(reflectance: float) -> None:
    """By BSDF samples alone each path of a convex body carries the reflectance: no noise at all."""
    pixels = whole_pixels(lone(Material((reflectance,) * 3)), reflectance, strategy="bsdf")
    assert np.abs(pixels / reflectance - 1).max() < ROUNDING


def test_lambert_control_a_thousandth_is_seen() -> None:
    pixels = whole_pixels(lone(Material((0.999,) * 3)), 0.999, strategy="bsdf")
    assert np.abs(pixels - 1).max() > 100 * ROUNDING


@pytest.mark.parametrize("strategy", ["mis", "light"])
def test_white_lambert_by_light_samples(strategy: str) -> None:
    count = 12
    means = [
        whole_pixels(lone(Material(scenes.WHITE)), 1.0, strategy=strategy, spp=64, seed=s).mean() for s in range(count)
    ]
    assert abs(np.mean(means) - 1) < 5.2 * np.std(means, ddof=1) / np.sqrt(count) + ROUNDING


@pytest.mark.parametrize("roughness", [0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 1.0])
def test_b03_white_metal(roughness: float) -> None:
    """B03: energy compensation returns what single scattering loses, 69 % at roughness 1, to half a per cent."""
    pixels = on_surface(
        lone(Material(scenes.WHITE, metallic=1.0, roughness=roughness), smooth=True), strategy="bsdf", spp=256
    )
    assert abs(pixels.mean() - 1) < 5e-3


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("coat", [0.0, 1.0])
def test_b04_white_plastic(roughness: float, coat: float) -> None:
    """B04: a dielectric layer and a coat over white diffuse take from below what they reflect themselves."""
    material = Material(scenes.WHITE, roughness=roughness, ior=1.5, clearcoat=coat, clearcoat_roughness=0.3)
    pixels = on_surface(lone(material, smooth=True), strategy="bsdf", spp=256)
    assert abs(pixels.mean() - 1) < 5e-3


@pytest.mark.parametrize("colour", [(0.2, 0.5, 0.9)])
@pytest.mark.parametrize("roughness", [0.3, 1.0])
def test_b03_coloured_metal_gains_nothing(colour: scenes.Colour, roughness: float) -> None:
    pixels = on_surface(
        lone(Material(colour, metallic=1.0, roughness=roughness), smooth=True), strategy="bsdf", spp=256
    )
    mean = pixels.mean(0)
    assert (mean < 1.0).all()
    assert (mean > 0.5 * np.array(colour)).all()


def glowing_room(reflectance: float, depth: int) -> Stage:
    """A closed box whose walls emit 0.25 and reflect."""
    wall = Material((reflectance,) * 3, emissive_color=(0.25,) * 3)
    camera = Camera(scenes.look_at((0.25, 0.125, 0.5), (-0.5, 0.25, -1.0)), focal_length=20.0)
    return Stage(camera, (scenes.box(wall, inwards=True),), (), max_depth=depth)


@pytest.mark.parametrize("depth", [1, 2, 3, 5])
def test_s03_closed_room_is_a_geometric_series(depth: int) -> None:
    """S03: after so many edges exactly so much radiance is there; what longer paths carry is known, not lost unseen."""
    pixels = scenes.image(glowing_room(0.5, depth), strategy="bsdf", spp=4, **SIZE)
    expected = 0.25 * (1 - 0.5**depth) / 0.5
    count = pixels.size / 3 * 4
    # Up to three edges no path is played at roulette; beyond, the survivors' weights scatter.
    noise = 0.0 if depth <= 3 else 5.2 * pixels.std() / np.sqrt(count / 4)
    assert abs(pixels.mean() - expected) < ROUNDING * expected + noise


def test_s03_deep_room_reaches_its_limit() -> None:
    pixels = np.stack([scenes.image(glowing_room(0.8, 64), spp=16, seed=s, **SIZE) for s in range(8)])
    means = pixels.mean((1, 2, 3))
    assert abs(means.mean() - 1.25) < 5.2 * means.std(ddof=1) / np.sqrt(8) + 1e-5


def test_s03_control_depth_is_a_bias_that_shows() -> None:
    shallow = scenes.image(glowing_room(0.8, 8), spp=16, **SIZE)
    assert shallow.mean() < 1.25 * (1 - 0.8**8) * 1.02


def test_dome_seen_directly_is_itself() -> None:
    pixels = scenes.image(replace(lone(Material()), meshes=()), **SIZE)
    assert (pixels == np.float32(1.0)).all()
