"""Laws that hold bit for bit: scale, translation, light level, threads, tiles, chunks, unused things, forced effects.

Each exact comparison stands beside one that must fail, so that the comparison itself is shown to see.
"""

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.laws import scenes
from tests.laws.scenes import SUITE, Points, Stage

AOVS = ["color", "alpha", "depth", "normal", "albedo", "position", "error", "sample_count"]
SMALL: dict[str, Any] = {"width": 32, "height": 24}
every_scene = pytest.mark.parametrize("make", SUITE.values(), ids=SUITE.keys())


def differing(a: Points, b: Points) -> int:
    """Number of values whose bits differ."""
    assert a.shape == b.shape
    return int((np.ascontiguousarray(a).view(np.uint32) != np.ascontiguousarray(b).view(np.uint32)).sum())


def assert_same_bits(a: Points, b: Points, what: str) -> None:
    count = differing(a, b)
    if count:
        where = tuple(int(k) for k in np.argwhere(a.view(np.uint32) != b.view(np.uint32))[0])
        pytest.fail(f"{what}: {count} of {a.size} values differ, first at {where}: {a[where]!r} and {b[where]!r}")


@every_scene
@pytest.mark.parametrize("exponent", [-20, -10, 10, 20])
@pytest.mark.parametrize("how", [scenes.enlarged, scenes.authored_larger], ids=["transform", "points"])
def test_mt1_scale_by_a_power_of_two(
    make: Callable[[], Stage], exponent: int, how: Callable[[Stage, float], Stage]
) -> None:
    """MT1, G01: no length constant anywhere."""
    options = SMALL | {"aovs": ["color", "alpha", "depth", "normal"]}
    plain, large = scenes.run(make(), **options), scenes.run(how(make(), 2.0**exponent), **options)
    for aov in ("color", "alpha", "normal"):
        assert_same_bits(plain.read(aov), large.read(aov), f"{aov} at 2^{exponent}")
    assert_same_bits(plain.read("depth") * np.float32(2.0**exponent), large.read("depth"), "depth")


def test_mt1_control_a_scale_that_is_no_power_of_two_moves_bits() -> None:
    a, b = scenes.image(scenes.room(), **SMALL), scenes.image(scenes.enlarged(scenes.room(), 1.1), **SMALL)
    assert differing(a, b) > 0
    assert np.median(np.abs(a - b)) < 1e-3


@every_scene
def test_mt2_far_from_the_origin(make: Callable[[], Stage]) -> None:
    """MT2, G02: the scene 2^20 units away along every axis."""
    options = SMALL | {"aovs": ["color", "alpha", "depth", "normal"]}
    far = scenes.moved(make(), scenes.translate(2.0**20, 2.0**20, 2.0**20))
    here, there = scenes.run(make(), **options), scenes.run(far, **options)
    for aov in ("color", "alpha", "depth", "normal"):
        assert_same_bits(here.read(aov), there.read(aov), aov)


def test_mt2_control_points_rounded_at_the_distance_move_bits() -> None:
    """The mutant that bakes vertices into world space in single precision."""
    stage, far = scenes.room(), 2.0**20

    def baked(mesh: scenes.Mesh) -> scenes.Mesh:
        world = mesh.points.astype(np.float64) @ mesh.transforms[0, :3, :3] + mesh.transforms[0, 3, :3]
        points = ((world + far).astype(np.float32).astype(np.float64) - far).astype(np.float32)
        return replace(mesh, points=points, transforms=np.eye(4)[None])

    mutant = replace(stage, meshes=tuple(baked(m) for m in stage.meshes))
    assert differing(scenes.image(stage, **SMALL), scenes.image(mutant, **SMALL)) > 0


@every_scene
@pytest.mark.parametrize("exponent", [-60, -20, 20, 60])
def test_mt4_light_times_a_power_of_two(make: Callable[[], Stage], exponent: int) -> None:
    """MT4, L16."""
    plain, bright = scenes.image(make(), **SMALL), scenes.image(scenes.brighter(make(), 2.0**exponent), **SMALL)
    assert_same_bits(plain * np.float32(2.0**exponent), bright, f"color at 2^{exponent}")


@pytest.mark.parametrize("exponent", [-20, 20])
def test_mt4_exposure_times_a_power_of_two(exponent: int) -> None:
    """MT4: the camera's exposure is as good as more light."""
    stage = scenes.room()
    exposed = replace(stage, camera=replace(stage.camera, exposure_scale=2.0**exponent))
    bright = scenes.image(scenes.brighter(stage, 2.0**exponent), **SMALL)
    assert_same_bits(bright, scenes.image(exposed, **SMALL), f"color at 2^{exponent}")


def test_mt4_control_an_offset_is_seen() -> None:
    plain, bright = scenes.image(scenes.room(), **SMALL), scenes.image(scenes.brighter(scenes.room(), 4.0), **SMALL)
    assert differing((plain + np.float32(1e-6)) * 4, bright) > 0


