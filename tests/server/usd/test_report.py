"""Laws of the report: nothing is dropped in silence, whatever the stage holds; what is fine leaves no line."""

import pytest
from pxr import Tf, Usd, UsdGeom, UsdLux, UsdSkel, UsdVol

from footlight_server.usd import TranslateRequest, report
from tests.server.usd.stages import reasons, stage_of, translated, translated_text


def drawable_types() -> list[str]:
    """Every concrete type of the installed USD that has bounds or shines."""
    bases = (UsdGeom.Boundable, UsdLux.NonboundableLightBase, UsdVol.Volume, UsdSkel.Root)
    kinds = {kind for base in bases for kind in (Tf.Type.Find(base), *Tf.Type.Find(base).GetAllDerivedTypes())}
    names = {str(Usd.SchemaRegistry.GetSchemaTypeName(kind)) for kind in kinds}
    return sorted(name for name in names if name and Usd.SchemaRegistry().FindConcretePrimDefinition(name))


@pytest.mark.parametrize("kind", drawable_types())
def test_every_type_is_drawn_or_named(kind: str) -> None:
    """An empty prim of every type USD knows: something reaches the sink, or one line says why not."""
    sink, got = translated_text(f'def {kind} "x" {{ }}\n')
    drawn = bool(sink.meshes) or any(light["path"] for _, light in sink.lights)
    named = [line.path for line in got.left_out]
    if kind in ("SkelRoot", "Skeleton"):  # they carry others
        assert not drawn
        assert not named
    else:
        assert named == ([] if drawn else ["/x"])


def test_unknown_types_are_named_and_their_children_drawn() -> None:
    sink, got = translated_text('def Nonsense "x" {\n def Cube "c" { }\n }')
    assert len(sink.meshes) == 1
    assert "/x Nonsense: no schema of that name is known" in reasons(got)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('def Cube "x" {\n rel skel:skeleton = </s> }', "/x skel:skeleton"),
        ('def Xform "x" (\n kind = "component"\n ) {\n uniform token model:drawMode = "cards" }', "/x model:drawMode"),
        ('def PointInstancer "x" { }', "/x PointInstancer: has no prototypes"),
    ],
)
def test_features_that_are_not_rendered_are_named(text: str, line: str) -> None:
    _, got = translated_text(text)
    assert line in reasons(got)


def test_a_plain_stage_leaves_no_line() -> None:
    _, got = translated_text(
        'def Camera "camera" { }\n def Scope "s" { }\n def "untyped" { }\n def DomeLight "d" { }\n'
        'def Material "m" { }\n def Cube "c" {\n double3 xformOp:translate = (0, 0, -9)\n'
        'uniform token[] xformOpOrder = ["xformOp:translate"] }'
    )
    assert not got.left_out
    assert not got.notes


def test_reports_stay_short_and_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "MAX_LINES", 5)
    _, got = translated_text("\n".join(f'def BasisCurves "c{i}" {{ }}' for i in range(9)))
    assert len(got.left_out) == 5
    assert any("4 more lines" in note.message for note in got.notes)


def test_the_report_is_readable_as_text() -> None:
    _, got = translated(stage_of('def BasisCurves "b" {\n}\n def Cube "c" { }'), TranslateRequest(size=(8, 4)))
    for part in ("size 8x4", "left out /b BasisCurves", "assumed light", "triangles 12"):
        assert part in str(got)
