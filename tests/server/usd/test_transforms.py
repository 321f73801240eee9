"""Laws of place: transforms with pivots and resets, visibility, purpose, native instances and point instancers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Gf, Usd, UsdGeom, Vt

from footlight_server.usd import Budget, StageLimitError, TranslateRequest
from tests.server.usd.capture import CapturingSink
from tests.server.usd.stages import reasons, stage_of, translated, translated_text

POINT = """int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    uniform token subdivisionScheme = "none"
"""
CLASS = '\nclass Xform "Source" {\n def Mesh "m" {\n' + POINT + " }\n }\n"


def origins(sink: CapturingSink) -> list[tuple[float, ...]]:
    """Where point 0 of every placed mesh is, sorted."""
    return sorted(tuple(np.round(matrix[3, :3], 9).tolist()) for _, matrix in sink.placed())


@given(st.lists(st.floats(-5, 5), min_size=12, max_size=12), st.booleans(), st.booleans())
@settings(max_examples=30, deadline=None)
def test_hierarchies_place_as_usd_says(values: list[float], reset: bool, mirror: bool) -> None:
    stage = Usd.Stage.CreateInMemory()
    top = UsdGeom.Xform.Define(stage, "/a")
    top.AddTranslateOp().Set(Gf.Vec3d(*values[:3]))
    top.AddScaleOp().Set(Gf.Vec3f(-1 if mirror else 1, 2, 3))
    middle = UsdGeom.Xform.Define(stage, "/a/b")
    middle.AddTranslateOp(opSuffix="pivot").Set(Gf.Vec3d(*values[3:6]))
    middle.AddRotateXYZOp().Set(Gf.Vec3f(*values[6:9]) * 30)
    middle.AddTranslateOp(opSuffix="pivot", isInverseOp=True)
    middle.SetResetXformStack(reset)
    mesh = UsdGeom.Mesh.Define(stage, "/a/b/m")
    mesh.AddTransformOp().Set(Gf.Matrix4d().SetTranslate(Gf.Vec3d(*values[9:12])))
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    mesh.CreateSubdivisionSchemeAttr("none")
    sink, _ = translated(stage)
    [(_, matrix)] = sink.placed()
    wanted = np.array(UsdGeom.XformCache(0.0).GetLocalToWorldTransform(mesh.GetPrim()))
    assert matrix == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(
    "op",
    [
        "float3 xformOp:scale = (1, 1, 0)",
        "float3 xformOp:scale = (0, 0, 0)",
        "float3 xformOp:scale = (nan, 1, 1)",
        "float3 xformOp:scale = (inf, 1, 1)",
    ],
)
def test_singular_transforms_leave_out_what_is_below_and_nothing_else(op: str) -> None:
    """G18: the image is the one without the prim."""
    order = 'uniform token[] xformOpOrder = ["xformOp:scale"]'
    text = f'def Xform "bad" {{\n {op}\n {order}\n def Mesh "m" {{\n {POINT} }}\n }}'
    good = f'\ndef Mesh "good" {{\n {POINT} }}'
    sink, report = translated_text(text + good)
    assert [mesh["path"] for mesh, _ in sink.placed()] == ["/good"]
    assert "/bad Xform: its transform is" in reasons(report)


@pytest.mark.parametrize(("last", "is_singular"), [((7, 8, 9), True), ((7, 8, 10), False)])
def test_flat_matrices_without_zeros_are_singular(last: tuple[int, ...], is_singular: bool) -> None:
    stage = stage_of(f'def Mesh "m" {{\n {POINT} }}')
    matrix = Gf.Matrix4d(1, 2, 3, 0, 4, 5, 6, 0, *last, 0, 0, 0, 0, 1)
    UsdGeom.Xformable(stage.GetPrimAtPath("/m")).AddTransformOp().Set(matrix)
    assert bool(translated(stage)[0].placed()) != is_singular


def test_visibility_and_purpose() -> None:
    text = f"""
    def Xform "hidden" {{
        token visibility = "invisible"
        def Mesh "m" {{ {POINT} token visibility = "inherited"
        }}
    }}
    def Xform "proxy" {{
        uniform token purpose = "proxy"
        def Mesh "m" {{ {POINT} }}
        def Mesh "own" {{ {POINT} uniform token purpose = "render"
        }}
    }}
    def Mesh "guide" {{ {POINT} uniform token purpose = "guide"
    }}
    over Mesh "over" {{ {POINT} }}
    class Mesh "class" {{ {POINT} }}
    def Mesh "inactive" (active = false) {{ {POINT} }}
    def Mesh "shown" {{ {POINT} }}
    """
    sink, report = translated_text(text)
    assert [mesh["path"] for mesh in sink.meshes] == ["/proxy/own", "/shown"]
    assert any("2 prims have another purpose" in note.message for note in report.notes)
    sink, _ = translated_text(text, TranslateRequest(purposes=("proxy", "guide")))
    assert [mesh["path"] for mesh in sink.meshes] == ["/proxy/m", "/guide", "/shown"]


def instance(name: str, x: int, extra: str = "", source: str = "/Source") -> str:
    return f"""
    def Xform "{name}" (
        instanceable = true
        references = <{source}>
    ) {{
        double3 xformOp:translate = ({x}, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {extra}
    }}
    """


def test_instances_share_one_mesh_nested_ones_too() -> None:
    pair = '\nclass Xform "Pair" {\n' + instance("one", 1) + instance("two", 2) + "}\n"
    text = CLASS + pair + instance("a", 10, source="/Pair") + instance("b", 20, source="/Pair") + instance("c", 5)
    sink, report = translated_text(text)
    assert len(sink.meshes) == 1
    [group] = sink.instances
    assert origins(sink) == [(5, 0, 0), (11, 0, 0), (12, 0, 0), (21, 0, 0), (22, 0, 0)]
    assert len(group.transforms) == 5
    assert report.counts["triangles"] == 1
    assert report.counts["instances"] == 7  # two of Pair, four in them, one alone


def test_instances_that_inherit_differently_do_not_share() -> None:
    """arnold-usd#944: displayColor on the instance."""
    red, blue = ("color3f[] primvars:displayColor = [(1,0,0)]", "color3f[] primvars:displayColor = [(0,0,1)]")
    text = CLASS + instance("a", 0, red) + instance("b", 1, blue) + instance("c", 2, red)
    sink, _ = translated_text(text)
    assert sorted(len(group.transforms) for group in sink.instances) == [1, 2]
    assert sorted(tuple(mesh["colors"][0]) for mesh in sink.meshes) == [(0, 0, 1), (1, 0, 0)]


INSTANCER = """
def PointInstancer "pi" {
    rel prototypes = [</pi/p/A>, </pi/p/B>]
    int[] protoIndices = [0, 1, 0, 1]
    point3f[] positions = [(1,0,0), (2,0,0), (3,0,0), (4,0,0)]
    %s
    over "p" {
        def Xform "A" {
            def Mesh "m" { POINT }
        }
        def Mesh "B" { POINT
            double3 xformOp:translate = (0, 10, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
    }
}
""".replace("POINT", POINT)


def test_point_instancers_place_their_prototypes() -> None:
    sink, report = translated_text(INSTANCER % "")
    assert not report.left_out
    assert len(sink.meshes) == 2
    assert origins(sink) == [(1, 0, 0), (2, 10, 0), (3, 0, 0), (4, 10, 0)]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("int64[] invisibleIds = [1, 2]", [1, 4]),
        ("int64[] ids = [7, 8, 9, 10]\n int64[] invisibleIds = [8, 9, 1]", [1, 4]),
        ("int64[] ids = [7, 8]\n int64[] invisibleIds = [8]", [1, 2, 3, 4]),
    ],
)
def test_masks(text: str, wanted: list[int]) -> None:
    sink, _ = translated_text(INSTANCER % text)
    assert [x for x, _, _ in origins(sink)] == wanted


