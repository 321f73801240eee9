"""Laws of the implicit shapes: sizes, axes, closed surfaces that face outward, normals that belong to the surface."""

import math

import numpy as np
import pytest

from footlight_server.usd import shapes
from tests.server.usd.capture import corners, face_normals, to_world
from tests.server.usd.stages import reasons, translated_text

# Prim, its extent along X, Y and Z, and its volume; lengths differ so that axes cannot be confused.
SOLIDS = [
    ('Sphere "s" { double radius = 3 }', (6, 6, 6), 4 / 3 * math.pi * 27),
    ('Cube "s" { double size = 3 }', (3, 3, 3), 27),
    ('Cylinder "s" { double radius = 2\n double height = 7 }', (4, 4, 7), 28 * math.pi),
    ('Cylinder "s" { double radius = 2\n double height = 7\n uniform token axis = "X" }', (7, 4, 4), 28 * math.pi),
    ('Cylinder_1 "s" { double radiusTop = 1\n double radiusBottom = 2\n double height = 3 }', (4, 4, 3), 7 * math.pi),
    ('Cone "s" { double radius = 2\n double height = 6\n uniform token axis = "Y" }', (4, 6, 4), 8 * math.pi),
    ('Capsule "s" { double radius = 1\n double height = 4 }', (2, 2, 6), (4 + 4 / 3) * math.pi),
    (
        'Capsule "s" { double radius = 1\n double height = 4\n uniform token axis = "X" }',
        (6, 2, 2),
        (4 + 4 / 3) * math.pi,
    ),
    (
        'Capsule_1 "s" { double radiusTop = 1\n double radiusBottom = 1\n double height = 4 }',
        (2, 2, 6),
        (4 + 4 / 3) * math.pi,
    ),
]


@pytest.mark.parametrize(("prim", "size", "volume"), SOLIDS)
def test_solids_have_their_size_and_volume_and_face_outward(prim: str, size: tuple[float, ...], volume: float) -> None:
    sink, report = translated_text("def " + prim)
    assert not report.left_out
    [(mesh, matrix)] = sink.placed()
    points = to_world(mesh["points"], matrix)
    assert np.ptp(points, axis=0) == pytest.approx(size, rel=1e-6)
    assert points.min(axis=0) == pytest.approx(-points.max(axis=0), rel=1e-6)
    a, b, c = np.moveaxis(points[mesh["triangles"]], 1, 0)
    signed = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
    assert signed == pytest.approx(volume, rel=2e-3)  # closed, and counter-clockwise from outside
    assert signed <= volume * (1 + 1e-6)


@pytest.mark.parametrize("prim", [p for p, _, _ in SOLIDS])
def test_normals_belong_to_the_faces(prim: str) -> None:
    sink, _ = translated_text("def " + prim)
    mesh = sink.meshes[0]
    normals = corners(mesh, "normals", "normal_indices")
    assert np.linalg.norm(normals, axis=2) == pytest.approx(1.0, abs=1e-6)
    faces = face_normals(mesh)
    faces /= np.linalg.norm(faces, axis=1, keepdims=True)
    # A facet spans at most 1/64 of half a turn; its plane is that close to the true tangent planes at its corners.
    assert np.einsum("ti,tki->tk", faces, normals).min() > math.cos(math.pi / 64)


def test_tapered_capsules_are_smooth_where_the_caps_meet_the_side() -> None:
    shape = shapes.capsule(3.0, 0.25, 1.0)
    profile = shape.points.reshape(-1, shapes.AROUND, 3)[:, 0]
    direction = np.diff(profile[:, [0, 2]], axis=0)
    angles = np.arctan2(direction[:, 1], direction[:, 0])[np.linalg.norm(direction, axis=1) > 1e-6]
    assert np.abs(np.diff(angles)).max() < 1.5 * math.pi / 64
    # The side runs from radius 1 to 1/4; the caps are tangent to it there.
    assert np.abs(profile - [1.0, 0.0, -1.5]).max(axis=1).min() < 1e-6
    assert np.abs(profile - [0.25, 0.0, 1.5]).max(axis=1).min() < 1e-6


@pytest.mark.parametrize(("axis", "size"), [("X", (0, 5, 3)), ("Y", (3, 0, 5)), ("Z", (3, 5, 0))])
def test_planes_lie_across_their_axis(axis: str, size: tuple[float, ...]) -> None:
    sink, _ = translated_text(
        f'def Plane "s" {{ double width = 3\n double length = 5\n uniform token axis = "{axis}" }}'
    )
    [(mesh, matrix)] = sink.placed()
    points = to_world(mesh["points"], matrix)
    assert np.ptp(points, axis=0) == pytest.approx(size, abs=1e-12)
    assert np.cross(*(points[mesh["triangles"][0]][1:] - points[0]))["XYZ".index(axis)] > 0


def test_equal_shapes_share_a_mesh_and_different_looks_do_not() -> None:
    sink, report = translated_text(
        "\n".join(
            f'def Sphere "s{i}" {{ double radius = {i + 1}\n color3f[] primvars:displayColor = [({i % 2}, 0, 0)] }}'
            for i in range(20)
        )
    )
    assert len(sink.meshes) == 2
    assert [len(group.transforms) for group in sink.instances] == [10, 10]
    assert report.counts["triangles"] == 2 * len(shapes.sphere().triangles)


def test_left_handed_shapes_turn_over() -> None:
    right, _ = translated_text('def Sphere "s" { }')
    left, _ = translated_text('def Sphere "s" { uniform token orientation = "leftHanded" }')
    assert np.array_equal(face_normals(left.meshes[0]), -face_normals(right.meshes[0]))
    assert np.array_equal(left.meshes[0]["normals"], -right.meshes[0]["normals"])


@pytest.mark.parametrize(
    ("prim", "reason"),
    [
        ('Sphere "s" { double radius = 0 }', "radius = 0 is not above 0"),
        ('Sphere "s" { double radius = nan }', "radius = nan is not a finite number"),
        ('Cube "s" { double size = -1 }', "size = -1 is not above 0"),
        ('Capsule "s" { double height = -1 }', "height = -1 is negative"),
        ('Cylinder_1 "s" { double radiusTop = -1 }', "radiusTop = -1"),
        ('Cone "s" { double height = inf }', "height = inf is not a finite number"),
    ],
)
def test_bad_sizes_are_left_out(prim: str, reason: str) -> None:
    sink, report = translated_text("def " + prim + '\ndef Cube "good" { }')
    assert [mesh["path"] for mesh in sink.meshes] == ["/good"]
    assert reason in reasons(report)


def test_colors_per_point_of_a_shape_are_left_out() -> None:
    sink, report = translated_text(
        'def Sphere "s" { color3f[] primvars:displayColor = [(1,0,0), (0,1,0)] (interpolation = "vertex") }'
    )
    assert sink.meshes[0]["colors"] is None
    assert "2 entries (vertex): an implicit shape can use one" in reasons(report)
