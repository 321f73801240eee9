"""Laws of looks: bindings, collections and purposes; UsdPreviewSurface's constants; what cannot be used."""

import pytest

from footlight_server.usd import TranslateRequest
from tests.server.usd.capture import CapturingSink
from tests.server.usd.stages import reasons, translated_text


def material(name: str, text: str = "", shader: str = "UsdPreviewSurface", more: str = "") -> str:
    return f"""
    def Material "{name}" {{
        token outputs:surface.connect = </{name}/s.outputs:surface>
        {more}
        def Shader "s" {{
            uniform token info:id = "{shader}"
            {text}
            token outputs:surface
        }}
    }}
    """


def bound(path: str = "/m", extra: str = "") -> str:
    head = 'def Cube "c" (prepend apiSchemas = ["MaterialBindingAPI"])'
    return f"{head} {{\n rel material:binding = <{path}>\n {extra}\n }}\n"


def look(sink: CapturingSink, path: str = "/c") -> str:
    """Path of the material on the prim."""
    [mesh] = [mesh for mesh in sink.meshes if mesh["path"] == path]
    name: str = sink.materials[mesh["material"]]["path"]
    return name


def test_constants_arrive() -> None:
    text = """
    color3f inputs:diffuseColor = (0.1, 0.2, 0.3)
    color3f inputs:emissiveColor = (4, 5, 6)
    int inputs:useSpecularWorkflow = 1
    color3f inputs:specularColor = (0.5, 0.25, 0.125)
    float inputs:metallic = 0.5
    float inputs:roughness = 0.25
    float inputs:clearcoat = 0.75
    float inputs:clearcoatRoughness = 0.125
    float inputs:ior = 1.75
    float inputs:opacity = 0.5
    """
    sink, report = translated_text(material("m", text) + bound())
    assert not report.left_out
    [got] = sink.materials
    assert got["diffuse_color"] == pytest.approx((0.1, 0.2, 0.3))
    wanted = {
        "path": "/m",
        "diffuse_from_primvar": False,
        "emissive_color": (4, 5, 6),
        "use_specular_workflow": True,
        "specular_color": (0.5, 0.25, 0.125),
        "metallic": 0.5,
        "roughness": 0.25,
        "clearcoat": 0.75,
        "clearcoat_roughness": 0.125,
        "ior": 1.75,
        "opacity": 0.5,
        "opacity_from_primvar": False,
    }
    assert {key: got[key] for key in wanted} == wanted


def test_defaults_are_the_specifications() -> None:
    sink, _ = translated_text(material("m") + bound())
    [got] = sink.materials
    assert got["diffuse_color"] == (0.18, 0.18, 0.18)
    assert (got["metallic"], got["roughness"], got["ior"], got["opacity"]) == (0, 0.5, 1.5, 1)
    assert (got["clearcoat"], got["clearcoat_roughness"], got["use_specular_workflow"]) == (0, 0.01, False)


@pytest.mark.parametrize(
    ("opacity", "threshold", "wanted"), [(0.3, 0.0, 0.3), (0.3, 0.5, 0.0), (0.5, 0.5, 1.0), (0.9, 0.5, 1.0)]
)
def test_the_opacity_threshold(opacity: float, threshold: float, wanted: float) -> None:
    text = f"float inputs:opacity = {opacity}\n float inputs:opacityThreshold = {threshold}"
    sink, _ = translated_text(material("m", text) + bound())
    assert sink.materials[0]["opacity"] == pytest.approx(wanted)


READER = """
def Shader "reader" {{
    uniform token info:id = "{kind}"
    string inputs:varname = "{name}"
    token outputs:result
}}
"""


def test_primvar_readers_of_display_color_and_opacity() -> None:
    text = (
        "color3f inputs:diffuseColor.connect = </color/reader.outputs:result>\n"
        "float inputs:opacity.connect = </opacity/reader.outputs:result>\n float inputs:opacityThreshold = 0.5"
    )
    readers = (
        'def Scope "color" {' + READER.format(kind="UsdPrimvarReader_float3", name="displayColor") + "\n }\n"
        'def Scope "opacity" {' + READER.format(kind="UsdPrimvarReader_float", name="displayOpacity") + "\n }\n"
    )
    extra = "color3f[] primvars:displayColor = [(1, 0, 0)]\n float[] primvars:displayOpacity = [0.25]"
    sink, report = translated_text(material("m", text) + readers + bound(extra=extra))
    assert not report.left_out
    assert sink.materials[0]["diffuse_from_primvar"]
    assert sink.materials[0]["opacity_from_primvar"]
    assert sink.meshes[0]["colors"].tolist() == [[1, 0, 0]]
    assert sink.meshes[0]["opacities"].tolist() == [0]  # below the threshold


@pytest.mark.parametrize(
    ("kind", "name"),
    [("UsdUVTexture", "displayColor"), ("UsdPrimvarReader_float3", "st"), ("Anything", "displayColor")],
)
def test_other_connections_are_left_out_and_the_rest_counts(kind: str, name: str) -> None:
    text = "color3f inputs:diffuseColor.connect = </reader.outputs:result>\n float inputs:roughness = 0.25"
    sink, report = translated_text(material("m", text) + READER.format(kind=kind, name=name) + bound())
    assert sink.materials[0]["diffuse_color"] == (0.18, 0.18, 0.18)
    assert sink.materials[0]["roughness"] == 0.25
    assert f"/m/s inputs:diffuseColor: connected to {kind}" in reasons(report)


