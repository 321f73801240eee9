"""Laws of subdivision surfaces as USD describes them; the surface itself is tested in tests/core/subdiv."""

import numpy as np
import pytest

from footlight_server.usd import TranslateRequest
from footlight_server.usd.prims.subdivision import AUTOMATIC_QUADS, choose_level
from tests.server.usd.capture import area, corners, face_normals
from tests.server.usd.stages import reasons, translated_text

CUBE = """
def Mesh "m" {
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0,3,2,1, 4,5,6,7, 0,1,5,4, 3,7,6,2, 0,4,7,3, 1,2,6,5]
    point3f[] points = [(-1,-1,-1), (1,-1,-1), (1,1,-1), (-1,1,-1), (-1,-1,1), (1,-1,1), (1,1,1), (-1,1,1)]
    %s
}
"""
LEVEL_2 = TranslateRequest(refinement=2)


def test_cubes_become_round_and_keep_facing_outward() -> None:
    sink, report = translated_text(CUBE % "")
    mesh = sink.meshes[0]
    radii = np.linalg.norm(mesh["points"], axis=1)
    assert radii.max() / radii.min() < 1.12
    normals = corners(mesh, "normals", "normal_indices")
    assert (np.einsum("ti,tki->tk", face_normals(mesh), normals) > 0).all()
    assert (np.einsum("tki,tki->tk", mesh["points"][mesh["triangles"]], normals) > 0).all()
    [effect] = report.effects
    assert effect.name == "subdivision"
    assert effect.paths == ("/m",)
    assert "level 4" in effect.reason


def test_left_handed_cages_turn_over() -> None:
    right, _ = translated_text(CUBE % "", LEVEL_2)
    left, _ = translated_text(CUBE % 'uniform token orientation = "leftHanded"', LEVEL_2)
    a, b = right.meshes[0], left.meshes[0]
    assert np.array_equal(a["points"], b["points"])
    assert np.array_equal(face_normals(a), -face_normals(b))
    assert np.array_equal(
        corners(a, "normals", "normal_indices"), -corners(b, "normals", "normal_indices")[:, [0, 2, 1]]
    )


def test_level_zero_is_the_cage_and_schemes_differ() -> None:
    cage, report = translated_text(CUBE % "", TranslateRequest(refinement=0))
    assert area(cage.meshes[0]) == pytest.approx(24.0)
    assert not report.effects
    none, _ = translated_text(CUBE % 'uniform token subdivisionScheme = "none"')
    assert np.array_equal(none.meshes[0]["triangles"], cage.meshes[0]["triangles"])


@pytest.mark.parametrize("corners_of_cage", [3, 24, 5000, 20_000, 20_001, 10_000_000])
def test_the_automatic_level_keeps_to_its_limit(corners_of_cage: int) -> None:
    level, _ = choose_level(corners_of_cage, None)
    assert 1 <= level <= 4
    assert level == 1 or corners_of_cage * 4 ** (level - 1) <= AUTOMATIC_QUADS
    assert level == 4 or corners_of_cage * 4**level > AUTOMATIC_QUADS


def test_sharp_creases_keep_the_cube() -> None:
    text = """
    int[] creaseIndices = [0,1,2,3,0, 4,5,6,7,4, 0,4, 1,5, 2,6, 3,7]
    int[] creaseLengths = [5, 5, 2, 2, 2, 2]
    float[] creaseSharpnesses = [10, 10, 10, 10, inf, 10]
    """
    sink, report = translated_text(CUBE % text, LEVEL_2)
    assert not report.left_out
    assert area(sink.meshes[0]) == pytest.approx(24.0, rel=1e-5)
    normals = corners(sink.meshes[0], "normals", "normal_indices")
    assert np.abs(normals).max(axis=2) == pytest.approx(1.0, abs=1e-6)


def test_holes_are_gone() -> None:
    whole, _ = translated_text(CUBE % "", LEVEL_2)
    holed, _ = translated_text(CUBE % "int[] holeIndices = [1, 3]", LEVEL_2)
    assert len(holed.meshes[0]["triangles"]) == len(whole.meshes[0]["triangles"]) * 4 // 6


