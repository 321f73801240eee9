"""Laws about rays and surfaces: no self-hits, no leaks, bad geometry refused or harmless, cameras at their limits."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import footlight_core
from tests.laws import scenes
from tests.laws.scenes import WHITE, Array, Camera, Light, Material, Mesh, Stage

HALF = Material((0.5, 0.5, 0.5))
LAMP = scenes.dome((1e6, 1e6, 1e6))  # so bright that one leaking ray in a million shows


def facing(distance: float, size: float, near: float | None = None) -> Camera:
    """Looks down -Z at a ball of radius `size` at the origin, which nearly fills the view."""
    return Camera(
        scenes.translate(0.0, 0.0, distance),
        focal_length=36.0 * distance / (2.2 * size),
        clipping_range=(1e-3 * (distance - size) if near is None else near, 1e9 * distance),
    )


# --- self-intersection ---


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("ratio", [4.0, 1e2, 1e4])
@pytest.mark.parametrize("instanced", [False, True])
@pytest.mark.parametrize("strategy", ["bsdf", "light"])
def test_g03_convex_body_never_hits_itself(size: float, ratio: float, instanced: bool, strategy: str) -> None:
    """G03, G20: a grey convex body in a white dome is grey; a ray that hits its own surface makes it darker."""
    place = scenes.chain(scenes.rotate("x", 30), scenes.rotate("y", 20), scenes.scale(size))
    transforms = place[None]
    if instanced:
        behind = place @ scenes.translate(0.0, 0.0, 1e3 * ratio * size)
        transforms = np.stack([place, behind])
    stage = Stage(facing(ratio * size, size), (scenes.icosphere(HALF, 2, transforms=transforms),), (scenes.dome(),))
    render = scenes.run(stage, strategy=strategy, spp=64, width=48, height=48, aovs=["color", "albedo"])
    inside = np.abs(render.read("albedo")[..., 0] - 0.5) < 1e-6
    assert inside.sum() > 500
    pixels = render.read("color")[inside]
    if strategy == "bsdf":
        assert np.abs(pixels - 0.5).max() < 1e-6
    else:
        error = pixels[:, 0].std() / math.sqrt(len(pixels))
        assert abs(pixels.mean() - 0.5) < 5.2 * error


def test_g03_a_far_instance_seen_edge_on() -> None:
    """G03: rays start outside also as rounded on their way into an instance's space; edge-on the offset is smallest."""
    size, distance = 1e3, 1e7
    # Along none of the instance's axes, where the roundings of one coordinate would be all that counts.
    aslant = scenes.chain(scenes.rotate("x", 40), scenes.rotate("y", 30))
    corners = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [0, 1, 0, 1]]) @ aslant
    plate = Mesh(corners[:, :3].astype(np.float32), np.array([[0, 1, 2]], np.uint32), HALF)
    place = scenes.chain(aslant.T, scenes.rotate("x", -89.5), scenes.rotate("z", 10), scenes.scale(size))
    transforms = np.stack([place, place @ scenes.translate(0.0, 0.0, 1e3 * distance)])
    stage = Stage(facing(distance, size), (replace(plate, transforms=transforms),), (scenes.dome(),))
    render = scenes.run(stage, strategy="bsdf", spp=256, width=48, height=48, aovs=["color", "albedo"])
    assert render.read("albedo").max() > 0.1
    # Half the dome's light where the plate is, all of it beside.
    assert np.abs(render.read("color") + render.read("albedo") - 1).max() < 1e-5


def test_g03_control_a_body_that_does_hit_itself_is_darker() -> None:
    bowl = scenes.icosphere(HALF, 2, **scenes.at(scenes.scale(1.0)))
    half_open = replace(bowl, triangles=bowl.triangles[bowl.points[bowl.triangles].mean(1)[:, 2] < 0.3])
    pixels = scenes.image(Stage(facing(4.0, 1.0), (half_open,), (scenes.dome(),)), strategy="bsdf", spp=16)
    assert pixels[12:20, 12:20].mean() < 0.45


