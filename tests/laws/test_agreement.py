"""Laws that hold within noise: strategies, mirrored stages, sums of lights, instances against copies."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.images import statistics
from tests.laws import scenes
from tests.laws.scenes import SUITE, Array, Light, Material, Stage

COUNT = 12  # replicates: eleven degrees of freedom per variance
SIZE = {"width": 32, "height": 32}
every_scene = pytest.mark.parametrize("make", SUITE.values(), ids=SUITE.keys())


def assert_same_mean(a: Array, b: Array, what: str) -> None:
    verdict = statistics.compare(statistics.of_replicates(a), statistics.of_replicates(b))
    assert not verdict.differ, f"{what}: {verdict}"


def assert_told_apart(a: Array, b: Array) -> None:
    """The same comparison rejects the same image made 3 % brighter: it has the power to fail."""
    assert statistics.compare(statistics.of_replicates(1.03 * a), statistics.of_replicates(b)).differ


def without_point_like(stage: Stage) -> Stage:
    """Without lights that a BSDF sample can never hit."""
    kept = tuple(x for x in stage.lights if not (x.kind == "distant" and x.sizes["angle"] == 0))
    return replace(stage, lights=kept)


@every_scene
def test_mt13_strategies_agree(make: Callable[[], Stage]) -> None:
    """MT13: light sampling alone, BSDF sampling alone and both weighted have one mean."""
    stage = without_point_like(make())
    images = {
        strategy: scenes.replicates(stage, COUNT, seed=100 * k, spp=64, strategy=strategy, **SIZE)
        for k, strategy in enumerate(("mis", "light", "bsdf"))
    }
    for a, b in itertools.combinations(images, 2):
        assert_same_mean(images[a], images[b], f"{a} and {b}")


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_mt13_a_light_sample_is_an_edge(depth: int) -> None:
    """S03, MT13: at every depth limit the strategies agree; with one edge nothing but lights is seen."""
    stage = replace(scenes.room(), max_depth=depth)
    images = [
        scenes.replicates(stage, COUNT, seed=100 * k, spp=64, strategy=strategy, **SIZE)
        for k, strategy in enumerate(("mis", "light", "bsdf"))
    ]
    for a, b in itertools.combinations(images, 2):
        assert_same_mean(a, b, f"depth {depth}")
    assert (images[0][:, 16:].mean() == 0) == (depth == 1)


def test_mt13_power() -> None:
    a, b = (scenes.replicates(scenes.room(), COUNT, seed=s, spp=64, **SIZE) for s in (1, 100))
    assert_same_mean(a, b, "two seeds")
    assert_told_apart(a, b)


@every_scene
def test_mt3_mirrored_stage(make: Callable[[], Stage]) -> None:
    """MT3, G17: the stage under a scale of (-1, 1, 1) is the mirror image."""
    plain = scenes.replicates(make(), COUNT, seed=1, spp=32, **SIZE)
    mirrored = scenes.replicates(scenes.mirrored(make()), COUNT, seed=100, spp=32, **SIZE)
    assert_same_mean(plain, mirrored[:, :, ::-1], "mirrored")
    assert statistics.compare(statistics.of_replicates(plain), statistics.of_replicates(mirrored)).differ


@pytest.mark.parametrize("signs", [(-1, 1, 1), (-1, -1, 1), (1, 1, -1)])
@pytest.mark.parametrize("kind", ["rect", "disk"])
def test_g17_lights_under_negative_scales(signs: tuple[int, int, int], kind: str) -> None:
    """G17: a one-sided light shines along its transformed -Z, whatever the handedness of the transform."""
    place = scenes.chain(scenes.rotate("x", -60), scenes.translate(0.0, 1.5, 1.0))
    make = scenes.rect if kind == "rect" else scenes.disk

    def stage(before: Array) -> Stage:
        return Stage(
            scenes.Camera(scenes.look_at((0.0, 1.5, 4.5), (0.0, 0.5, 0.0))),
            (
                scenes.box(Material(), **scenes.at(scenes.scale(0.5), scenes.translate(0.0, 0.5, 0.0))),
                scenes.quad((-4, 0, 4), (8, 0, 0), (0, 0, -8), Material()),
            ),
            (make(scenes.chain(before, place), emission=(5.0, 4.0, 3.0), visible_to_camera=False),),
        )

    # Reversing local Z turns the light round: the same as rotating it by 180 degrees about X.
    same = scenes.rotate("x", 180) if signs[2] < 0 else np.eye(4)
    a = scenes.replicates(stage(scenes.scale(*signs)), COUNT, seed=1, spp=16, **SIZE)
    b = scenes.replicates(stage(same), COUNT, seed=100, spp=16, **SIZE)
    assert_same_mean(a, b, f"scale {signs}")
    assert (a.mean() > 1e-3) == (signs[2] > 0)


def turned(colour: scenes.Colour) -> scenes.Colour:
    return (colour[1], colour[2], colour[0])


@every_scene
def test_mt5_permuted_channels(make: Callable[[], Stage]) -> None:
    """MT5: red, green and blue are treated alike."""
    stage = make()
    meshes = tuple(
        replace(
            mesh,
            material=replace(
                mesh.material,
                diffuse_color=turned(mesh.material.diffuse_color),
                emissive_color=turned(mesh.material.emissive_color),
            ),
            colors=None if mesh.colors is None else np.ascontiguousarray(mesh.colors[:, [1, 2, 0]]),
        )
        for mesh in stage.meshes
    )
    lights = tuple(
        replace(
            light,
            emission=turned(light.emission),
            image=None if light.image is None else np.ascontiguousarray(light.image[..., [1, 2, 0]]),
        )
        for light in stage.lights
    )
    plain = scenes.replicates(stage, COUNT, seed=1, spp=32, **SIZE)
    permuted = scenes.replicates(replace(stage, meshes=meshes, lights=lights), COUNT, seed=100, spp=32, **SIZE)
    assert_same_mean(plain[..., [1, 2, 0]], permuted, "permuted")
    assert statistics.compare(statistics.of_replicates(plain), statistics.of_replicates(permuted)).differ


@every_scene
def test_mt6_light_adds_up(make: Callable[[], Stage]) -> None:
    """MT6: the image under all lights is the sum of the images under each."""
    stage = replace(
        make(),
        meshes=tuple(replace(m, material=replace(m.material, emissive_color=(0.0, 0.0, 0.0))) for m in make().meshes),
    )
    if len(stage.lights) == 1:
        extra = scenes.bulb(scenes.translate(0.25, 0.25, -0.25), 0.125, (1.0, 2.0, 4.0))
        stage = replace(stage, lights=(*stage.lights, extra))
    together = scenes.replicates(stage, COUNT, seed=1, spp=64, **SIZE)
    # Bodies stay where they are: a light that is left out is replaced by a black one that still blocks.
    alone = [
        scenes.replicates(only(stage, k), COUNT, seed=100 * (k + 1), spp=64, **SIZE) for k in range(len(stage.lights))
    ]
    total = np.sum(alone, axis=0)
    assert_same_mean(together, total, "sum")
    assert_told_apart(together, total)


def only(stage: Stage, index: int) -> Stage:
    """The stage with the other lights at 2^-40 of their power: as good as dark, and still there."""
    dimmed = tuple(
        light if k == index else replace(light, emission=scenes.times(light.emission, 2.0**-40))
        for k, light in enumerate(stage.lights)
    )
    return replace(stage, lights=dimmed)


def test_mt8_instances_are_copies() -> None:
    """MT8: K placements of one prototype and K meshes."""
    plain, copies = scenes.orchard(), scenes.flattened(scenes.orchard())
    assert len(copies.meshes) > len(plain.meshes) + 4
    aovs = ["color", "alpha", "depth", "normal"]
    # Without the half-transparent cards, where chance decides what a ray hits.
    solid = replace(plain, meshes=(plain.meshes[0], plain.meshes[2]))
    a, b = (scenes.run(s, spp=16, aovs=aovs, **SIZE) for s in (solid, scenes.flattened(solid)))
    # The same camera rays: what they hit may differ by rounding at silhouettes only.
    assert (np.abs(a.read("alpha") - b.read("alpha")) > 1e-3).mean() < 0.01
    one, other = a.read("depth"), b.read("depth")
    both = np.isfinite(one) & np.isfinite(other)
    assert np.median(np.abs(one[both] / other[both] - 1)) < 1e-6
    assert np.median(np.abs(a.read("normal") - b.read("normal"))) < 1e-5
    assert_same_mean(
        scenes.replicates(plain, COUNT, seed=1, spp=32, **SIZE),
        scenes.replicates(copies, COUNT, seed=100, spp=32, **SIZE),
        "instances and copies",
    )


def test_mt8_control_a_moved_instance_is_seen() -> None:
    plain = scenes.orchard()
    tree = plain.meshes[0]
    shifted = replace(tree, transforms=tree.transforms @ scenes.translate(0.0625, 0.0, 0.0))
    other = replace(plain, meshes=(shifted, *plain.meshes[1:]))
    a, b = scenes.replicates(plain, COUNT, spp=32, **SIZE), scenes.replicates(other, COUNT, seed=100, spp=32, **SIZE)
    assert statistics.compare(statistics.of_replicates(a), statistics.of_replicates(b)).differ


LIGHTS: dict[str, Light] = {
    "delta": scenes.sun(scenes.chain(scenes.rotate("x", -70)), 0.0, (2.0, 2.0, 2.0), normalize=True),
    "rect": scenes.rect(
        scenes.chain(scenes.rotate("x", -120), scenes.translate(0.0, 2.0, -2.0)), 2.0, 2.0, (2.0, 2.0, 2.0)
    ),
    "dome": scenes.dome((1.0, 1.0, 1.0), scenes.sky_image()),
}
SURFACES = {
    "mirror": Material((0.9, 0.8, 0.7), metallic=1.0, roughness=0.0),
    "almost_mirror": Material((0.9, 0.8, 0.7), metallic=1.0, roughness=0.01),
    "diffuse": Material((0.7, 0.6, 0.5)),
}


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("surface", SURFACES)
def test_l19_delta_and_density_never_mix(light: str, surface: str) -> None:
    """L19: MIS weights are one or zero wherever one of the two is a delta."""
    stage = Stage(
        scenes.Camera(scenes.look_at((0.0, 1.5, 4.5), (0.0, 0.25, 0.0))),
        (scenes.quad((-2, 0, 2), (4, 0, 0), (0, 0, -4), SURFACES[surface]),),
        (LIGHTS[light],),
    )
    # Light samples all but never meet a lobe a ten-thousandth of a radian wide; BSDF samples never meet a delta light.
    strategies = ["mis"]
    strategies += ["bsdf"] if light != "delta" else []
    strategies += ["light"] if surface != "almost_mirror" else []
    images = {
        s: scenes.replicates(stage, COUNT, seed=100 * k, spp=64, strategy=s, **SIZE) for k, s in enumerate(strategies)
    }
    for a, b in itertools.combinations(images, 2):
        assert_same_mean(images[a], images[b], f"{a} and {b}")
    floor = images["mis"][:, 20:].mean()
    if (light, surface) == ("delta", "mirror"):
        assert floor == 0
    elif light != "delta":
        assert floor > 0.01