@pytest.mark.parametrize(
    ("interpolation", "count"), [("constant", 1), ("uniform", 6), ("vertex", 8), ("varying", 8), ("faceVarying", 24)]
)
def test_colors_follow(interpolation: str, count: int) -> None:
    # Colours that are a linear function of the cage's points, where they have a point.
    points_of_corners = [0,3,2,1, 4,5,6,7, 0,1,5,4, 3,7,6,2, 0,4,7,3, 1,2,6,5]  # fmt: skip
    at = {"vertex": range(8), "varying": range(8), "faceVarying": points_of_corners}
    cage = np.array([(-1,-1,-1), (1,-1,-1), (1,1,-1), (-1,1,-1), (-1,-1,1), (1,-1,1), (1,1,1), (-1,1,1)])  # fmt: skip
    values = (
        (cage[list(at[interpolation])] + 2) / 4 if interpolation in at else np.arange(3 * count).reshape(-1, 3) / 64
    )
    text = ", ".join(f"({r}, {g}, {b})" for r, g, b in values.tolist())
    sink, report = translated_text(
        CUBE % f'color3f[] primvars:displayColor = [{text}] (interpolation = "{interpolation}")', LEVEL_2
    )
    assert not report.left_out
    mesh = sink.meshes[0]
    got = corners(mesh, "colors", "color_indices")
    if interpolation == "vertex":  # the same weights as the points
        assert got == pytest.approx((mesh["points"][mesh["triangles"]] + 2) / 4, abs=1e-6)
    elif interpolation in ("constant", "uniform"):
        assert len(np.unique(got.reshape(-1, 3), axis=0)) == count
    else:
        assert got.min() == pytest.approx(0.25, abs=1e-6)
        assert got.max() == pytest.approx(0.75, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("int[] cornerIndices = [8]\n float[] cornerSharpnesses = [10]", "cornerIndices[0] = 8 is outside [0, 8)"),
        ("int[] cornerIndices = [1]\n float[] cornerSharpnesses = [nan]", "cornerSharpnesses[0] is negative or not"),
        ("int[] creaseIndices = [0, 1]\n int[] creaseLengths = [3]\n float[] creaseSharpnesses = [1]", "add up to 3"),
        ("int[] creaseIndices = [0, 1]\n int[] creaseLengths = [2]\n float[] creaseSharpnesses = []", "has 0 entries"),
        ("int[] creaseIndices = [0]\n int[] creaseLengths = [1]\n float[] creaseSharpnesses = [1]", "is below 2"),
        ("int[] holeIndices = [6]", "holeIndices[0] = 6"),
        ('color3f[] primvars:displayColor = [(1,0,0)] (interpolation = "vertex")', "has 1 entries, the mesh needs 8"),
    ],
)
def test_bad_values_leave_the_smooth_surface(text: str, reason: str) -> None:
    plain, _ = translated_text(CUBE % "", LEVEL_2)
    sink, report = translated_text(CUBE % text, LEVEL_2)
    assert reason in reasons(report)
    assert np.array_equal(sink.meshes[0]["points"], plain.meshes[0]["points"])


def test_loop_needs_triangles() -> None:
    sink, report = translated_text(CUBE % 'uniform token subdivisionScheme = "loop"')
    assert not sink.meshes
    assert "/m Mesh: subdivide: loop needs triangles" in reasons(report)


def test_faces_without_area_change_nothing() -> None:
    colors = ", ".join(f"({i / 32}, 0, 0)" for i in range(24))
    text = f'int[] holeIndices = [1, 3]\n color3f[] primvars:displayColor = [{colors}] (interpolation = "faceVarying")'
    clean, _ = translated_text(CUBE % text, LEVEL_2)
    # The same with a face of two points and one of one before the last four, their corners' colours red.
    at = colors.split("), ")
    padded = "), ".join([*at[:8], *["(9, 9, 9"] * 3, *at[8:]])
    dirty_text = text.replace(colors, padded).replace("[1, 3]", "[1, 5]")
    cage = CUBE.replace("[4, 4, 4, 4, 4, 4]", "[4, 4, 2, 1, 4, 4, 4, 4]").replace("4,5,6,7, 0", "4,5,6,7, 0,1, 0, 0", 1)
    subset = """
    def GeomSubset "s" {
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [4]
    }
    """
    dirty, report = translated_text(cage % dirty_text, LEVEL_2)
    assert "2 of 8 have fewer than 3 points" in reasons(report)
    assert np.array_equal(clean.meshes[0]["triangles"], dirty.meshes[0]["triangles"])
    assert np.array_equal(
        corners(clean.meshes[0], "colors", "color_indices"), corners(dirty.meshes[0], "colors", "color_indices")
    )
    split, _ = translated_text(cage % (dirty_text + subset), LEVEL_2)
    wanted, _ = translated_text(CUBE % (text + subset.replace("[4]", "[2]")), LEVEL_2)
    assert len(split.meshes) == 2
    assert [area(mesh) for mesh in split.meshes] == [area(mesh) for mesh in wanted.meshes]
    assert np.array_equal(split.meshes[0]["points"], wanted.meshes[0]["points"])