@pytest.mark.parametrize("distance", [1e4, 1e8])
def test_g02_a_scene_far_away_is_the_same_scene(distance: float) -> None:
    """G02: under a translation of 1e8 with the camera beside it; not dyadic, so within rounding."""
    here = scenes.image(scenes.gallery(), spp=16)
    there = scenes.image(
        scenes.moved(scenes.gallery(), scenes.translate(distance, -0.7 * distance, 0.3 * distance)), spp=16
    )
    assert np.median(np.abs(here - there)) < 1e-6
    assert abs(there.mean() / here.mean() - 1) < 0.01


# --- leaks ---


def shallow_lid(gap: float) -> Mesh:
    """A black box without bottom, from z = -1 to z = gap: what lies on z = 0 under it is shut off from all light."""
    case = scenes.box(Material((0.0, 0.0, 0.0)))
    points = case.points.copy()
    points[:, 2] = np.where(points[:, 2] > 0, np.float32(gap), np.float32(-1.0))
    bottom = (case.points[case.triangles][:, :, 2] < 0).all(1)
    return replace(case, points=points, triangles=case.triangles[~bottom])


@pytest.mark.parametrize("gap", [1e-3, 1e-4, 2e-5])
@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_g04_thin_gap_stays_dark(gap: float, strategy: str) -> None:
    """G04: ten units from the camera a lid lies on a plate; the near plane shows the plate, no light reaches it."""
    plate = scenes.quad((-2, -2, 0), (4, 0, 0), (0, 4, 0), Material(WHITE))
    camera = Camera(scenes.translate(0.0, 0.0, 10.0), focal_length=3.6e5, clipping_range=(10.0 - gap / 2, 1e6))
    lidded = Stage(camera, (plate, shallow_lid(gap)), (LAMP,))
    render = scenes.run(lidded, spp=64, strategy=strategy, aovs=["color", "albedo"])
    assert (render.read("albedo") == 1.0).all(), "the near plane does not show the plate"
    assert (render.read("color") == 0.0).all()


def test_g04_control_without_the_lid_it_is_bright() -> None:
    plate = scenes.quad((-2, -2, 0), (4, 0, 0), (0, 4, 0), Material(WHITE))
    camera = Camera(scenes.translate(0.0, 0.0, 10.0), focal_length=3.6e5, clipping_range=(9.5, 1e6))
    assert scenes.image(Stage(camera, (plate,), (LAMP,))).mean() > 1e5


@pytest.mark.parametrize("level", [1, 4])
def test_g05_closed_room_has_no_leaks(level: int) -> None:
    """G05: from inside a closed body every path stays inside."""
    wall = scenes.icosphere(Material((0.9, 0.9, 0.9)), level, inwards=True)
    camera = Camera(scenes.look_at((0.1, 0.2, 0.3), (-1.0, 0.3, -0.5)), focal_length=15.0)
    pixels = scenes.image(Stage(camera, (wall,), (LAMP,), max_depth=8), spp=64, width=48, height=48)
    assert (pixels == 0.0).all()


@pytest.mark.parametrize("what", ["edges", "vertices"])
def test_g05_rays_at_edges_and_vertices(what: str) -> None:
    """G05: views a hundred-thousandth of a degree wide, each on the middle of an edge or on a vertex."""
    wall = scenes.icosphere(Material((0.9, 0.9, 0.9)), 3, inwards=True)
    points = wall.points.astype(np.float64)
    targets = points[wall.triangles[::40, :2]].mean(1) if what == "edges" else points[::20]
    escaped = rays = 0
    for target in targets[:24]:
        camera = Camera(scenes.look_at((0.125, 0.25, 0.0625), tuple(target)), focal_length=1e8)
        pixels = scenes.image(Stage(camera, (wall,), (LAMP,), max_depth=2), spp=64, width=16, height=16)
        escaped += int((pixels != 0).any(-1).sum())
        rays += pixels.shape[0] * pixels.shape[1] * 64
    assert escaped == 0 if what == "edges" else escaped <= 1e-5 * rays


