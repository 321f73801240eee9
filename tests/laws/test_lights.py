"""Laws about light: closed forms at any size and distance, domes at their poles, lights of no or negative power."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.laws import scenes
from tests.laws.scenes import WHITE, Array, Camera, Light, Material, Stage

COUNT = 8


def plate(*lights: Light, reflectance: float = 1.0) -> Stage:
    """A plate on y = 0 seen at its origin from the side, so narrowly that it is one point."""
    camera = Camera(scenes.look_at((3.0, 3.0, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e5)
    floor = scenes.quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), Material((reflectance,) * 3))
    return Stage(camera, (floor,), lights, max_depth=2)


def probe(stage: Stage, spp: int = 256, **options: Any) -> tuple[float, float]:
    """Mean radiance of the view and its standard error."""
    means = scenes.replicates(stage, COUNT, width=8, height=8, spp=spp, **options).mean((1, 2, 3))
    return float(np.mean(means)), float(np.std(means, ddof=1) / math.sqrt(COUNT))


def assert_radiance(stage: Stage, expected: float, tolerance: float, **options: Any) -> None:
    mean, error = probe(stage, **options)
    # Student's t of seven degrees of freedom at two-sided 2e-4.
    assert abs(mean - expected) < tolerance * abs(expected) + 7.1 * error, f"{mean} +- {error}, expected {expected}"
    assert error < 0.02 * abs(expected) + 1e-12, f"{mean} +- {error}: too noisy to prove anything"


# --- L01: sphere lights of any size ---


@pytest.mark.parametrize("strategy", ["mis", "light"])
@pytest.mark.parametrize("ratio", [0.5, 0.1, 1e-2, 1e-3, 3e-4, 1e-4, 1e-5, 1e-7])
def test_l01_sphere_light_at_any_distance(ratio: float, strategy: str) -> None:
    """L01: E = pi L r^2/h^2. By 1 - cos in single precision it is 7 % off at 1e-3 and black at 1e-4."""
    lamp = scenes.bulb(scenes.translate(0.0, 1.0, 0.0), ratio, scenes.times(WHITE, 1 / (math.pi * ratio**2)))
    assert_radiance(plate(lamp), 1 / math.pi, 2e-3, strategy=strategy)


def test_l01_control_the_naive_cone_is_out_of_tolerance() -> None:
    for ratio, error in ((1e-3, 0.05), (3e-4, 0.2), (1e-5, 0.99)):
        sine2 = np.float32(ratio) ** 2
        naive = 2 * math.pi * float(np.float32(1) - np.sqrt(np.float32(1) - sine2))
        assert abs(naive / (math.pi * ratio**2) - 1) > error


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
@pytest.mark.parametrize(("radius", "height"), [(0.5, 1.0), (0.5, 0.25), (0.25, 0.5)])
def test_disk_light_on_axis(radius: float, height: float, strategy: str) -> None:
    """E = pi L r^2 / (r^2 + h^2), from a disk as wide as the sky to one of half the height."""
    lamp = scenes.disk(scenes.chain(scenes.rotate("x", -90), scenes.translate(0.0, height, 0.0)), radius)
    camera = Camera(scenes.look_at((3.0, 0.375, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e6)
    stage = plate(lamp)
    stage = Stage(camera if height < 0.5 else stage.camera, stage.meshes, stage.lights, max_depth=2)
    assert_radiance(stage, radius**2 / (radius**2 + height**2), 2e-3, strategy=strategy, spp=1024)


@pytest.mark.parametrize("strategy", ["mis", "light"])
@pytest.mark.parametrize(
    ("stretch", "normalize"), [((1.0, 3.0, 1.0), False), ((1.0, 3.0, 1.0), True), ((2.0, 2.0, 2.0), True)]
)
def test_l23_disk_light_under_scale(stretch: tuple[float, float, float], normalize: bool, strategy: str) -> None:
    """L23: an ellipse of radii 0.25 a and 0.25 b, its irradiance by quadrature over its area."""
    place = scenes.chain(scenes.scale(*stretch), scenes.rotate("x", -90), scenes.translate(0.0, 1.0, 0.0))
    a, b = 0.25 * stretch[0], 0.25 * stretch[1]
    n = 400
    r, phi = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n * 2 * math.pi, indexing="ij")
    distance2 = 1 + (a * r * np.cos(phi)) ** 2 + (b * r * np.sin(phi)) ** 2
    irradiance = (a * b * r / distance2**2).mean() * 2 * math.pi
    expected = irradiance / math.pi / (math.pi * a * b if normalize else 1.0)
    assert_radiance(plate(scenes.disk(place, 0.25, normalize=normalize)), expected, 2e-3, strategy=strategy)


@pytest.mark.parametrize("gap", [1e-1, 1e-3, 1e-5])
@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_l02_sphere_light_close_to_the_surface(gap: float, strategy: str) -> None:
    """L02: a ball that all but touches the plate fills nearly the whole sky: E = pi L (r/h)^2."""
    lamp = scenes.bulb(scenes.translate(0.0, 1.0, 0.0), 1.0 - gap)
    low = Camera(
        scenes.look_at((4e-3, 4e-3 * gap, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e7, clipping_range=(1e-9, 1e9)
    )
    bare = plate(lamp)
    stage = Stage(low, bare.meshes, bare.lights, max_depth=2)
    assert_radiance(stage, (1.0 - gap) ** 2, 5e-3, strategy=strategy)


CLOSE = {
    "rect": lambda gap: scenes.rect(scenes.chain(scenes.rotate("x", -90), scenes.translate(0.1, gap, 0.05))),
    "disk": lambda gap: scenes.disk(scenes.chain(scenes.rotate("x", -90), scenes.translate(0.1, gap, 0.05))),
    "bulb": lambda gap: scenes.bulb(scenes.translate(0.0, 1.0, 0.0), 1.0 - gap),
    "tube": lambda gap: scenes.tube(scenes.translate(0.1, 1.0, 0.0), 1.0 - gap, 2.0),
}


@pytest.mark.parametrize("gap", [1e-1, 1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("shape", CLOSE)
def test_l02_strategies_agree_close_to_any_light(shape: str, gap: float) -> None:
    """L02: a light that hangs a ten-thousandth of its size above a plate, turned askew, does not shadow itself."""
    bare = plate(CLOSE[shape](gap))
    low = Camera(
        scenes.look_at((4e-3, 4e-3 * gap, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e7, clipping_range=(1e-9, 1e9)
    )
    askew = scenes.chain(scenes.rotate("x", 33), scenes.rotate("y", 21), scenes.rotate("z", 50))
    stage = scenes.moved(Stage(low, bare.meshes, bare.lights, max_depth=2), askew)
    found, error = probe(stage, strategy="bsdf")
    for strategy in ("mis", "light"):
        mean, other = probe(stage, strategy=strategy)
        # By area, a disk so close is all but never sampled where it matters: there only mis is asked.
        if strategy == "mis" or other < 0.01 * mean:
            assert abs(mean - found) < 7.1 * math.hypot(error, other) + 1e-4, (strategy, mean, found)


@pytest.mark.parametrize("depth", [1e-7, 1e-3, 0.5, 1.0])
def test_l02_inside_a_sphere_light_it_is_dark(depth: float) -> None:
    """L02: light is emitted outward; inside there is none, and nothing that is not a number."""
    lamp = scenes.bulb(scenes.translate(0.0, 1.0 - depth, 0.0), 1.0)
    inside = Camera(scenes.look_at((2e-4, 1e-4, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e5, clipping_range=(1e-9, 1e9))
    bare = plate(lamp)
    for strategy in ("mis", "light", "bsdf"):
        pixels = scenes.image(Stage(inside, bare.meshes, bare.lights, max_depth=2), strategy=strategy, spp=64)
        assert np.isfinite(pixels).all()
        if depth > 1e-3:
            assert (pixels == 0).all()


def corner_irradiance(a: float, b: float) -> float:
    """Irradiance under a rectangle of radiance one at height 1, one corner overhead: the closed form, with signs."""
    x, y = a / math.hypot(1, a), b / math.hypot(1, b)
    return (x * math.atan(b / math.hypot(1, a)) + y * math.atan(a / math.hypot(1, b))) / 2


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
@pytest.mark.parametrize(
    ("x", "z", "width", "height"), [(0.0, 0.0, 1.0, 0.5), (-1.0, 0.75, 2.0, 0.5), (-6.0, 0.0, 4.0, 8.0)]
)
def test_l03_rect_light_anywhere(x: float, z: float, width: float, height: float, strategy: str) -> None:
    """L03: irradiance of a parallel rectangle, from overhead to grazing."""
    down = scenes.chain(scenes.rotate("x", -90), scenes.translate(x, 1.0, z))
    low, high, near, far = x - width / 2, x + width / 2, z - height / 2, z + height / 2
    expected = (
        corner_irradiance(high, far)
        - corner_irradiance(low, far)
        - corner_irradiance(high, near)
        + corner_irradiance(low, near)
    ) / math.pi
    assert_radiance(plate(scenes.rect(down, width, height)), expected, 2e-3, strategy=strategy, spp=1024)


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
@pytest.mark.parametrize("instanced", [False, True])
def test_glowing_mesh_is_a_light_of_its_shape(instanced: bool, strategy: str) -> None:
    """A glowing quad sends what a rect light of the same radiance sends, found by light samples or by chance."""
    glow = Material((0.0, 0.0, 0.0), emissive_color=(2.0, 2.0, 2.0))
    panel = scenes.quad((-0.5, 0, -0.25), (1, 0, 0), (0, 0, 0.5), glow)
    places = [scenes.translate(0.0, 1.0, 0.0)] + [scenes.translate(0.0, -500.0, 0.0)] * instanced
    bare = plate()
    stage = Stage(bare.camera, (*bare.meshes, replace(panel, transforms=np.stack(places))), (), max_depth=2)
    assert_radiance(stage, 8 * corner_irradiance(0.5, 0.25) / math.pi, 2e-3, strategy=strategy, spp=4096)


def tube_irradiance(radius: float, length: float, height: float) -> float:
    """Irradiance at the origin under a tube along X at that height of its axis, by quadrature over its near side."""
    n = 600
    x, phi = np.meshgrid(
        ((np.arange(n) + 0.5) / n - 0.5) * length, ((np.arange(n) + 0.5) / n) * 2 * math.pi, indexing="ij"
    )
    y, z = height + radius * np.cos(phi), radius * np.sin(phi)
    distance = np.sqrt(x * x + y * y + z * z)
    out = -(np.cos(phi) * y + np.sin(phi) * z) / distance
    return float((np.maximum(out, 0) * y / distance**3).mean() * 2 * math.pi * radius * length)


@pytest.mark.parametrize("strategy", ["mis", "light"])
@pytest.mark.parametrize(("radius", "length"), [(0.1, 1.0), (0.5, 0.5), (1e-4, 20.0)])
def test_l05_cylinder_light(radius: float, length: float, strategy: str) -> None:
    """L05: a tube along X; its ends are open and dark."""
    lamp = scenes.tube(scenes.translate(0.0, 1.0, 0.0), radius, length)
    side = Camera(scenes.look_at((0.0, 0.75, 3.0), (0.0, 0.0, 0.0)), focal_length=3.6e5)
    stage = plate(lamp)
    stage = Stage(side, stage.meshes, stage.lights, max_depth=2)
    assert_radiance(stage, tube_irradiance(radius, length, 1.0) / math.pi, 2e-3, strategy=strategy, spp=1024)


SHAPES = {
    "rect": scenes.rect(scenes.chain(scenes.rotate("x", -90), scenes.translate(0.0, 1.0, 0.0)), 0.5, 0.5),
    "disk": scenes.disk(scenes.chain(scenes.rotate("x", -90), scenes.translate(0.0, 1.0, 0.0)), 0.25),
    "bulb": scenes.bulb(scenes.translate(0.0, 1.25, 0.0), 0.25),
    "tube": scenes.tube(scenes.translate(0.0, 1.25, 0.0), 0.25, 1.0),
}


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 2e-5])
@pytest.mark.parametrize("shape", SHAPES)
def test_g04_a_cover_close_to_the_light_blocks_it(shape: str, gap: float) -> None:
    """G04: shadow rays end so close before the light that nothing fits between."""
    cover = scenes.quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), Material((0.0, 0.0, 0.0)))
    lid = scenes.Mesh(cover.points + np.array([0, 1 - gap, 0], np.float32), cover.triangles, cover.material)
    low = Camera(scenes.look_at((1.5, 0.5, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e5)
    bare = plate(SHAPES[shape])
    covered = Stage(low, (*bare.meshes, lid), bare.lights, max_depth=2)
    for strategy in ("mis", "light", "bsdf"):
        assert (scenes.image(covered, strategy=strategy, spp=64) == 0.0).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_lights_do_not_shadow_themselves_from_afar(shape: str) -> None:
    """The same plate from 4 and from 4000 units away; there its points are known to some thousandths."""
    near = plate(SHAPES[shape])
    far = Camera(scenes.look_at((3000.0, 3000.0, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e8)
    expected, error = probe(near, strategy="light")
    distant, other = probe(Stage(far, near.meshes, near.lights, max_depth=2), strategy="light")
    assert abs(distant / expected - 1) < 0.02 + 7.1 * math.hypot(error, other) / expected


def test_invisible_lights_shine_and_are_not_seen() -> None:
    for shape in SHAPES.values():
        hidden = Light(shape.kind, shape.transform, shape.emission, sizes=shape.sizes, visible_to_camera=False)
        assert np.array_equal(scenes.image(plate(shape)), scenes.image(plate(hidden)))
        camera = Camera(scenes.look_at((0.0, 0.0, 0.0), (1e-3, 1.0, 0.0)), focal_length=360.0)
        assert scenes.image(Stage(camera, (), (shape,))).min() == 1.0
        assert scenes.image(Stage(camera, (), (hidden,))).max() == 0.0


def test_s14_half_transparent_cards_multiply() -> None:
    """S14, L20: eight cards of opacity 1/2 let 2^-8 of the light through, to the eye and to a shadow ray."""
    half = Material((0.0, 0.0, 0.0), opacity=0.5)
    cards = tuple(scenes.quad((-2, 0.25 + 0.0625 * k, 2), (4, 0, 0), (0, 0, -4), half) for k in range(8))
    up = Camera(scenes.look_at((0.0, 0.0, 0.0), (1e-3, 1.0, 0.0)), focal_length=360.0)
    through = scenes.replicates(Stage(up, cards, (scenes.dome(),)), 16, spp=256).mean((1, 2, 3))
    assert abs(through.mean() - 2.0**-8) < 6.0 * through.std(ddof=1) / 4
    lit = plate(scenes.sun(scenes.rotate("x", -90), 0.0, normalize=True))
    under = Camera(scenes.look_at((0.75, 0.125, 0.0), (0.0, 0.0, 0.0)), focal_length=3.6e5)
    for strategy in ("mis", "light"):
        floor = Stage(under, (*lit.meshes, *cards), lit.lights, max_depth=2)
        mean = scenes.replicates(floor, 16, spp=256, strategy=strategy).mean((1, 2, 3))
        assert abs(mean.mean() * math.pi - 2.0**-8) < 6.0 * math.pi * mean.std(ddof=1) / 4


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.53, 10.0, 90.0, 180.0])
def test_l06_normalized_distant_light_at_any_angle(angle: float) -> None:
    """L06: normalized, its irradiance on a plate that faces it is the same at every angle."""
    lamp = scenes.sun(scenes.rotate("x", -90), angle, normalize=True)
    assert_radiance(plate(lamp), 1 / math.pi, 2e-3, spp=1024)


@pytest.mark.parametrize("angle", [1e-3, 0.53, 10.0, 90.0, 180.0])
def test_l06_distant_light_by_its_radiance(angle: float) -> None:
    sine2 = math.sin(math.radians(angle) / 2) ** 2
    lamp = scenes.sun(scenes.rotate("x", -90), angle, scenes.times(WHITE, 1 / sine2))
    assert_radiance(plate(lamp), 1.0, 2e-3, spp=1024)


# --- domes ---


def reconstructed_radiance(image: Array) -> float:
    """Radiance of a white plate facing +Y under a lat-long image read bilinearly at pixel centres, by quadrature."""
    height, width = image.shape[:2]
    rows, columns = max(8 * height, 1024), max(8 * width, 2048)
    v, u = (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns
    y, x = np.clip(v * height - 0.5, 0, height - 1), u * width - 0.5
    y0, x0 = np.minimum(np.floor(y).astype(int), max(height - 2, 0)), np.floor(x).astype(int)
    y1 = np.minimum(y0 + 1, height - 1)
    fy, fx = (y - y0)[:, None], (x - x0)[None, :]
    grey = image[..., 0]
    low = grey[y0][:, x0 % width] * (1 - fx) + grey[y0][:, (x0 + 1) % width] * fx
    high = grey[y1][:, x0 % width] * (1 - fx) + grey[y1][:, (x0 + 1) % width] * fx
    values = low * (1 - fy) + high * fy
    theta = v * math.pi
    weight = np.where(theta < math.pi / 2, np.cos(theta) * np.sin(theta), 0.0)[:, None]
    return float((values * weight).mean() * math.pi * 2 * math.pi / math.pi)


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
@pytest.mark.parametrize("image", [None, np.ones((16, 32, 3))], ids=["no image", "constant image"])
def test_l07_constant_dome(image: Array | None, strategy: str) -> None:
    """L07: radiance one from everywhere makes a white plate one."""
    assert_radiance(plate(scenes.dome(image=image)), 1.0, 1e-5, strategy=strategy)


def test_l07_almost_constant_dome() -> None:
    image = np.ones((16, 32, 3))
    image[4, 7] += 1e-3
    assert_radiance(plate(scenes.dome(image=image)), reconstructed_radiance(image), 2e-4, spp=1024)


@pytest.mark.parametrize("image", [None, np.zeros((16, 32, 3))], ids=["no image", "black image"])
def test_l07_black_dome_is_left_out(image: Array | None) -> None:
    black = scenes.dome((0.0, 0.0, 0.0) if image is None else WHITE, image)
    assert (scenes.image(plate(black)) == 0.0).all()


def pole_images() -> dict[str, Array]:
    first_row, one_texel, one_row = np.zeros((32, 64, 3)), np.zeros((32, 64, 3)), np.zeros((1, 8, 3))
    first_row[0], one_texel[0, 5], one_row[0, 2:5] = 100.0, 1000.0, 3.0
    return {
        "first row": first_row,
        "one texel at the pole": one_texel,
        "one row": one_row,
        "one texel": np.full((1, 1, 3), 2.0),
    }


@pytest.mark.parametrize("strategy", ["mis", "light"])
@pytest.mark.parametrize("name", pole_images())
def test_l08_light_at_the_pole(name: str, strategy: str) -> None:
    """L08: Mitsuba renders the first row black."""
    image = pole_images()[name]
    assert_radiance(plate(scenes.dome(image=image)), reconstructed_radiance(image), 1e-2, strategy=strategy, spp=1024)


def test_l08_looking_at_the_poles() -> None:
    image = np.ones((8, 16, 3))
    for target in ((0.0, 1.0, 1e-7), (0.0, -1.0, 1e-7)):
        camera = Camera(scenes.look_at((0.0, 0.0, 0.0), target), focal_length=1e4)
        assert (scenes.image(Stage(camera, (), (scenes.dome(image=image),))) == 1.0).all()


@pytest.mark.parametrize("value", [1e2, 1e4, 1e6, 1e8])
@pytest.mark.parametrize("sky", [0.0, 1.0])
def test_l10_one_texel_sun(value: float, sky: float) -> None:
    """L10: one texel of a 128 x 64 map against a dark and a bright sky."""
    image = np.full((64, 128, 3), sky)
    image[14, 40] = value
    assert_radiance(plate(scenes.dome(image=image)), reconstructed_radiance(image), 5e-3, spp=1024)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_l09_texels_that_are_no_numbers(bad: float, strategy: str) -> None:
    """L09: one bad texel of a dome spoils nothing but itself."""
    image = scenes.sky_image()
    image[7, 9] = bad
    assert np.isfinite(scenes.image(plate(scenes.dome(image=image)), strategy=strategy)).all()


@pytest.mark.parametrize("value", [-1e4, 1e30, 1e-40])
def test_l09_texels_out_of_proportion(value: float) -> None:
    """L09: negative texels count as they are, chosen by their magnitude; huge and tiny ones overflow nothing."""
    image = np.ones((32, 64, 3))
    image[7, 9] = value
    assert_radiance(plate(scenes.dome(image=image)), reconstructed_radiance(image), 5e-3, spp=1024)


def test_dome_orientation() -> None:
    """UsdLux: the centre column is +Z, a quarter to the left of it +X, the top row +Y; a rotation turns it."""
    image = np.zeros((32, 64, 3))
    image[12:20, 14:18] = 1.0  # u = 0.25: +X
    looks = {"+x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "+z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0)}

    def brightness(look: str, turn: Array) -> float:
        camera = Camera(scenes.look_at((0.0, 0.0, 0.0), looks[look]), focal_length=360.0)
        return float(scenes.image(Stage(camera, (), (scenes.dome(image=image, transform=turn),))).mean())

    assert {k: brightness(k, np.eye(4)) for k in looks} == {"+x": 1.0, "-x": 0.0, "+z": 0.0, "-z": 0.0}
    turned = {k: round(brightness(k, scenes.rotate("y", 90)), 5) for k in looks}
    assert turned == {"+x": 0.0, "-x": 0.0, "+z": 0.0, "-z": 1.0}


# --- no light, no power, negative power ---


NOTHING: dict[str, tuple[Light, ...]] = {
    "no lights": (),
    "black": (scenes.rect(scenes.translate(0.0, 1.0, 0.0), emission=(0.0, 0.0, 0.0)), scenes.dome((0.0, 0.0, 0.0))),
    "no size": (
        scenes.rect(scenes.translate(0.0, 1.0, 0.0), 0.0, 1.0),
        scenes.disk(scenes.translate(0.0, 1.0, 0.0), 0.0),
        scenes.bulb(scenes.translate(0.0, 1.0, 0.0), 0.0),
        scenes.tube(scenes.translate(0.0, 1.0, 0.0), 0.0, 1.0),
    ),
    "no size, normalized": (
        scenes.rect(scenes.translate(0.0, 1.0, 0.0), 0.0, 1.0, normalize=True),
        scenes.bulb(scenes.translate(0.0, 1.0, 0.0), 0.0, normalize=True),
    ),
    "exposure -200": (scenes.bulb(scenes.translate(0.0, 1.0, 0.0), 0.25, scenes.times(WHITE, 2.0**-200)),),
}


@pytest.mark.parametrize("name", NOTHING)
def test_l14_no_light_is_exactly_black(name: str) -> None:
    """L14: no division by a total of zero; each light that is left out says why."""
    for strategy in ("mis", "light", "bsdf"):
        assert (scenes.image(plate(*NOTHING[name]), strategy=strategy) == 0.0).all()


@pytest.mark.parametrize("name", ["no size", "no size, normalized"])
def test_l14_reasons_are_given(name: str) -> None:
    _, reasons = scenes.build(plate(*NOTHING[name]))
    assert all(reasons.values()), reasons


def test_l15_negative_light_cancels() -> None:
    """L15: chosen by |power|, its sign kept."""
    place = scenes.translate(0.0, 1.0, 0.0)
    both = plate(
        scenes.bulb(place, 0.25, (4.0, 4.0, 4.0)), scenes.sun(scenes.rotate("x", -90), 30.0, (-1.0, -1.0, -1.0))
    )
    # The ball shades a part of the cone: E = pi (4 r^2/h^2 - (sin^2 15 - r^2/h^2)).
    shadow = 0.25**2
    expected = 4 * 0.25**2 - (math.sin(math.radians(15)) ** 2 - shadow)
    assert_radiance(both, expected, 2e-3, spp=1024)
    coincident = plate(
        scenes.sun(scenes.rotate("x", -90), 30.0), scenes.sun(scenes.rotate("x", -90), 30.0, (-1.0, -1.0, -1.0))
    )
    for strategy in ("mis", "light", "bsdf"):
        mean, error = probe(coincident, strategy=strategy)
        assert abs(mean) < 7.1 * error + 1e-7
