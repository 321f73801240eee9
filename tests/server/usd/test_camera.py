"""Laws of the image: which camera, conformed how, framed how; what RenderSettings and products say."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from footlight_server.usd import CameraError, StageLimitError, TranslateRequest
from footlight_server.usd.prims.camera import conform
from tests.server.usd.capture import CapturingSink, to_world
from tests.server.usd.stages import reasons, stage_of, translated, translated_text

CUBE = 'def Cube "c" { }\n'
CAMERAS = """
def Camera "one" {
    float horizontalAperture = 20
    float verticalAperture = 10
    float horizontalApertureOffset = 1
    float verticalApertureOffset = -2
    float focalLength = 35
    float2 clippingRange = (0.5, 100)
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    %s
}
def Camera "two" { }
"""


def test_a_cameras_values_arrive() -> None:
    sink, report = translated_text(
        CAMERAS % "float fStop = 2.8\n float focusDistance = 7\n float exposure = 3\n float exposure:iso = 200",
        TranslateRequest(camera="/one", size=(200, 100)),
    )
    camera = sink.camera
    assert report.camera == camera["path"] == "/one"
    assert np.array_equal(camera["camera_to_world"][3], [1, 2, 3, 1])
    assert (camera["horizontal_aperture"], camera["vertical_aperture"], camera["focal_length"]) == (20, 10, 35)
    assert (camera["horizontal_aperture_offset"], camera["vertical_aperture_offset"]) == (1, -2)
    assert camera["clipping_range"] == (0.5, 100)
    assert (camera["f_stop"], camera["focus_distance"]) == (pytest.approx(2.8), 7)
    assert camera["exposure_scale"] == pytest.approx(8 * 2)


@given(st.floats(0.1, 100), st.floats(0.1, 100), st.floats(0.1, 10))
@settings(max_examples=60)
def test_conforming_gives_the_images_aspect(horizontal: float, vertical: float, aspect: float) -> None:
    for policy in ("adjustApertureHeight", "adjustApertureWidth", "expandAperture", "cropAperture"):
        width, height = conform(horizontal, vertical, aspect, policy)
        assert width / height == pytest.approx(aspect)
        assert width == horizontal or height == vertical
        if policy == "expandAperture":
            assert width >= horizontal * (1 - 1e-9)
            assert height >= vertical * (1 - 1e-9)
        if policy == "cropAperture":
            assert width <= horizontal * (1 + 1e-9)
            assert height <= vertical * (1 + 1e-9)
    assert conform(horizontal, vertical, aspect, "adjustPixelAspectRatio") == (horizontal, vertical)


def test_without_settings_the_horizontal_aperture_spans_the_image() -> None:
    sink, _ = translated_text(CAMERAS % "", TranslateRequest(size=(400, 100)))
    assert (sink.camera["horizontal_aperture"], sink.camera["vertical_aperture"]) == (20, 5)


def test_scale_is_taken_out_of_the_camera_and_mirrors_stay() -> None:
    text = CAMERAS.replace('["xformOp:translate"]', '["xformOp:translate", "xformOp:scale"]')
    sink, _ = translated_text(text % "float3 xformOp:scale = (-2, 3, 4)")
    assert sink.camera["camera_to_world"][:3, :3] == pytest.approx(np.diag([-1, 1, 1]), abs=1e-12)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("float focalLength = 0", "focalLength 0"),
        ("float horizontalAperture = -1", "must be above 0"),
        ("float focalLength = nan", "focalLength = nan is not a finite number"),
        ('token projection = "orthographic"', "only perspective cameras"),
        ("float exposure = 2000", "exposure attributes give a scale of inf"),
    ],
)
def test_unusable_cameras_are_errors_with_their_path(text: str, reason: str) -> None:
    with pytest.raises(CameraError, match=f"^/bad: .*{reason}"):
        translated_text(f'def Camera "bad" {{\n {text} }}')


def test_absent_cameras_are_errors_that_name_those_there_are() -> None:
    for wanted in ("/nowhere", "nonsense", "/c", ""):
        with pytest.raises(CameraError, match=r"no such camera on the stage; it has /one, /two"):
            translated_text(CUBE + CAMERAS % "", TranslateRequest(camera=wanted))


def projected(sink: CapturingSink, points: np.ndarray) -> np.ndarray:
    """Points on the image plane, -1..1 from edge to edge, and their depth."""
    camera = sink.camera
    local = (points - camera["camera_to_world"][3, :3]) @ camera["camera_to_world"][:3, :3].T
    scale = camera["focal_length"] * 2 / np.array([camera["horizontal_aperture"], camera["vertical_aperture"]])
    return np.column_stack([local[:, :2] / -local[:, 2:] * scale, -local[:, 2]])


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("size", [(100, 100), (300, 100), (100, 300)])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_framed_camera_sees_everything_and_fills_the_image(up: str, size: tuple[int, int], scale: float) -> None:
    stage = stage_of(
        f'def Xform "x" {{\n float3 xformOp:scale = ({scale}, {2 * scale}, {3 * scale})\n'
        f" double3 xformOp:translate = ({5 * scale}, 0, 0)\n"
        f' uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]\n {CUBE} }}'
    )
    stage.SetMetadata("upAxis", up)
    sink, report = translated(stage, TranslateRequest(size=size))
    assert any(a.what == "camera" and "framed" in a.reason for a in report.assumed)
    [(mesh, matrix)] = sink.placed()
    image = projected(sink, to_world(mesh["points"], matrix))
    assert image[:, 2].min() > 0
    assert 0.9 < np.abs(image[:, :2]).max() <= 1.0
    near, far = sink.camera["clipping_range"]
    assert near <= image[:, 2].min()
    assert far > image[:, 2].max()
    up_axis = np.array([0, 1, 0] if up == "Y" else [0, 0, 1])
    assert np.array_equal(sink.camera["camera_to_world"][1, :3], up_axis)


def test_framing_counts_turned_and_mirrored_parts() -> None:
    sink, _ = translated_text(
        """def Cube "c" {
            double3 xformOp:translate = (50, 0, 0)
            float xformOp:rotateZ = 45
            float3 xformOp:scale = (-8, -8, 1)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ", "xformOp:scale"]
        }""",
        TranslateRequest(size=(100, 300)),
    )
    [(mesh, matrix)] = sink.placed()
    image = projected(sink, to_world(mesh["points"], matrix))
    assert 0.9 < np.abs(image[:, :2]).max() <= 1.0


def test_a_stage_without_anything_is_an_image_of_a_white_dome() -> None:
    sink, report = translated_text("")
    assert [kind for kind, _ in sink.lights] == ["dome"]
    assert math.isfinite(sink.camera["camera_to_world"].sum())
    assert {a.what for a in report.assumed} == {"camera", "light"}


SETTINGS = """
def Scope "Render" {
    def RenderSettings "first" {
        int2 resolution = (64, 32)
        rel camera = </two>
    }
    def RenderSettings "main" {
        int2 resolution = (320, 240)
        rel camera = </one>
        rel products = [</Render/beauty>, </Render/other>]
        token aspectRatioConformPolicy = "adjustApertureWidth"
        float pixelAspectRatio = 2
        %s
    }
    def RenderProduct "beauty" {
        int2 resolution = (400, 100)
        %s
    }
    def RenderProduct "other" { }
}
"""


def test_settings_named_by_the_stage_count_and_products_override_them() -> None:
    stage = stage_of(CAMERAS % "" + SETTINGS % ("", ""))
    stage.SetMetadata("renderSettingsPrimPath", "/Render/main")
    sink, report = translated(stage)
    assert (report.settings, report.camera) == ("/Render/main", "/one")
    assert (report.width, report.height) == (400, 100)
    # The height stays 10; the width follows the image's aspect of 4, its pixels twice as wide as high.
    assert (sink.camera["horizontal_aperture"], sink.camera["vertical_aperture"]) == (80, 10)
    assert "/Render/other RenderProduct: the first product" in reasons(report)
    _, report = translated(stage, TranslateRequest(camera="/two", size=(10, 20)))
    assert (report.camera, report.width, report.height) == ("/two", 10, 20)


def test_a_products_camera_overrides_the_settings() -> None:
    stage = stage_of(CAMERAS % "" + SETTINGS % ("", "rel camera = </two>"))
    stage.SetMetadata("renderSettingsPrimPath", "/Render/main")
    assert translated(stage)[1].camera == "/two"


def test_settings_that_no_metadata_names_are_assumed() -> None:
    _, report = translated_text(CAMERAS % "" + SETTINGS % ("", ""))
    assert report.settings == "/Render/first"
    assert any("the first of 2" in a.reason for a in report.assumed)


def test_bad_settings_are_left_out() -> None:
    text = (
        'def RenderSettings "s" {\n int2 resolution = (0, 9)\n float pixelAspectRatio = -1\n rel camera = </nowhere> }'
    )
    _, report = translated_text(CAMERAS % "" + text)
    assert (report.width, report.height) == (1280, 720)
    assert report.camera == "/one"
    for line in ("/s resolution: (0, 9)", "/s pixelAspectRatio: -1", "/nowhere camera: named by /s"):
        assert line in reasons(report)


def test_depth_of_field_needs_a_focus_and_settings_can_forbid_it() -> None:
    sink, report = translated_text(CAMERAS % "float fStop = 4")
    assert sink.camera["f_stop"] == 0
    assert "focusDistance 0 is not above 0" in reasons(report)
    text = CAMERAS % "float fStop = 4\n float focusDistance = 4"
    sink, _ = translated_text(text + 'def RenderSettings "s" {\n uniform bool disableDepthOfField = true }')
    assert sink.camera["f_stop"] == 0
    sink, _ = translated_text(text)
    assert sink.camera["f_stop"] == 4


@pytest.mark.parametrize("clip", ["(5, 1)", "(-1, 5)", "(nan, 5)", "(1, 1)"])
def test_bad_clipping_ranges_hide_nothing(clip: str) -> None:
    sink, report = translated_text(CAMERAS.replace("(0.5, 100)", clip) % "", TranslateRequest(camera="/one"))
    assert sink.camera["clipping_range"][0] == 0
    assert "/one clippingRange" in reasons(report)


def test_what_the_clipping_range_hides_is_named() -> None:
    def sphere(name: str, z: float) -> str:
        return (
            f'def Sphere "{name}" {{\n double radius = 0.25\n double3 xformOp:translate = (1, 2, {3 - z})\n'
            'uniform token[] xformOpOrder = ["xformOp:translate"] }\n'
        )

    text = (
        CAMERAS.replace("(0.5, 100)", "(1, 100)") % "" + sphere("near", 0.5) + sphere("far", 101) + sphere("seen", 50)
    )
    _, report = translated_text(text + sphere("cut", 1) + sphere("behind", -5), TranslateRequest(camera="/one"))
    assert [line.path for line in report.left_out] == ["/near", "/far"]
    assert "at most 0.75 from /one, which sees 1 to 100" in reasons(report)


def test_images_beyond_the_budget_are_refused() -> None:
    with pytest.raises(StageLimitError, match=r"/s: 100000 x 100000 pixels"):
        translated_text('def RenderSettings "s" {\n int2 resolution = (100000, 100000) }')
