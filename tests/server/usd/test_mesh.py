"""Laws of meshes: faces of any shape, orientation, normals and primvars of every interpolation, subsets, bad data."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from footlight_server.usd import TranslateRequest
from tests.server.usd.capture import area, corners, face_normals
from tests.server.usd.stages import reasons, stage_of, translated, translated_text

# Four quads around a middle, and a triangle: 10 points, 5 faces, 19 corners.
GRID = """
def Mesh "m" {
    int[] faceVertexCounts = [4, 4, 4, 4, 3]
    int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 7, 6, 4, 5, 8, 7, 6, 7, 9]
    point3f[] points = [(0,0,0), (1,0,0), (2,0,0), (0,1,0), (1,1,0), (2,1,0), (0,2,0), (1,2,0), (2,2,0), (0.5,3,0)]
    uniform token subdivisionScheme = "none"
    %s
}
"""
COUNTS = {"constant": 1, "uniform": 5, "varying": 10, "vertex": 10, "faceVarying": 19}
# For every corner of every face: the number of the element it reads.
FACE_OF_CORNER = np.repeat(np.arange(5), [4, 4, 4, 4, 3])
POINT_OF_CORNER = np.array([0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 7, 6, 4, 5, 8, 7, 6, 7, 9])
ELEMENTS = {
    "constant": np.zeros(19, int),
    "uniform": FACE_OF_CORNER,
    "varying": POINT_OF_CORNER,
    "vertex": POINT_OF_CORNER,
    "faceVarying": np.arange(19),
}
CUTS = np.array([[0, 1, 2], [0, 2, 3]])
CORNERS_OF_TRIANGLES = np.concatenate([CUTS, CUTS + 4, CUTS + 8, CUTS + 12, [[16, 17, 18]]])


def grid(text: str = "") -> Any:
    return stage_of(GRID % text)


@pytest.mark.parametrize("interpolation", COUNTS)
@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize("name", ["displayColor", "displayOpacity", "normals"])
def test_every_interpolation_reads_its_element(interpolation: str, indexed: bool, name: str) -> None:
    stage = grid()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/m"))
    n = COUNTS[interpolation]
    values = np.stack([np.arange(n) / 32.0, np.ones(n), np.arange(n) / 64.0], axis=-1).astype(np.float32)
    indices = (np.arange(n) * 7 + 3) % n if indexed else np.arange(n)
    width = 1 if name == "displayOpacity" else 3
    values = values[:, :width]
    kind = {"displayColor": Sdf.ValueTypeNames.Color3fArray, "normals": Sdf.ValueTypeNames.Normal3fArray}
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        name, kind.get(name, Sdf.ValueTypeNames.FloatArray), interpolation
    )
    primvar.Set(Vt.FloatArray.FromNumpy(values[:, 0].copy()) if width == 1 else Vt.Vec3fArray.FromNumpy(values))
    if indexed:
        primvar.SetIndices(Vt.IntArray.FromNumpy(indices.astype(np.int32)))
    sink, report = translated(stage)
    assert not report.left_out
    got = {
        "displayColor": ("colors", "color_indices"),
        "displayOpacity": ("opacities", "opacity_indices"),
        "normals": ("normals", "normal_indices"),
    }[name]
    wanted = values[indices[ELEMENTS[interpolation][CORNERS_OF_TRIANGLES]]]
    assert np.array_equal(corners(sink.meshes[0], *got), wanted[..., 0] if width == 1 else wanted)


@pytest.mark.parametrize("interpolation", COUNTS)
@pytest.mark.parametrize("off", [-1, 1])
def test_primvars_of_the_wrong_size_are_left_out_alone(interpolation: str, off: int) -> None:
    stage = grid()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/m"))
    primvar = mesh.CreateDisplayColorPrimvar(interpolation)
    primvar.Set(Vt.Vec3fArray([Gf.Vec3f(1, 0, 0)] * (COUNTS[interpolation] + off)))
    sink, report = translated(stage)
    plain, _ = translated(grid())
    assert "/m displayColor: displayColor" in reasons(report)
    assert sink.meshes[0]["colors"] is None
    assert np.array_equal(sink.meshes[0]["triangles"], plain.meshes[0]["triangles"])


def test_left_handed_meshes_turn_over_and_keep_their_normals() -> None:
    right, _ = translated_text(GRID % 'normal3f[] normals = [(0,0,1)] (interpolation = "constant")')
    left, _ = translated_text(
        GRID % 'normal3f[] normals = [(0,0,1)] (interpolation = "constant")\nuniform token orientation = "leftHanded"'
    )
    assert np.array_equal(face_normals(left.meshes[0]), -face_normals(right.meshes[0]))
    assert np.array_equal(left.meshes[0]["normals"], right.meshes[0]["normals"])


@given(st.integers(3, 24), st.integers(0, 2**31), st.sampled_from([(0, 1, 2), (1, 2, 0), (2, 0, 1)]), st.booleans())
@settings(max_examples=60, deadline=None)
def test_any_star_shaped_polygon_is_covered_exactly_once(n: int, seed: int, axes: tuple[int, ...], flip: bool) -> None:
    random = np.random.default_rng(seed)
    angles = (np.arange(n) + random.uniform(0.1, 0.9, n)) * (2 * np.pi / n)
    radii = random.uniform(0.2, 1.0, n)
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(n)], axis=-1)
    if flip:
        outline = outline[::-1]
    x, y = outline[:, 0], outline[:, 1]
    wanted = abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))) / 2
    points = np.ascontiguousarray(np.roll(outline, random.integers(n), axis=0)[:, axes], np.float32)
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/m")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr([n])
    mesh.CreateFaceVertexIndicesAttr(list(range(n)))
    sink, _ = translated(stage)
    normals = face_normals(sink.meshes[0])
    assert len(normals) == n - 2
    # Nothing overlaps and nothing is missing: the areas add up to the polygon's.
    assert area(sink.meshes[0]) == pytest.approx(wanted, rel=1e-4)


def test_faces_without_area_and_unused_points_do_no_harm() -> None:
    text = GRID.replace("[4, 4, 4, 4, 3]", "[4, 4, 4, 4, 3, 2, 1, 0, 3]").replace(
        "6, 7, 9]", "6, 7, 9, 0, 1, 0, 5, 5, 5]"
    )
    sink, report = translated_text(text % "")
    assert "3 of 9 have fewer than 3 points" in reasons(report)
    plain, _ = translated(grid())
    assert np.array_equal(sink.meshes[0]["triangles"][:9], plain.meshes[0]["triangles"])


@pytest.mark.parametrize(
    ("attribute", "value", "reason"),
    [
        ("faceVertexCounts", [4, 4, 4, 4, -3], "faceVertexCounts[4] = -3 is negative"),
        ("faceVertexCounts", [4, 4, 4, 4, 4], "faceVertexCounts add up to 20, faceVertexIndices has 19"),
        ("faceVertexCounts", [2**31 - 1] * 5, "add up to 10737418235"),
        ("faceVertexCounts", [], "add up to 0"),
        ("faceVertexIndices", [0] * 18 + [10], "faceVertexIndices[18] = 10 is outside [0, 10)"),
        ("faceVertexIndices", [0] * 18 + [-1], "faceVertexIndices[18] = -1 is outside [0, 10)"),
        ("faceVertexIndices", [0] * 18 + [2**31 - 1], "faceVertexIndices[18] = 2147483647"),
        (
            "points",
            [Gf.Vec3f(0, 0, 0)] * 9 + [Gf.Vec3f(0, float("nan"), 0)],
            "points[9] is not finite (1 of 10 are not)",
        ),
        ("points", [Gf.Vec3f(0, float("-inf"), 0)] * 10, "points[0] is not finite (10 of 10 are not)"),
        ("points", [], "outside [0, 0)"),
    ],
)
def test_bad_meshes_are_left_out_and_nothing_else(attribute: str, value: list[object], reason: str) -> None:
    stage = stage_of(GRID % "" + (GRID % "").replace('"m"', '"good"'))
    stage.GetPrimAtPath("/m").GetAttribute(attribute).Set(value)
    sink, report = translated(stage)
    assert [mesh["path"] for mesh in sink.meshes] == ["/good"]
    assert len(report.left_out) == 1
    assert report.left_out[0].path == "/m"
    assert reason in report.left_out[0].reason


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('normal3f[] normals = [(0,0,nan)] (interpolation = "constant")', "normals[0] is not finite"),
        (
            'normal3f[] normals = [(0,0,1)] (interpolation = "vertex")',
            "normals (vertex) has 1 entries, the mesh needs 10",
        ),
        ('color3f[] primvars:displayColor = [(inf,0,0)] (interpolation = "constant")', "displayColor[0] is not finite"),
        ('color3f[] primvars:displayColor = [(1,0,0)] (interpolation = "nonsense")', "displayColor"),
        (
            """color3f[] primvars:displayColor = [(1,0,0)] (interpolation = "uniform")
            int[] primvars:displayColor:indices = [0, 0, 1, 0, 0]""",
            "displayColor:indices[2] = 1 is outside [0, 1)",
        ),
        ("int[] holeIndices = [5]", "holeIndices[0] = 5 is outside [0, 5)"),
    ],
)
def test_bad_values_are_left_out_and_the_mesh_stays(text: str, what: str) -> None:
    sink, report = translated_text(GRID % text)
    plain, _ = translated(grid())
    assert what in reasons(report)
    assert np.array_equal(sink.meshes[0]["triangles"], plain.meshes[0]["triangles"])
    assert sink.meshes[0]["normals"] is None
    assert sink.meshes[0]["colors"] is None


INTEGERS = st.lists(st.integers(-2, 12) | st.sampled_from([2**31 - 1, -(2**31)]), max_size=24)


@given(counts=INTEGERS, indices=INTEGERS, holes=INTEGERS, colors=st.integers(0, 24), at=INTEGERS, scheme=st.booleans())
@settings(max_examples=150, deadline=None)
def test_fuzzed_topology_never_breaks_the_contract(
    counts: list[int], indices: list[int], holes: list[int], colors: int, at: list[int], scheme: bool
) -> None:
    """G10: the capturing sink asserts the contract; a mesh is either handed over whole or named in the report."""
    stage = grid()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/m"))
    if sum(c for c in counts if c > 0) > 24:
        indices = (indices * 24)[: min(sum(c for c in counts if c > 0), 400)]
    mesh.GetFaceVertexCountsAttr().Set(counts)
    mesh.GetFaceVertexIndicesAttr().Set(indices)
    mesh.CreateHoleIndicesAttr(holes)
    mesh.GetSubdivisionSchemeAttr().Set("catmullClark" if scheme else "none")
    primvar = mesh.CreateDisplayColorPrimvar("faceVarying")
    primvar.Set([Gf.Vec3f(0.5)] * colors)
    if at:
        primvar.SetIndices(at)
    sink, report = translated(stage)
    holes_only = all(
        line.what in ("faces", "holeIndices", "displayColor", "primvars:displayColor") for line in report.left_out
    )
    assert bool(sink.meshes) or report.left_out or holes
    assert not (sink.meshes and not holes_only)


def test_subsets_split_the_mesh_by_material() -> None:
    stage = stage_of(
        GRID % "color3f[] primvars:displayColor = [(1,0,0), (0,1,0), (0,0,1), (1,1,0), (0,1,1)] "
        '(interpolation = "uniform")'
    )
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/m"))
    red = _material(stage, "/red", (1, 0, 0))
    blue = _material(stage, "/blue", (0, 0, 1))
    api = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    for name, faces, material in (("r", [0, 4], red), ("b", [2, 0], blue), ("bad", [99], blue)):
        subset = api.CreateMaterialBindSubset(name, faces)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    sink, report = translated(stage)
    by_color = {sink.materials[m["material"]]["path"]: m for m in sink.meshes}
    assert {path: area(m) for path, m in by_color.items()} == {"/red": 1.5, "/blue": 1.0, "": 2.0}
    assert "/m/bad GeomSubset: indices[0] = 99 is outside [0, 5)" in reasons(report)
    rest = corners(by_color[""], "colors", "color_indices")
    assert np.array_equal(np.unique(rest.reshape(-1, 3), axis=0), [[0, 1, 0], [1, 1, 0]])
    assert by_color["/red"]["colors"] is None
    assert len(by_color["/red"]["points"]) == 7  # no more than it needs


def test_the_budget_names_the_prim() -> None:
    from footlight_server.usd import Budget, StageLimitError

    with pytest.raises(StageLimitError, match=r"/m: with it the stage has 10 points, allowed are 9"):
        translated(grid(), TranslateRequest(budget=Budget(points=9)))


def test_values_are_read_at_the_time_code() -> None:
    text = (
        GRID.replace("point3f[] points =", "point3f[] points = [(9, 9, 9)]\n    point3f[] points.timeSamples = { 1: ")
        % ""
    )
    text = text.replace(
        "(0.5,3,0)]",
        "(0.5,3,0)], 3: [(0,0,2), (1,0,2), (2,0,2), (0,1,2), (1,1,2), (2,1,2), (0,2,2), (1,2,2), (2,2,2), (0.5,3,2)] }",
    )
    for time, height in ((0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (3.0, 2.0), (9.0, 2.0)):
        sink, report = translated_text(text, TranslateRequest(time_code=time))
        assert report.time_code == time
        assert np.all(sink.meshes[0]["points"][:, 2] == height)


def _material(stage: Any, path: str, color: tuple[float, float, float]) -> Any:
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path + "/s")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(color)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material
