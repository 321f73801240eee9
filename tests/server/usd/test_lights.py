"""Laws of UsdLux: emission in the schema's words, every type, what is left out."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import UsdLux

from footlight_server.usd import Admit, Budget, StageLimitError, TranslateRequest
from tests.server.usd.stages import gray_image, reasons, stage_of, translated, translated_text

SIZES: dict[str, tuple[str, str, dict[str, object]]] = {
    "RectLight": ("float inputs:width = 3\n float inputs:height = 4", "rect", {"width": 3, "height": 4}),
    "DiskLight": ("float inputs:radius = 3", "disk", {"radius": 3}),
    "SphereLight": ("float inputs:radius = 3", "sphere", {"radius": 3}),
    "CylinderLight": ("float inputs:radius = 3\n float inputs:length = 4", "cylinder", {"radius": 3, "length": 4}),
    "DistantLight": ("float inputs:angle = 3", "distant", {"angle": 3}),
    "DomeLight": ("", "dome", {"image": None}),
    "DomeLight_1": ("", "dome", {"image": None}),
}


@pytest.mark.parametrize("kind", SIZES)
def test_every_type_arrives_with_its_size_and_place(kind: str) -> None:
    text, name, sizes = SIZES[kind]
    sink, report = translated_text(
        'def Xform "x" {\n double3 xformOp:translate = (1, 2, 3)\n'
        'uniform token[] xformOpOrder = ["xformOp:translate"]\n'
        f'def {kind} "l" {{\n {text} }}\n }}'
    )
    assert not report.left_out
    [(got, arguments)] = sink.lights
    assert got == name
    assert {key: arguments[key] for key in sizes} == sizes
    assert np.array_equal(arguments["transform"][3], [1, 2, 3, 1])
    assert arguments["path"] == "/x/l"
    assert arguments["visible_to_camera"] is True
    assert report.counts["lights"] == 1
    assert not any(a.what == "light" for a in report.assumed)


@pytest.mark.parametrize("kind", SIZES)
def test_emission_is_the_schemas_product(kind: str) -> None:
    sink, _ = translated_text(
        f'def {kind} "l" {{\n float inputs:intensity = 3\n float inputs:exposure = -2\n'
        "color3f inputs:color = (1, 0.5, 0.25)\n bool inputs:normalize = true\n"
        "bool inputs:enableColorTemperature = true\n float inputs:colorTemperature = 3200 }",
        TranslateRequest(lights_visible_to_camera=False),
    )
    arguments = sink.lights[0][1]
    wanted = 3 / 4 * np.array([1, 0.5, 0.25]) * np.array(UsdLux.BlackbodyTemperatureAsRgb(3200))
    assert arguments["emission"] == pytest.approx(tuple(wanted), rel=1e-7)
    assert arguments["visible_to_camera"] is False
    if "Dome" not in kind:
        assert arguments["normalize"] is True


@pytest.mark.parametrize(
    ("kind", "text", "reason"),
    [
        ("SphereLight", "float inputs:intensity = nan", "intensity = nan is not a finite number"),
        ("SphereLight", "float inputs:exposure = 1e30", "at exposure 1e+30 is not finite"),
        ("RectLight", "color3f inputs:color = (1, inf, 0)", "color = (1, inf, 0) is not finite"),
        ("DiskLight", "float inputs:radius = -1", "radius = -1 is negative"),
        ("DomeLight", "asset inputs:texture:file = @missing.exr@", "texture missing.exr: no such file"),
        ("DomeLight", 'asset inputs:texture:file = @x.exr@\n token inputs:texture:format = "angular"', "angular"),
        ("PortalLight", "", "no light of that type"),
        ("GeometryLight", "", "no light of that type"),
    ],
)
def test_bad_lights_are_left_out_and_no_dome_takes_their_place(kind: str, text: str, reason: str) -> None:
    sink, report = translated_text(f'def {kind} "l" {{\n {text} }}')
    assert not sink.lights
    assert reason in reasons(report)
    assert "/l" in reasons(report)


def test_what_the_sink_prunes_is_in_the_report() -> None:
    _, report = translated(stage_of('def RectLight "l" { }'), prune="its area is 0")
    assert "/l light: its area is 0" in reasons(report)
    assert report.counts["lights"] == 0


def test_a_dome_gets_its_texture_and_its_errors(tmp_path: Path) -> None:
    image = tmp_path / "sky.exr"
    image.write_bytes(b"")
    stage = stage_of(f'def DomeLight "d" {{\n asset inputs:texture:file = @{image}@ }}')
    asked: list[str] = []

    def load(path: str, admit: Admit) -> NDArray[np.float32]:
        asked.append(path)
        admit(8)
        return gray_image(path, admit)

    sink, _ = translated(stage, load_image=load)
    assert asked == [str(image)]
    assert np.array_equal(sink.lights[0][1]["image"], gray_image("", int))

    def broken(path: str, _: Admit) -> NDArray[np.float32]:
        raise OSError(f"{path} is no image")

    for loader, request, reason in (
        (broken, TranslateRequest(), f"texture {image}: {image} is no image"),
        (None, TranslateRequest(), "images are not read here"),
        (load, TranslateRequest(roots=(tmp_path / "elsewhere",)), "outside the directories"),
        (lambda *_: np.zeros((2, 2), np.float32), TranslateRequest(), "its shape is (2, 2)"),
    ):
        sink, report = translated(stage, request, load_image=loader)
        assert not sink.lights
        assert reason in reasons(report)


@pytest.mark.parametrize(
    ("kind", "pole", "up", "turned"),
    [
        ("DomeLight", "", "Z", False),
        ("DomeLight_1", 'uniform token poleAxis = "scene"', "Y", False),
        ("DomeLight_1", 'uniform token poleAxis = "scene"', "Z", True),
        ("DomeLight_1", 'uniform token poleAxis = "Z"', "Y", True),
        ("DomeLight_1", 'uniform token poleAxis = "Y"', "Z", False),
    ],
)
def test_the_pole_of_a_dome(kind: str, pole: str, up: str, turned: bool) -> None:
    stage = stage_of(f'def {kind} "d" {{\n {pole} }}')
    stage.SetMetadata("upAxis", up)
    sink, _ = translated(stage)
    matrix = sink.lights[0][1]["transform"]
    # Latitude pi/2 is the dome's Y, longitude 0 its Z: turned, these are the world's Z and -Y.
    assert np.array_equal(matrix[1, :3], [0, 0, 1] if turned else [0, 1, 0])
    assert np.array_equal(matrix[2, :3], [0, -1, 0] if turned else [0, 0, 1])


SHAPED = 'def {kind} "l" (prepend apiSchemas = ["ShapingAPI", "ShadowAPI"]) {{\n {text} }}'


@pytest.mark.parametrize(
    ("kind", "text", "reason"),
    [
        ("SphereLight", "float inputs:shaping:cone:angle = 170", "cone:angle 170; the light is not shaped"),
        ("RectLight", "float inputs:shaping:cone:angle = 60", "cone:angle 60"),
        ("RectLight", "float inputs:shaping:cone:angle = 90", ""),
        ("SphereLight", "float inputs:shaping:cone:angle = 180", ""),
        ("SphereLight", "", ""),
        ("DiskLight", "float inputs:shaping:focus = 2", "focus 2"),
        ("DiskLight", "asset inputs:shaping:ies:file = @a.ies@", "ies:file a.ies"),
        ("DiskLight", "rel light:filters = </f>", "light:filters"),
        ("DiskLight", "rel collection:lightLink:includes = </f>", "light linking"),
        ("DiskLight", "uniform bool collection:shadowLink:includeRoot = false", "shadow linking"),
        ("DiskLight", "bool inputs:shadow:enable = false", "inputs:shadow:enable"),
        ("DiskLight", "float inputs:specular = 0.5", "inputs:specular: 0.5"),
        ("RectLight", "asset inputs:texture:file = @a.png@", "textures on RectLight"),
    ],
)
def test_features_that_are_not_rendered_are_left_out_and_the_light_stays(kind: str, text: str, reason: str) -> None:
    sink, report = translated_text(SHAPED.format(kind=kind, text=text))
    assert len(sink.lights) == 1
    assert reason in reasons(report)
    assert bool(reason) == bool(report.left_out)


def test_lights_in_instances_shine_from_each_of_them() -> None:
    text = """
    class Xform "Lamp" { def SphereLight "l" { } }
    def PointInstancer "pi" {
        rel prototypes = [</Lamps/l>]
        int[] protoIndices = [0, 0]
        point3f[] positions = [(1, 0, 0), (2, 0, 0)]
    }
    over "Lamps" { def Xform "l" (references = </Lamp>) { } }
    """
    sink, report = translated_text(text)
    assert [arguments["transform"][3, 0] for _, arguments in sink.lights] == [1, 2]
    assert report.counts["lights"] == 2
    with pytest.raises(StageLimitError, match="2 lights, allowed are 1"):
        translated_text(text, TranslateRequest(budget=Budget(lights=1)))


def test_a_glowing_material_is_light_enough() -> None:
    glow = """
    def Material "glow" {
        token outputs:surface.connect = </glow/s.outputs:surface>
        def Shader "s" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:emissiveColor = (1, 1, 1)
            token outputs:surface
        }
    }
    """
    bound = 'def Cube "c" (prepend apiSchemas = ["MaterialBindingAPI"]) {\n rel material:binding = </glow> }'
    sink, report = translated_text(glow + bound)
    assert not sink.lights
    assert not any(a.what == "light" for a in report.assumed)
    sink, _ = translated_text(glow)
    assert len(sink.lights) == 1
