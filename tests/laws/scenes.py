"""A small kit for laws about images: scenes as plain data, their transformations, and their renders by the core.

Transforms are float64 (4, 4) for row vectors, p' = p @ M, as in USD. Lengths are in stage units.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

import footlight_core

Array = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]
Colour = tuple[float, float, float]

GRID = 2.0**-10  # vertices lie on this grid, so that moving a scene by 2^20 is exact
WHITE: Colour = (1.0, 1.0, 1.0)


# --- scenes as data ---


@dataclass(frozen=True, slots=True)
class Material:
    """UsdPreviewSurface by its own names; without arguments Lambert of reflectance 0.5."""

    diffuse_color: Colour = (0.5, 0.5, 0.5)
    metallic: float = 0.0
    roughness: float = 1.0
    ior: float = 1.0
    clearcoat: float = 0.0
    clearcoat_roughness: float = 0.01
    emissive_color: Colour = (0.0, 0.0, 0.0)
    opacity: float = 1.0
    diffuse_from_primvar: bool = False
    opacity_from_primvar: bool = False


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles in object space, placed K times by `transforms` (K, 4, 4); K = 1 is baked by the core."""

    points: Points
    triangles: npt.NDArray[np.uint32]
    material: Material
    transforms: Array = field(default_factory=lambda: np.eye(4)[None])
    normals: Points | None = None
    normal_indices: npt.NDArray[np.uint32] | None = None
    colors: Points | None = None
    opacities: Points | None = None


@dataclass(frozen=True, slots=True)
class Light:
    """A light by its kind (rect, disk, sphere, cylinder, distant, dome), its transform and what its kind needs."""

    kind: str
    transform: Array
    emission: Colour = WHITE
    normalize: bool = False
    sizes: dict[str, float] = field(default_factory=dict)
    image: Points | None = None
    visible_to_camera: bool = True


@dataclass(frozen=True, slots=True)
class Camera:
    """Looking along local -Z; apertures and focal length in tenths of a stage unit, the rest in stage units."""

    camera_to_world: Array
    focal_length: float = 36.0
    aperture: float = 36.0
    f_stop: float = 0.0
    focus_distance: float = 0.0
    clipping_range: tuple[float, float] = (0.01, 1e6)
    offset: tuple[float, float] = (0.0, 0.0)
    exposure_scale: float = 1.0


@dataclass(frozen=True, slots=True)
class Stage:
    """What is rendered."""

    camera: Camera
    meshes: tuple[Mesh, ...] = ()
    lights: tuple[Light, ...] = ()
    unused: tuple[Mesh, ...] = ()  # meshes and materials that are added but placed nowhere
    max_depth: int = 6


# --- transforms ---


def translate(x: float, y: float, z: float) -> Array:
    """A translation."""
    matrix = np.eye(4)
    matrix[3, :3] = x, y, z
    return matrix


def scale(x: float, y: float | None = None, z: float | None = None) -> Array:
    """A scale, uniform with one argument."""
    return np.diag([x, x if y is None else y, x if z is None else z, 1.0])


def rotate(axis: str, degrees: float) -> Array:
    """A rotation about an axis, counter-clockwise seen from its tip."""
    a, b = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    matrix = np.eye(4)
    matrix[a, a], matrix[a, b], matrix[b, a], matrix[b, b] = c, s, -s, c
    return matrix