@every_scene
def test_mt9_threads_tiles_and_their_order(make: Callable[[], Stage]) -> None:
    """MT9: 130x70 pixels are six tiles, three of them narrow."""
    options: dict[str, Any] = {"width": 130, "height": 70, "aovs": AOVS}

    def rendered(threads: int, ranges: list[tuple[int, int]]) -> dict[str, Points]:
        renderer = scenes.renderer(make(), threads=threads, **options)
        assert renderer.tiles == 6
        for begin, end in ranges:
            assert renderer.render(0, 4, begin, end)
        return {aov: renderer.read(aov) for aov in AOVS}

    expected = rendered(1, [(0, 6)])
    for threads, ranges in (
        (2, [(0, 6)]),
        (7, [(0, 6)]),
        (2, [(k, k + 1) for k in reversed(range(6))]),
        (3, [(4, 6), (0, 1), (1, 4)]),
    ):
        for aov, pixels in rendered(threads, ranges).items():
            assert_same_bits(expected[aov], pixels, f"{aov}, {threads} threads, tiles {ranges}")


def crowd(instanced: bool) -> Stage:
    """Two hundred thousand triangles and more when flattened: the renderer sorts its rays."""
    ball = scenes.icosphere(scenes.Material((0.6, 0.4, 0.3)), 5)
    places = [
        scenes.chain(
            scenes.scale(0.25), scenes.rotate("y", 11.0 * k), scenes.translate(k % 4 - 1.5, 0.25, k // 4 - 1.5)
        )
        for k in range(12)
    ]
    floor = scenes.quad((-4, 0, 4), (8, 0, 0), (0, 0, -8), scenes.Material((0.4, 0.4, 0.4)))
    stage = replace(scenes.orchard(), meshes=(replace(ball, transforms=np.stack(places)), floor))
    return stage if instanced else scenes.flattened(stage)


def test_mt9_mt10_large_scenes_with_sorted_rays() -> None:
    """The same laws where batches are large and rays are sorted; and sorting does not change what they find."""
    options = {"width": 130, "height": 70}
    lean = scenes.renderer(crowd(instanced=False), **options)
    assert lean.pipeline.count("sort") == 2  # of paths and of shadow rays
    assert lean.render(0, 8, 0, lean.tiles)
    for threads, order in ((1, [5, 3, 1, 0, 2, 4]), (3, [0, 1, 2, 3, 4, 5])):
        other = scenes.renderer(crowd(instanced=False), threads=threads, **options)
        for tile in order:
            assert other.render(3, 8, tile, tile + 1)
        assert other.render(0, 3, 0, other.tiles)
        assert_same_bits(lean.read("color"), other.read("color"), f"{threads} threads, tiles {order}")
    unsorted = scenes.renderer(crowd(instanced=True), **options)
    assert unsorted.pipeline.count("sort") == 1  # of paths by octant
    assert unsorted.render(0, 8, 0, unsorted.tiles)
    difference = np.abs(unsorted.read("color") - lean.read("color"))
    assert np.median(difference) < 1e-5


@pytest.mark.parametrize("level", ["v2", "v3", "v4"])
def test_mt9_instruction_sets_agree(level: str) -> None:
    """MT9: every build of the core that this machine runs makes the picture of the others, up to rounding."""
    names = ("room", "gallery", "sky")
    program = (
        "import sys, numpy, footlight_core\nfrom tests.laws import scenes\n"
        "assert footlight_core.instruction_set.endswith(sys.argv[1])\n"
        "numpy.save(sys.argv[2], numpy.stack([scenes.image(scenes.SUITE[n](), spp=64) for n in sys.argv[3:]]))"
    )
    if importlib.util.find_spec(f"footlight_core._core_{level}") is None:
        pytest.skip(f"the core is not built for {level}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "images.npy"
        environment = os.environ | {"FOOTLIGHT_INSTRUCTION_SET": level, "PYTHONPATH": os.pathsep.join([".", *sys.path])}
        command = [sys.executable, "-c", program, level, str(path), *names]
        result = subprocess.run(command, env=environment, check=False, capture_output=True, text=True)
        if "no build of footlight_core runs" in result.stderr:
            pytest.skip(f"this processor does not run {level}")
        assert result.returncode == 0, result.stderr
        images = np.load(path)
    here = np.stack([scenes.image(SUITE[n](), spp=64) for n in names])
    assert np.median(np.abs(images - here) / (here + 1e-3)) < 1e-5
    assert np.abs(images.mean((1, 2, 3)) / here.mean((1, 2, 3)) - 1).max() < 0.01


def test_mt9_control_another_seed_moves_bits() -> None:
    a, b = (scenes.image(scenes.room(), seed=seed, **SMALL) for seed in (0, 1))
    assert differing(a, b) > 0.5 * a.size


@every_scene
@pytest.mark.parametrize("split", [1, 8, 15])
def test_mt10_chunks_of_samples(make: Callable[[], Stage], split: int) -> None:
    """MT10: one film, two chunks; and two films, merged either way."""
    options = SMALL | {"aovs": AOVS}
    whole = scenes.run(make(), spp=16, **options)

    def part(begin: int, end: int) -> bytes:
        renderer = scenes.renderer(make(), **options)
        assert renderer.render(begin, end, 0, renderer.tiles)
        state: bytes = renderer.state()
        return state

    resumed = scenes.renderer(make(), **options)
    assert resumed.render(split, 16, 0, resumed.tiles)
    assert resumed.render(0, split, 0, resumed.tiles)
    first, second = part(0, split), part(split, 16)
    forward, backward = scenes.renderer(make(), **options), scenes.renderer(make(), **options)
    for renderer, states in ((forward, (first, second)), (backward, (second, first))):
        for state in states:
            renderer.merge(state)
    for aov in AOVS:
        for renderer, what in ((resumed, "resumed"), (forward, "merged"), (backward, "merged in reverse")):
            assert_same_bits(whole.read(aov), renderer.read(aov), f"{aov}, {what}")


def test_mt10_control_a_missing_sample_moves_bits() -> None:
    whole, most = scenes.image(scenes.room(), spp=16, **SMALL), scenes.image(scenes.room(), spp=15, **SMALL)
    assert differing(whole, most) > 0


def test_mt10_five_chunks_in_any_order() -> None:
    bounds = [0, 1, 5, 6, 11, 16]
    chunks = list(pairwise(bounds))
    whole = scenes.image(scenes.gallery(), spp=16, **SMALL)
    for order in ([4, 2, 0, 1, 3], [3, 4, 1, 0, 2]):
        renderer = scenes.renderer(scenes.gallery(), **SMALL)
        for k in order:
            assert renderer.render(*chunks[k], 0, renderer.tiles)
        assert_same_bits(whole, renderer.read("color"), f"chunks in order {order}")


@every_scene
def test_mt11_forced_effects_change_nothing(make: Callable[[], Stage]) -> None:
    """MT11: the lean pipeline and the full one."""
    options = SMALL | {"aovs": AOVS}
    lean, full = scenes.run(make(), **options), scenes.run(make(), force_effects=["all"], **options)
    assert {e["name"] for e in full.effects if e["active"]} >= {e["name"] for e in lean.effects if e["active"]}
    for aov in AOVS:
        assert_same_bits(lean.read(aov), full.read(aov), aov)


@every_scene
def test_mt11_each_effect_alone(make: Callable[[], Stage]) -> None:
    lean = scenes.run(make(), spp=4, **SMALL)
    for effect in lean.effects:
        if not effect["active"]:
            forced = scenes.image(make(), spp=4, force_effects=[effect["name"]], **SMALL)
            assert_same_bits(lean.read("color"), forced, effect["name"])


def test_mt11_some_effect_is_lean_somewhere_and_forced_when_asked() -> None:
    """Otherwise the law would compare a pipeline with itself."""
    lean = scenes.renderer(scenes.room(), **SMALL)
    full = scenes.renderer(scenes.room(), force_effects=["all"], **SMALL)
    assert sum(e["active"] for e in full.effects) > sum(e["active"] for e in lean.effects) + 3
    assert len(full.pipeline) > len(lean.pipeline)


def test_mt11_control_an_unknown_effect_is_refused() -> None:
    with pytest.raises(ValueError, match="no_such_effect"):
        scenes.renderer(scenes.room(), force_effects=["no_such_effect"], **SMALL)


@every_scene
def test_mt12_unused_things_change_nothing(make: Callable[[], Stage]) -> None:
    """MT12: a mesh placed nowhere with an effectful material, black lights, more AOVs."""
    stage = make()
    unused = scenes.sphere(
        scenes.Material(metallic=1.0, clearcoat=1.0, opacity=0.5, emissive_color=(5.0, 5.0, 5.0)), smooth=True
    )
    black = (
        scenes.rect(scenes.translate(0.0, 1.0, 0.0), emission=(0.0, 0.0, 0.0)),
        scenes.bulb(scenes.translate(0.0, 1.0, 0.0), 0.0, (1.0, 1.0, 1.0)),
    )
    plain = scenes.run(stage, **SMALL, aovs=["color"])
    burdened = scenes.run(replace(stage, unused=(unused,), lights=(*stage.lights, *black)), **SMALL, aovs=AOVS)
    assert_same_bits(plain.read("color"), burdened.read("color"), "color")


def test_mt12_control_the_same_mesh_placed_is_seen() -> None:
    stage = scenes.gallery()
    ball = scenes.sphere(scenes.Material(), **scenes.at(scenes.scale(0.25), scenes.translate(0.0, 1.0, 1.0)))
    used = replace(stage, meshes=(*stage.meshes, ball))
    assert differing(scenes.image(stage, **SMALL), scenes.image(used, **SMALL)) > 0