def test_g05_control_one_missing_triangle_is_seen() -> None:
    wall = scenes.icosphere(Material((0.9, 0.9, 0.9)), 4, inwards=True)
    holed = replace(wall, triangles=wall.triangles[:-1])
    camera = Camera(scenes.look_at((0.1, 0.2, 0.3), (-1.0, 0.3, -0.5)), focal_length=15.0)
    assert scenes.image(Stage(camera, (holed,), (LAMP,), max_depth=8), spp=64, width=48, height=48).max() > 0


# --- bad geometry ---


def plain_stage(*meshes: Mesh, lights: tuple[Light, ...] = (scenes.dome(),)) -> Stage:
    return Stage(Camera(scenes.look_at((0.0, 1.0, 4.0), (0.0, 0.0, 0.0))), meshes, lights)


def test_g08_degenerate_triangles_change_nothing() -> None:
    """G08: collinear, repeated and vanishing triangles are as if they were not there."""
    ball = scenes.icosphere(HALF, 2)
    n = len(ball.points)
    extra = np.array([[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [0, 1e-15, 0], [0, 0, 1e-15]], np.float32)
    bad = np.array([[n, n + 1, n + 2], [0, 0, 5], [7, 7, 7], [n, n + 1, n + 1]], np.uint32)
    spoiled = replace(
        ball, points=np.concatenate([ball.points, extra]), triangles=np.concatenate([ball.triangles, bad])
    )
    clean, soiled = scenes.image(plain_stage(ball)), scenes.image(plain_stage(spoiled))
    assert np.array_equal(clean, soiled)
    # Tiny but not flat, and a needle of 1 : 1e7: kept or dropped, harmless.
    thin = np.array([[n, n + 3, n + 4], [n, n + 2, n + 3]], np.uint32)
    needles = replace(spoiled, triangles=np.concatenate([spoiled.triangles, thin]))
    assert np.isfinite(scenes.image(plain_stage(needles))).all()


def test_g08_a_mesh_of_nothing_else() -> None:
    flat = Mesh(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.uint32), HALF)
    alone = plain_stage(scenes.icosphere(HALF, 1))
    assert np.array_equal(scenes.image(alone), scenes.image(replace(alone, meshes=(*alone.meshes, flat))))


def spoil(values: np.ndarray | None, bad: float) -> np.ndarray:
    assert values is not None
    result = values.copy()
    result.flat[4] = bad
    return result


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["points", "normals", "colors", "opacities"])
def test_g09_numbers_that_are_none_are_refused_by_name(field: str, bad: float) -> None:
    """G09: the message names the prim."""
    mesh = scenes.sphere(HALF, 8, 4, smooth=True)
    mesh = replace(mesh, colors=np.ones_like(mesh.points), opacities=np.ones(len(mesh.points), np.float32))
    good, scene = mesh, footlight_core.Scene()
    scenes.add_mesh(scene, "/World/good", good)
    change: dict[str, Any] = {field: spoil(getattr(mesh, field), bad)}
    mesh = replace(mesh, **change)
    with pytest.raises(ValueError, match="/World/broken"):
        scenes.add_mesh(scene, "/World/broken", mesh)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_g09_transforms(bad: float) -> None:
    matrix = np.eye(4)
    matrix[3, 1] = bad
    scene = footlight_core.Scene()
    prototype = scenes.add_mesh(scene, "/World/mesh", scenes.box(HALF))
    local = np.eye(4)[None].copy()
    with pytest.raises(ValueError, match="/World/broken"):
        scene.add_instances(path="/World/broken", meshes=[prototype], local_transforms=local, transforms=matrix[None])
    with pytest.raises(ValueError, match="/World/broken"):
        scenes.add_light(scene, "/World/broken", scenes.rect(matrix))
    with pytest.raises(ValueError, match="/camera"):
        scenes.set_camera(scene, Camera(matrix), 8, 8)