def test_interface_inputs_are_followed() -> None:
    sink, _ = translated_text(
        material("m", "float inputs:roughness.connect = </m.inputs:rough>", more="float inputs:rough = 0.75") + bound()
    )
    assert sink.materials[0]["roughness"] == 0.75


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("color3f inputs:diffuseColor = (nan, 0, 0)", "diffuseColor = (nan, 0, 0) is not finite"),
        ("color3f inputs:emissiveColor = (-1, 0, 0)", "is negative, 0 is used there"),
        ("float inputs:roughness = 2", "2 is outside [0, 1], 1 is used"),
        ("float inputs:ior = 0", "0 is outside [0.001, 1000]"),
        ("float inputs:opacity = inf", "opacity = inf is not a finite number"),
        ('string inputs:metallic = "yes"', "metallic = yes is not a finite number"),
        ("normal3f inputs:normal.connect = </reader.outputs:result>", "inputs:normal: is not rendered yet"),
    ],
)
def test_bad_inputs_are_left_out_and_the_default_counts(text: str, reason: str) -> None:
    sink, report = translated_text(material("m", text) + READER.format(kind="UsdUVTexture", name="st") + bound())
    assert look(sink) == "/m"
    assert reason in reasons(report)


def test_unknown_shaders_fall_back_to_display_color() -> None:
    extra = "color3f[] primvars:displayColor = [(0, 1, 0)]"
    for text, reason in (
        (material("m", shader="ND_standard_surface"), "unknown shader ND_standard_surface (/m/s)"),
        ('def Material "m" {\n token outputs:mtlx:surface.connect = </x.outputs:out> }\n', "mtlx:surface"),
        ('def Material "m" { }\n', "no surface shader"),
    ):
        sink, report = translated_text(text + bound(extra=extra))
        assert "/m Material: " in reasons(report)
        assert reason in reasons(report)
        assert look(sink) == ""
        assert sink.meshes[0]["colors"].tolist() == [[0, 1, 0]]
        assert any(a.what == "displayColor" for a in report.assumed)


def test_bindings_by_purpose() -> None:
    prim = """
    def Cube "c" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        rel material:binding = </all>
        rel material:binding:full = </full>
        rel material:binding:preview = </preview>
    }
    """
    text = material("all") + material("full") + material("preview") + prim
    for purpose, wanted in ((None, "/full"), ("full", "/full"), ("preview", "/preview"), ("", "/all")):
        sink, _ = translated_text(text, TranslateRequest(material_purpose=purpose))
        assert look(sink) == wanted
    render_settings = 'def RenderSettings "s" {\n uniform token[] materialBindingPurposes = ["preview", ""] }\n'
    sink, _ = translated_text(text + render_settings)
    assert look(sink) == "/preview"


def test_bindings_are_inherited_and_stronger_ones_win() -> None:
    def tree(strength: str) -> str:
        return f"""
        def Xform "x" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
            rel material:binding = </outer> {strength}
            def Cube "plain" {{ }}
            def Cube "own" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
                rel material:binding = </inner>
            }}
        }}
        """

    text = material("outer") + material("inner")
    sink, _ = translated_text(text + tree(""))
    assert (look(sink, "/x/plain"), look(sink, "/x/own")) == ("/outer", "/inner")
    sink, _ = translated_text(text + tree('(bindMaterialAs = "strongerThanDescendants")'))
    assert {mesh["material"] for mesh in sink.meshes} == {0}


def test_collections_bind_also_inside_instances() -> None:
    text = (
        material("red")
        + """
    class Xform "Source" { def Cube "c" { } }
    def Xform "world" (
        prepend apiSchemas = ["MaterialBindingAPI", "CollectionAPI:chosen"]
    ) {
        rel material:binding:collection:chosen = [</world.collection:chosen>, </red>]
        rel collection:chosen:includes = [</world/b>]
        def Xform "a" (
            instanceable = true
            references = </Source>
        ) { }
        def Xform "b" (
            instanceable = true
            references = </Source>
        ) { }
    }
    """
    )
    sink, _ = translated_text(text)
    assert {mesh["path"]: sink.materials[mesh["material"]]["path"] for mesh in sink.meshes} == {
        "/world/a/c": "",
        "/world/b/c": "/red",
    }


def test_instances_under_different_materials_do_not_share() -> None:
    def place(name: str, path: str) -> str:
        return f"""
        def Xform "{name}" (
            prepend apiSchemas = ["MaterialBindingAPI"]
            instanceable = true
            references = </Source>
        ) {{
            rel material:binding = <{path}>
        }}
        """

    sink, _ = translated_text(
        material("red")
        + material("blue")
        + 'class Xform "Source" {\n def Cube "c" { }\n }\n'
        + place("a", "/red")
        + place("b", "/blue")
        + place("d", "/red")
    )
    assert sorted((look_path(sink, m), n) for m, n in placed_counts(sink)) == [("/blue", 1), ("/red", 2)]


def look_path(sink: CapturingSink, mesh: int) -> str:
    path: str = sink.materials[sink.meshes[mesh]["material"]]["path"]
    return path


def placed_counts(sink: CapturingSink) -> list[tuple[int, int]]:
    return [(group.meshes[0], len(group.transforms)) for group in sink.instances]