def test_inactive_ids() -> None:
    stage = stage_of(INSTANCER % "")
    UsdGeom.PointInstancer(stage.GetPrimAtPath("/pi")).DeactivateIds([0, 3])
    sink, _ = translated(stage)
    assert [x for x, _, _ in origins(sink)] == [2, 3]


@pytest.mark.parametrize("precise", [False, True])
def test_instancer_transforms_are_usds(precise: bool) -> None:
    random = np.random.default_rng(3)
    stage = stage_of(INSTANCER % "")
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/pi"))
    instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(random.uniform(0.5, 2, (4, 3)).astype(np.float32)))
    quaternions = random.normal(size=(4, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    if precise:
        instancer.CreateOrientationsfAttr([Gf.Quatf(*q) for q in quaternions.tolist()])
    else:
        instancer.CreateOrientationsAttr([Gf.Quath(*q) for q in quaternions.tolist()])
    UsdGeom.Xformable(instancer).AddRotateXYZOp().Set(Gf.Vec3f(10, 20, 30))
    sink, _ = translated(stage)
    local = np.array(instancer.ComputeInstanceTransformsAtTime(0.0, 0.0))
    world = np.array(UsdGeom.XformCache(0.0).GetLocalToWorldTransform(instancer.GetPrim()))
    wanted = sorted((local @ world).reshape(-1, 16).tolist())
    got = sorted(matrix.reshape(16).tolist() for _, matrix in sink.placed())
    assert np.array(got) == pytest.approx(np.array(wanted), abs=2e-3 if not precise else 1e-6)


@pytest.mark.parametrize(
    ("attribute", "value", "kept", "reason"),
    [
        ("positions", [(1, 0, 0)], [], "positions has 1 entries for 4 instances"),
        ("positions", [], [], "has no positions"),
        ("positions", [(1, 0, 0), (2, 0, 0), (float("nan"), 0, 0), (4, 0, 0)], [1, 2, 4], "not finite, the first is 2"),
        ("protoIndices", [0, 1, 2, -1], [1, 2], "2 of 4 instances have outside [0, 2), the first is 2"),
        ("protoIndices", [], [], "has no protoIndices"),
        (
            "scales",
            [(1, 1, 1), (0, 1, 1), (1, 1, 1), (1, 1, 1)],
            [1, 3, 4],
            "singular transform (determinant 0), the first is 1",
        ),
        ("scales", [(1, 1, 1)], [], "scales has 1 entries"),
        ("orientations", [Gf.Quath(1)] * 3, [], "orientations has 3 entries"),
    ],
)
def test_bad_instances_are_left_out_and_the_others_stay(
    attribute: str, value: object, kept: list[int], reason: str
) -> None:
    stage = stage_of(INSTANCER % "float3[] scales = []\n quath[] orientations = []")
    stage.GetPrimAtPath("/pi").GetAttribute(attribute).Set(value)
    sink, report = translated(stage)
    assert [x for x, _, _ in origins(sink)] == kept
    assert reason in reasons(report)


def test_instancers_nest() -> None:
    text = (
        'def PointInstancer "outer" {\n rel prototypes = [</pi>]\n int[] protoIndices = [0, 0]\n'
        "point3f[] positions = [(100, 0, 0), (200, 0, 0)]\n }\n"
    )
    sink, _ = translated_text(INSTANCER % "" + text)
    xs = [x for x, _, _ in origins(sink)]
    assert xs == [1, 2, 3, 4, 101, 102, 103, 104, 201, 202, 203, 204]  # /pi stands on the stage, too
    assert len(sink.meshes) == 2  # shared by all of them


def test_prototypes_inside_themselves_end() -> None:
    sink, report = translated_text(
        'def PointInstancer "pi" {\n rel prototypes = [</pi>]\n int[] protoIndices = [0]\n'
        "point3f[] positions = [(0,0,0)]\n }"
    )
    assert not sink.meshes
    assert "is placed inside itself" in reasons(report)


def test_missing_prototypes_are_named() -> None:
    sink, report = translated_text(INSTANCER.replace("</pi/p/B>", "</nowhere>") % "")
    assert [x for x, _, _ in origins(sink)] == [1, 3]
    assert "/pi prototypes: /nowhere is not on the stage" in reasons(report)


def test_instance_bombs_are_refused_with_the_path() -> None:
    text = CLASS
    source = "/Source"
    for level in range(8):
        text += f'class Xform "L{level}" {{\n' + "".join(instance(f"i{i}", i, source=source) for i in range(10)) + "}\n"
        source = f"/L{level}"
    with pytest.raises(StageLimitError, match=r"instances, allowed are 1000000"):
        translated_text(text + instance("bomb", 0, source=source), TranslateRequest(budget=Budget(instances=1_000_000)))


def test_nested_instances_are_where_usd_says() -> None:
    """Rotations and scales do not commute: inner before outer."""

    def turned(name: str, source: str, angle: int) -> str:
        ops = '["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]'
        return f"""
        def Xform "{name}" (
            instanceable = true
            references = <{source}>
        ) {{
            double3 xformOp:translate = ({angle}, 1, 2)
            float3 xformOp:rotateXYZ = ({angle}, 20, {3 * angle})
            float3 xformOp:scale = (1, 2, 0.5)
            uniform token[] xformOpOrder = {ops}
        }}
        """

    pair = '\nclass Xform "Pair" {\n' + turned("one", "/Source", 10) + turned("two", "/Source", 40) + "}\n"
    stage = stage_of(CLASS + pair + turned("a", "/Pair", 25) + turned("b", "/Pair", -70))
    sink, _ = translated(stage)
    cache = UsdGeom.XformCache(0.0)
    meshes = [p for p in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()) if p.IsA(UsdGeom.Mesh)]
    wanted = sorted(np.array(cache.GetLocalToWorldTransform(prim)).reshape(16).tolist() for prim in meshes)
    assert len(wanted) == 4
    got = sorted(matrix.reshape(16).tolist() for _, matrix in sink.placed())
    assert np.array(got) == pytest.approx(np.array(wanted), abs=1e-12)