@pytest.mark.parametrize("index", [42, 2**31 - 1, 2**32 - 1])
def test_g10_indices_out_of_range_are_refused_by_name(index: int) -> None:
    mesh = scenes.box(HALF)
    triangles = mesh.triangles.copy()
    triangles[3, 1] = index
    with pytest.raises(ValueError, match="/World/broken"):
        scenes.add_mesh(footlight_core.Scene(), "/World/broken", replace(mesh, triangles=triangles))
    smooth = scenes.sphere(HALF, 8, 4, smooth=True)
    indices = smooth.triangles.copy()
    indices[3, 1] = index
    with pytest.raises(ValueError, match="/World/broken"):
        scenes.add_mesh(footlight_core.Scene(), "/World/broken", replace(smooth, normal_indices=indices))


def perturbed_normals(mesh: Mesh, degrees: float, seed: int = 1) -> Mesh:
    """The mesh with each vertex normal tilted by up to that angle."""
    random = np.random.default_rng(seed)
    outward = mesh.points.astype(np.float64) / np.linalg.norm(mesh.points, axis=1, keepdims=True)
    side = np.cross(outward, random.normal(size=outward.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = np.radians(degrees) * random.random((len(outward), 1))
    return replace(mesh, normals=(np.cos(angle) * outward + np.sin(angle) * side).astype(np.float32))


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
@pytest.mark.parametrize("material", [Material(WHITE), Material(WHITE, metallic=1.0, roughness=0.5)])
def test_g12_tilted_normals_let_no_light_through(strategy: str, material: Material) -> None:
    """G12: a closed room with wild normals stays dark inside, a white ball with wild normals gains nothing."""
    room = perturbed_normals(scenes.icosphere(material, 2), 60.0)
    inside = Camera(scenes.look_at((0.1, 0.2, 0.3), (-1.0, 0.3, -0.5)), focal_length=15.0)
    pixels = scenes.image(Stage(inside, (room,), (LAMP,), max_depth=8), strategy=strategy, spp=32)
    assert (pixels == 0.0).all()
    outside = Stage(facing(4.0, 1.0), (room,), (scenes.dome(),))
    means = [scenes.image(outside, strategy=strategy, spp=32, seed=s)[10:22, 10:22].mean() for s in range(8)]
    assert np.mean(means) <= 1 + 1e-3 + 5.2 * np.std(means, ddof=1) / math.sqrt(8)


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0])
def test_g12_tilted_normal_in_closed_form(degrees: float, strategy: str) -> None:
    """G12: of the cosine lobe about a normal tilted by t, the part (1 + cos t) / 2 lies above the face."""
    tilt = math.radians(degrees)
    plate = scenes.quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), Material(WHITE))
    tilted = replace(plate, normals=np.tile(np.array([math.sin(tilt), 0, math.cos(tilt)], np.float32), (4, 1)))
    camera = Camera(scenes.translate(0.0, 0.0, 4.0), focal_length=360.0)
    stage = Stage(camera, (tilted,), (scenes.dome(),))
    means = [scenes.image(stage, strategy=strategy, spp=64, seed=s).mean() for s in range(8)]
    assert abs(np.mean(means) - (1 + math.cos(tilt)) / 2) < 7.1 * np.std(means, ddof=1) / math.sqrt(8) + 1e-5


def test_g13_normals_that_vanish_are_the_face() -> None:
    """G13: zero and opposite vertex normals give finite pixels, and all-zero normals the flat image."""
    ball = scenes.icosphere(HALF, 1)
    flat = scenes.image(plain_stage(ball), strategy="bsdf")
    zero = scenes.image(plain_stage(replace(ball, normals=np.zeros_like(ball.points))), strategy="bsdf")
    assert np.allclose(zero, flat, atol=1e-6)
    opposite = ball.points.copy()
    opposite[::2] *= -1
    assert np.isfinite(scenes.image(plain_stage(replace(ball, normals=opposite)))).all()