def look_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Array:
    """Camera to world, with +Y up."""
    back = np.subtract(eye, target).astype(np.float64)
    back /= np.linalg.norm(back)
    right = np.cross((0.0, 1.0, 0.0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3], matrix[3, :3] = right, np.cross(back, right), back, eye
    return matrix


# --- shapes ---


def on_grid(points: npt.ArrayLike) -> Points:
    """Points rounded to the dyadic grid."""
    return (np.round(np.asarray(points, np.float64) / GRID) * GRID).astype(np.float32)


def quad(corner: npt.ArrayLike, u: npt.ArrayLike, v: npt.ArrayLike, material: Material, **more: Any) -> Mesh:
    """The parallelogram corner + a u + b v, its normal along u x v."""
    p, a, b = (np.asarray(x, np.float64) for x in (corner, u, v))
    return Mesh(on_grid([p, p + a, p + a + b, p + b]), np.array([[0, 1, 2], [0, 2, 3]], np.uint32), material, **more)


def box(material: Material, *, inwards: bool = False, **more: Any) -> Mesh:
    """The cube [-1, 1]^3 with its faces seen from outside, or from inside."""
    points = on_grid([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    result = np.array(triangles, np.uint32)
    return Mesh(points, result[:, ::-1].copy() if inwards else result, material, **more)


def sphere(
    material: Material, segments: int = 32, rings: int = 16, *, smooth: bool = False, inwards: bool = False, **more: Any
) -> Mesh:
    """A tessellated unit sphere with its poles on Y, flat or with smooth normals."""
    theta = np.linspace(0, math.pi, rings + 1)[1:-1, None]
    phi = np.arange(segments)[None] * 2 * math.pi / segments
    belt = np.stack(np.broadcast_arrays(np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)), -1)
    points = np.concatenate([[[0.0, 1.0, 0.0]], belt.reshape(-1, 3), [[0.0, -1.0, 0.0]]])

    def at(ring: int, segment: int) -> int:
        return 1 + (ring - 1) * segments + segment % segments

    triangles = []
    for s in range(segments):
        triangles += [(0, at(1, s), at(1, s + 1)), (len(points) - 1, at(rings - 1, s + 1), at(rings - 1, s))]
        for r in range(1, rings - 1):
            triangles += [(at(r, s), at(r + 1, s), at(r + 1, s + 1)), (at(r, s), at(r + 1, s + 1), at(r, s + 1))]
    faces = np.array(triangles, np.uint32)
    sign = -1.0 if inwards else 1.0
    return Mesh(
        on_grid(points),
        faces[:, ::-1].copy() if inwards else faces,
        material,
        normals=(sign * points).astype(np.float32) if smooth else None,
        **more,
    )


def icosphere(material: Material, level: int = 2, *, inwards: bool = False, **more: Any) -> Mesh:
    """A unit sphere of 20 * 4^level flat triangles, no two of them in one plane: convex whatever the rounding."""
    g = (1 + math.sqrt(5)) / 2
    points = [np.array(p) / math.hypot(1, g) for p in (
        (-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g),
        (0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1),
    )]  # fmt: skip
    faces = [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4),
        (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8),
        (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
    ]  # fmt: skip
    for _ in range(level):
        middle: dict[tuple[int, int], int] = {}

        def between(a: int, b: int, known: dict[tuple[int, int], int]) -> int:
            key = (min(a, b), max(a, b))
            if key not in known:
                known[key] = len(points)
                points.append((points[a] + points[b]) / np.linalg.norm(points[a] + points[b]))
            return known[key]

        finer = []
        for a, b, c in faces:
            ab, bc, ca = between(a, b, middle), between(b, c, middle), between(c, a, middle)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    triangles = np.array(faces, np.uint32)
    return Mesh(on_grid(points), triangles[:, ::-1].copy() if inwards else triangles, material, **more)


def at(*matrices: Array) -> dict[str, Any]:
    """The keyword that places a mesh once, by a product of transforms."""
    return {"transforms": chain(*matrices)[None]}


def chain(*matrices: Array) -> Array:
    """The product of transforms, the first applied first."""
    result = np.eye(4)
    for matrix in matrices:
        result = result @ matrix
    return result


# --- lights ---


def rect(transform: Array, width: float = 1.0, height: float = 1.0, emission: Colour = WHITE, **more: Any) -> Light:
    """Emits along local -Z."""
    return Light("rect", transform, emission, sizes={"width": width, "height": height}, **more)


def disk(transform: Array, radius: float = 0.5, emission: Colour = WHITE, **more: Any) -> Light:
    """Emits along local -Z."""
    return Light("disk", transform, emission, sizes={"radius": radius}, **more)


def bulb(transform: Array, radius: float = 0.5, emission: Colour = WHITE, **more: Any) -> Light:
    """A sphere light."""
    return Light("sphere", transform, emission, sizes={"radius": radius}, **more)


def tube(transform: Array, radius: float = 0.1, length: float = 1.0, emission: Colour = WHITE, **more: Any) -> Light:
    """A cylinder light along local X."""
    return Light("cylinder", transform, emission, sizes={"radius": radius, "length": length}, **more)


def sun(transform: Array, angle: float = 0.53, emission: Colour = WHITE, **more: Any) -> Light:
    """A distant light of that angular diameter [degrees], shining along local -Z."""
    return Light("distant", transform, emission, sizes={"angle": angle}, **more)


def dome(emission: Colour = WHITE, image: npt.ArrayLike | None = None, transform: Array | None = None) -> Light:
    """Light from everywhere; the image (H, W, 3) is lat-long, its top row at +Y, its centre column at +Z."""
    pixels = None if image is None else np.ascontiguousarray(image, np.float32)
    return Light("dome", np.eye(4) if transform is None else transform, emission, image=pixels)


# --- transformations of whole scenes ---


def moved(stage: Stage, matrix: Array) -> Stage:
    """The stage under a new root transform of uniform scale; the camera moves with it and keeps its own scale."""
    place = stage.camera.camera_to_world @ matrix
    place[:3, :3] /= np.linalg.norm(matrix[0, :3])  # exact for powers of two
    return replace(
        stage,
        camera=replace(stage.camera, camera_to_world=place),
        meshes=tuple(replace(m, transforms=m.transforms @ matrix) for m in stage.meshes),
        lights=tuple(replace(light, transform=light.transform @ matrix) for light in stage.lights),
    )


def enlarged(stage: Stage, factor: float) -> Stage:
    """Every length times `factor` by a root transform; the lens grows too, radiance stays, so the image stays."""
    result = moved(stage, scale(factor))
    camera = stage.camera
    lengths = (camera.focus_distance * factor, camera.f_stop / factor)
    near, far = camera.clipping_range
    lens = replace(
        result.camera, focus_distance=lengths[0], f_stop=lengths[1], clipping_range=(near * factor, far * factor)
    )
    lights = tuple(
        replace(light, emission=times(light.emission, factor**2)) if light.normalize and area_of(light) else light
        for light in result.lights
    )
    return replace(result, camera=lens, lights=lights)


def area_of(light: Light) -> bool:
    """Whether normalize divides by something that grows with the scene."""
    return light.kind in {"rect", "disk", "sphere", "cylinder"}


def authored_larger(stage: Stage, factor: float) -> Stage:
    """Every length times `factor` in the numbers themselves: points, sizes and translations, no root transform."""
    result = enlarged(stage, factor)

    def unscaled(matrices: Array) -> Array:
        kept = matrices.copy()
        kept[..., :3, :3] /= factor
        return kept

    sized = {"width", "height", "radius", "length"}
    return replace(
        result,
        meshes=tuple(
            replace(m, points=(m.points * np.float32(factor)), transforms=unscaled(m.transforms)) for m in result.meshes
        ),
        lights=tuple(
            replace(
                light,
                transform=unscaled(light.transform),
                sizes={k: v * factor if k in sized else v for k, v in light.sizes.items()},
            )
            for light in result.lights
        ),
    )


def mirrored(stage: Stage) -> Stage:
    """The stage reflected in x = 0, seen by a proper camera: its image is the original's with the columns reversed."""
    flip = scale(-1.0, 1.0, 1.0)
    result = moved(stage, flip)
    camera = replace(result.camera, camera_to_world=flip @ result.camera.camera_to_world)
    return replace(result, camera=replace(camera, offset=(-stage.camera.offset[0], stage.camera.offset[1])))


def times(colour: Colour, factor: float) -> Colour:
    """A colour scaled."""
    return (colour[0] * factor, colour[1] * factor, colour[2] * factor)


def brighter(stage: Stage, factor: float) -> Stage:
    """Every emission times `factor`."""

    def lit(mesh: Mesh) -> Mesh:
        return replace(
            mesh, material=replace(mesh.material, emissive_color=times(mesh.material.emissive_color, factor))
        )

    return replace(
        stage,
        lights=tuple(replace(light, emission=times(light.emission, factor)) for light in stage.lights),
        meshes=tuple(lit(m) for m in stage.meshes),
    )


def flattened(stage: Stage) -> Stage:
    """Every placement as a mesh of its own."""
    return replace(
        stage,
        meshes=tuple(replace(mesh, transforms=one[None]) for mesh in stage.meshes for one in mesh.transforms),
    )


# --- into the core ---


def add_material(scene: Any, path: str, material: Material) -> int:
    """One material."""
    result: int = scene.add_material(
        path=path,
        diffuse_color=material.diffuse_color,
        diffuse_from_primvar=material.diffuse_from_primvar,
        metallic=material.metallic,
        roughness=material.roughness,
        ior=material.ior,
        specular_color=(0.0, 0.0, 0.0),
        use_specular_workflow=False,
        clearcoat=material.clearcoat,
        clearcoat_roughness=material.clearcoat_roughness,
        emissive_color=material.emissive_color,
        opacity=material.opacity,
        opacity_from_primvar=material.opacity_from_primvar,
    )
    return result


def add_mesh(scene: Any, path: str, mesh: Mesh) -> int:
    """One mesh with its material, placed nowhere yet."""
    result: int = scene.add_mesh(
        path=path,
        material=add_material(scene, f"{path}/material", mesh.material),
        points=np.ascontiguousarray(mesh.points, np.float32),
        triangles=np.ascontiguousarray(mesh.triangles, np.uint32),
        normals=mesh.normals,
        normal_indices=mesh.normal_indices,
        colors=mesh.colors,
        color_indices=None,
        opacities=mesh.opacities,
        opacity_indices=None,
    )
    return result


def add_light(scene: Any, path: str, light: Light) -> str:
    """One light; what the core says of it, empty if it was taken as it is."""
    common = {"path": path, "emission": light.emission, "visible_to_camera": light.visible_to_camera}
    if light.kind == "dome":
        reason: str = scene.add_dome_light(transform=light.transform, image=light.image, **common)
    else:
        add = getattr(scene, f"add_{light.kind}_light")
        reason = add(transform=light.transform, normalize=light.normalize, **light.sizes, **common)
    return reason


def set_camera(scene: Any, camera: Camera, width: int, height: int) -> None:
    """The camera, its vertical aperture following the image."""
    scene.set_camera(
        path="/camera",
        camera_to_world=camera.camera_to_world,
        focal_length=camera.focal_length,
        horizontal_aperture=camera.aperture,
        vertical_aperture=camera.aperture * height / width,
        horizontal_aperture_offset=camera.offset[0],
        vertical_aperture_offset=camera.offset[1],
        f_stop=camera.f_stop,
        focus_distance=camera.focus_distance,
        clipping_range=camera.clipping_range,
        exposure_scale=camera.exposure_scale,
    )


def build(stage: Stage, width: int = 32, height: int = 32) -> tuple[Any, dict[str, str]]:
    """The scene in the core, and the reasons it gave for leaving lights out, by path."""
    scene = footlight_core.Scene()
    set_camera(scene, stage.camera, width, height)
    for k, mesh in enumerate(stage.meshes):
        prototype = add_mesh(scene, f"/mesh_{k}", mesh)
        scene.add_instances(
            path=f"/mesh_{k}",
            meshes=[prototype],
            local_transforms=np.eye(4)[None].copy(),
            transforms=np.ascontiguousarray(mesh.transforms),
        )
    reasons = {}
    for k, light in enumerate(stage.lights):
        reasons[f"/light_{k}"] = add_light(scene, f"/light_{k}", light)
    for k, mesh in enumerate(stage.unused):
        add_mesh(scene, f"/unused_{k}", mesh)
    return scene, reasons


def renderer(stage: Stage, *, width: int = 32, height: int = 32, **options: Any) -> Any:
    """A renderer with a one-pixel box filter unless told otherwise."""
    options = {"pixel_filter": "box", "filter_width": 1.0, "max_depth": stage.max_depth, "threads": 2} | options
    scene, _ = build(stage, width, height)
    return footlight_core.Renderer(scene, footlight_core.RenderOptions(width=width, height=height, **options))


def guards(render: Any) -> dict[str, int]:
    """The guard counters that fired."""
    fired: dict[str, int] = {k: v for k, v in render.stats()["guards"].items() if v}
    return fired


def run(stage: Stage, *, spp: int = 16, **options: Any) -> Any:
    """A renderer that has rendered all of its tiles, without one guard having fired."""
    result = renderer(stage, **options)
    assert result.render(0, spp, 0, result.tiles)
    assert guards(result) == {}, "a guard fired"
    return result


def image(stage: Stage, **options: Any) -> Points:
    """The colour (H, W, 3) of a render."""
    pixels: Points = run(stage, **options).read("color")
    assert np.isfinite(pixels).all()
    return pixels


def replicates(stage: Stage, count: int, seed: int = 1, **options: Any) -> Array:
    """Independent renders (count, H, W, 3)."""
    return np.stack([image(stage, seed=seed + k, **options) for k in range(count)]).astype(np.float64)


# --- the scenes every law is tried on ---

SUITE: dict[str, Callable[[], Stage]] = {}


def in_suite(make: Callable[[], Stage]) -> Callable[[], Stage]:
    """Adds a scene to the suite under its function's name."""
    SUITE[make.__name__] = make
    return make


@in_suite
def room() -> Stage:
    """Diffuse interreflection in a closed room: one rect light, two blocks, one of them turned."""
    wall = Material((0.7, 0.65, 0.6))
    return Stage(
        Camera(look_at((0.0, 0.125, 0.9375), (0.0, 0.0, -1.0)), focal_length=24.0),
        (
            box(wall, inwards=True),
            box(
                Material((0.6, 0.1, 0.1)),
                **at(scale(0.25, 0.5, 0.25), rotate("y", 20), translate(-0.375, -0.5, -0.375)),
            ),
            box(Material((0.1, 0.3, 0.6)), **at(scale(0.25), translate(0.375, -0.75, 0.125))),
        ),
        (rect(chain(rotate("x", -90), translate(0.0, 0.96875, 0.0)), 0.5, 0.375, (9.0, 8.0, 6.0)),),
    )


@in_suite
def gallery() -> Stage:
    """Metals from mirror to rough, a dielectric and a coat, under a sphere, a disk and a constant dome."""
    materials = (
        Material((0.9, 0.7, 0.3), metallic=1.0, roughness=0.0),
        Material((0.9, 0.7, 0.3), metallic=1.0, roughness=0.3),
        Material((0.2, 0.4, 0.8), roughness=0.5, ior=1.5),
        Material((0.6, 0.1, 0.1), roughness=0.6, ior=1.5, clearcoat=1.0, clearcoat_roughness=0.2),
    )
    balls = tuple(
        sphere(m, smooth=k % 2 == 0, **at(scale(0.5), translate(1.125 * k - 1.6875, 0.5, 0.0)))
        for k, m in enumerate(materials)
    )
    floor = quad((-4, 0, 4), (8, 0, 0), (0, 0, -8), Material((0.4, 0.4, 0.4)))
    return Stage(
        Camera(look_at((0.0, 1.5, 4.5), (0.0, 0.5, 0.0)), focal_length=36.0, offset=(1.5, -1.0)),
        (*balls, floor),
        (
            bulb(translate(-1.5, 2.5, 1.0), 0.25, (8.0, 6.0, 4.0)),
            disk(chain(rotate("x", -60), translate(1.5, 2.0, 1.5)), 0.5, (3.0, 4.0, 6.0), normalize=True),
            dome((0.1, 0.12, 0.15)),
        ),
    )


def sky_image(width: int = 64, height: int = 32) -> Array:
    """A smooth sky with a bright spot of a few texels."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    base = 0.3 + 0.5 * (1 - v) + 0.1 * np.sin(4 * math.pi * u) * np.sin(math.pi * v)
    spot = 40.0 * np.exp(-(((u - 0.3) * 2 * width) ** 2 + ((v - 0.25) * 2 * height) ** 2) / 8)
    return np.stack([base + spot, base + 0.8 * spot, 1.2 * base + 0.5 * spot], -1)


@in_suite
def sky() -> Stage:
    """A textured, turned dome and a distant light with an angle over smooth balls."""
    return Stage(
        Camera(look_at((0.0, 1.5, 4.5), (0.0, 0.5, 0.0)), focal_length=36.0),
        (
            sphere(Material((0.7, 0.5, 0.3)), smooth=True, **at(scale(0.75), translate(-0.875, 0.75, 0.0))),
            sphere(
                Material((0.9, 0.9, 0.9), metallic=1.0, roughness=0.25), **at(scale(0.75), translate(0.875, 0.75, 0.0))
            ),
            quad((-4, 0, 4), (8, 0, 0), (0, 0, -8), Material((0.4, 0.45, 0.4))),
        ),
        (
            dome((0.5, 0.5, 0.5), sky_image(), rotate("y", 30)),
            sun(chain(rotate("x", -50), rotate("y", 30)), 4.0, (30.0, 25.0, 20.0)),
        ),
    )


@in_suite
def orchard() -> Stage:
    """Instances at several scales and one mirrored, half-transparent cards, vertex colours, a cylinder light."""
    placed = [
        chain(scale(2.0**-k), rotate("y", 40 * k), translate(-1.5 + 0.75 * k, 2.0**-k, 0.5 - 0.25 * k))
        for k in range(5)
    ]
    placed.append(chain(scale(-0.5, 0.25, 0.5), rotate("z", 30), translate(0.5, 0.5, 1.0)))
    tree = sphere(Material((0.5, 0.5, 0.5), diffuse_from_primvar=True), 16, 8)
    colours = (0.2 + 0.6 * np.abs(tree.points)).astype(np.float32)
    card = quad((-0.5, 0, 0), (1, 0, 0), (0, 1, 0), Material((0.8, 0.6, 0.2), opacity=0.5))
    return Stage(
        Camera(look_at((0.0, 1.5, 4.5), (0.0, 0.5, 0.0)), focal_length=36.0),
        (
            replace(tree, colors=colours, transforms=np.stack(placed)),
            replace(card, transforms=np.stack([translate(1.0, 0.0, 1.5), translate(1.25, 0.0, 1.0)])),
            quad((-4, 0, 4), (8, 0, 0), (0, 0, -8), Material((0.4, 0.4, 0.4))),
        ),
        (
            tube(chain(rotate("y", 20), translate(0.0, 2.5, 0.5)), 0.0625, 2.0, (6.0, 5.0, 4.0)),
            dome((0.05, 0.06, 0.08)),
        ),
    )


@in_suite
def lens() -> Stage:
    """A thin lens, a distant light without angle, a glowing ball and a rect light whose other side is dark."""
    return Stage(
        Camera(look_at((0.0, 1.5, 4.5), (0.0, 0.5, 0.0)), 36.0, f_stop=8.0, focus_distance=4.5),
        (
            sphere(Material((0.6, 0.5, 0.4)), smooth=True, **at(scale(0.5), translate(-0.75, 0.5, 1.0))),
            sphere(
                Material((0.3, 0.3, 0.3), emissive_color=(2.0, 1.0, 0.5)),
                **at(scale(0.375), translate(0.75, 0.5, -0.5)),
            ),
            quad((-4, 0, 4), (8, 0, 0), (0, 0, -8), Material((0.4, 0.4, 0.4))),
        ),
        (
            sun(chain(rotate("x", -60), rotate("y", -20)), 0.0, (1.5, 1.4, 1.2), normalize=True),
            rect(chain(rotate("y", -90), translate(-2.0, 1.0, 0.0)), 1.0, 1.0, (4.0, 4.0, 5.0)),
        ),
    )