@pytest.mark.parametrize("matrix", [scenes.scale(1.0, 1.0, 0.0), scenes.scale(0.0)], ids=["flat", "point"])
@pytest.mark.parametrize("count", [1, 3])
def test_g18_singular_transforms_are_left_out(matrix: Array, count: int) -> None:
    """G18: never inverted, never rendered as noise: the image without them."""
    ball = scenes.icosphere(HALF, 1, **scenes.at(scenes.translate(-1.0, 0.0, 0.0)))
    singular = replace(
        scenes.box(HALF), transforms=np.stack([scenes.translate(0.5 * k, 0.0, 0.0) for k in range(count)])
    )
    singular.transforms[0] = matrix
    rest = tuple(replace(singular, transforms=singular.transforms[1:]) for _ in range(count > 1))
    pixels = scenes.image(plain_stage(ball, singular), strategy="bsdf")
    assert np.allclose(pixels, scenes.image(plain_stage(ball, *rest), strategy="bsdf"), atol=1e-6)


# --- cameras ---


@pytest.mark.parametrize("degrees", [1e-3, 1e-2, 10.0, 170.0, 179.9])
def test_g21_pinhole_directions_at_any_angle(degrees: float) -> None:
    """G21: where the rays meet a plane is where similar triangles say, from a thousandth of a degree to 179.9."""
    half = math.tan(math.radians(degrees) / 2)
    plane = Mesh(
        np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * np.float32(4 * half),
        np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        HALF,
    )
    camera = Camera(
        scenes.translate(0.0, 0.0, 1.0), focal_length=18.0 / half, aperture=36.0, clipping_range=(1e-3, 1e6)
    )
    n = 16
    render = scenes.run(
        Stage(camera, (plane,), (scenes.dome(),)), spp=64, width=n, height=n, aovs=["color", "position", "depth"]
    )
    position = render.read("position") / half
    pixel = 2 / n
    centre = (np.arange(n) + 0.5) * pixel - 1
    assert (np.abs(position[..., 0] - centre[None, :]) < 0.5 * pixel + 1e-5).all()
    assert (np.abs(position[..., 1] + centre[:, None]) < 0.5 * pixel + 1e-5).all()
    assert np.abs(render.read("depth") - 1).max() < 1e-5
    assert np.isfinite(render.read("color")).all()


def test_g21_aperture_offset_moves_the_window() -> None:
    """Offsets of a quarter and an eighth of the aperture move the middle of the view by as much of its width."""
    plane = scenes.quad((-8, -8, 0), (16, 0, 0), (0, 16, 0), HALF)
    camera = Camera(scenes.translate(0.0, 0.0, 1.0), focal_length=36.0, offset=(9.0, -4.5))
    stage = Stage(camera, (plane,), (scenes.dome(),))
    render = scenes.run(stage, spp=64, width=32, height=32, aovs=["color", "position"])
    middle = render.read("position").mean((0, 1))
    # The position is that of the pixel's nearest sample, up to half a pixel from its centre.
    assert abs(middle[0] - 9.0 / 36.0) < 0.5 / 32
    assert abs(middle[1] + 4.5 / 36.0) < 0.5 / 32


def test_g21_near_and_far_planes() -> None:
    """G21: what lies before the near plane or behind the far plane is not seen; a millimetre before the eye can be."""
    ball = scenes.icosphere(HALF, 2, **scenes.at(scenes.scale(0.25)))

    def seen(near: float, far: float) -> bool:
        camera = Camera(scenes.translate(0.0, 0.0, 4.0), focal_length=60.0, clipping_range=(near, far))
        return bool(
            np.isfinite(
                scenes.run(Stage(camera, (ball,), (scenes.dome(),)), spp=4, aovs=["color", "depth"]).read("depth")
            ).any()
        )

    assert seen(0.01, 100.0)
    assert seen(3.7, 4.3)
    assert not seen(4.3, 100.0)
    assert not seen(0.01, 3.7)
    tiny = scenes.icosphere(HALF, 2, **scenes.at(scenes.scale(1e-3)))
    camera = Camera(scenes.translate(0.0, 0.0, 4e-3), focal_length=60.0, clipping_range=(1e-5, 10.0))
    depth = scenes.run(Stage(camera, (tiny,), (scenes.dome(),)), spp=4, aovs=["color", "depth"]).read("depth")
    assert 2.9e-3 < depth.min() < 3.2e-3


def test_g21_a_lens_without_aperture_or_focus_is_a_pinhole() -> None:
    stage = replace(scenes.lens(), camera=replace(scenes.lens().camera, f_stop=0.0))
    other = replace(stage, camera=replace(stage.camera, focus_distance=0.0))
    assert np.array_equal(scenes.image(stage), scenes.image(other))


def test_g21_an_edge_out_of_focus_in_closed_form() -> None:
    """G21: at twice the focus distance an edge is blurred by the lens itself, turned round: by a uniform disk."""
    wall = scenes.quad((0, -8, -4), (8, 0, 0), (0, 16, 0), HALF)  # the right half of a view 4 wide
    camera = Camera(np.eye(4), f_stop=1.8, focus_distance=2.0)  # a lens of radius 1
    columns, spp = 32, 256
    render = scenes.run(Stage(camera, (wall,)), spp=spp, width=columns, height=32, aovs=["color", "alpha"])
    seen = render.read("alpha")[..., 0].mean(0)

    grid = (np.arange(512) + 0.5) / 512
    across = (np.arange(columns * 16) + 0.5) / (columns * 16) * 4 - 2  # 16 places within each pixel

    def blurred(radii: Array) -> Array:
        lens = np.sort(np.outer(radii, np.cos(2 * math.pi * grid)).ravel())
        pixels: Array = (np.searchsorted(lens, across) / lens.size).reshape(columns, 16).mean(axis=1)
        return pixels

    expected = blurred(np.sqrt(grid))
    tolerance = 5.2 * np.sqrt(expected * (1 - expected) / (32 * spp)) + 1e-3
    assert (np.abs(seen - expected) < tolerance).all()
    # A radius that is uniform itself crowds the middle.
    assert (np.abs(blurred(grid) - expected) > tolerance).any()


@pytest.mark.parametrize(
    "change", [{"focal_length": 0.0}, {"focal_length": math.nan}, {"aperture": 0.0}, {"clipping_range": (1.0, 0.5)}]
)
def test_g21_impossible_cameras_are_refused_by_name(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="/camera"):
        scenes.set_camera(footlight_core.Scene(), replace(Camera(np.eye(4)), **change), 8, 8)


# --- counts beyond 32 bits ---


@pytest.mark.parametrize("begin", [2**16 - 1, 2**24 - 1, 2**31 - 2, 2**32 - 5])
def test_g23_sample_numbers_near_powers_of_two(begin: int) -> None:
    """G23, S06: late samples are samples like others: finite, unlike each other, and right in the mean."""
    stage = scenes.room()
    late = scenes.renderer(stage, width=16, height=16)
    assert late.render(begin, begin + 4, 0, late.tiles)
    early = scenes.image(stage, width=16, height=16, spp=64)
    pixels = late.read("color")
    assert np.isfinite(pixels).all()
    assert abs(pixels[8:].mean() / early[8:].mean() - 1) < 0.25
    other = scenes.renderer(stage, width=16, height=16)
    assert other.render(begin - 4, begin, 0, other.tiles)
    assert not np.array_equal(other.read("color"), pixels)


def test_g23_wide_and_high_images() -> None:
    stage = Stage(Camera(np.eye(4)), (), (scenes.dome(),))
    for width, height in ((65_535, 2), (1, 65_535)):
        pixels = scenes.image(stage, width=width, height=height, spp=1)
        assert pixels.shape == (height, width, 3)
        assert (pixels == 1.0).all()
    scene, _ = scenes.build(stage)
    for width, height in ((65_536, 1), (0, 1), (1, 2**31 - 1)):
        with pytest.raises(ValueError, match="size"):
            footlight_core.Renderer(scene, footlight_core.RenderOptions(width=width, height=height))
