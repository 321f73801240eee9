"""RenderSettings and RenderProduct: what the stage says about the image."""

from dataclasses import dataclass
from typing import Any

from pxr import Usd, UsdRender

from footlight_server.usd.report import Report

_WHOLE = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class ImageSettings:
    """What is authored; None where the stage says nothing.

    conform: aspectRatioConformPolicy. pixel_aspect: width of a pixel over its height.
    """

    path: str = ""
    camera: str | None = None
    resolution: tuple[int, int] | None = None
    conform: str = "adjustApertureHeight"  # without RenderSettings the horizontal aperture spans the image
    pixel_aspect: float = 1.0
    purposes: tuple[str, ...] | None = None
    material_purpose: str | None = None
    without_depth_of_field: bool = False


def read_settings(stage: Any, time: Any, report: Report) -> ImageSettings:
    """The settings named by renderSettingsPrimPath, else the first RenderSettings; its first product overrides it."""
    settings = _find(stage, report)
    if settings is None:
        return ImageSettings()
    prim = settings.GetPrim()
    product = _first_product(stage, settings, report)
    sources = [product.GetPrim(), prim] if product else [prim]

    def authored(name: str) -> Any:
        for source in sources:
            attribute = source.GetAttribute(name)
            if attribute and attribute.HasAuthoredValue():
                return attribute.Get(time)
        return None

    window = settings.GetDataWindowNDCAttr().Get(time)
    if window is not None and tuple(window) != _WHOLE:
        report.leave_out(prim.GetPath(), "dataWindowNDC", f"{tuple(window)}: the whole image is rendered")
    purposes = settings.GetIncludedPurposesAttr()
    materials = settings.GetMaterialBindingPurposesAttr()
    resolution = authored("resolution")
    pixel_aspect = authored("pixelAspectRatio")
    if resolution is not None and min(resolution) < 1:
        report.leave_out(prim.GetPath(), "resolution", f"{tuple(resolution)} is not above 0")
        resolution = None
    if pixel_aspect is not None and not 0 < pixel_aspect < float("inf"):
        report.leave_out(prim.GetPath(), "pixelAspectRatio", f"{pixel_aspect} is not above 0")
        pixel_aspect = None
    return ImageSettings(
        path=str(prim.GetPath()),
        camera=_camera([UsdRender.SettingsBase(source) for source in sources]),
        resolution=None if resolution is None else (int(resolution[0]), int(resolution[1])),
        conform=str(authored("aspectRatioConformPolicy") or settings.GetAspectRatioConformPolicyAttr().Get(time)),
        pixel_aspect=float(pixel_aspect or 1.0),
        purposes=_tokens(purposes, time),
        material_purpose=next(iter(_tokens(materials, time) or ()), None),
        without_depth_of_field=bool(authored("disableDepthOfField")),
    )


def _find(stage: Any, report: Report) -> Any:
    named = UsdRender.Settings.GetStageRenderSettings(stage)
    if named:
        return named
    wanted = stage.GetMetadata("renderSettingsPrimPath")
    if wanted:
        report.leave_out(wanted, "RenderSettings", "named by renderSettingsPrimPath, and not on the stage")
    found = [prim for prim in Usd.PrimRange(stage.GetPseudoRoot()) if prim.IsA(UsdRender.Settings)]
    if not found:
        return None
    others = f", the first of {len(found)}" if len(found) > 1 else ""
    report.assume("RenderSettings", f"{found[0].GetPath()}{others}: the stage's metadata names none")
    return UsdRender.Settings(found[0])


def _first_product(stage: Any, settings: Any, report: Report) -> Any:
    targets = settings.GetProductsRel().GetForwardedTargets()
    for other in targets[1:]:
        report.leave_out(other, "RenderProduct", "the first product of the settings is rendered")
    if not targets:
        return None
    product = UsdRender.Product.Get(stage, targets[0])
    if not product:
        report.leave_out(targets[0], "RenderProduct", f"named by {settings.GetPath()}, and not on the stage")
    return product or None


def _camera(sources: list[Any]) -> str | None:
    for source in sources:
        targets = source.GetCameraRel().GetForwardedTargets()
        if targets:
            return str(targets[0])
    return None


def _tokens(attribute: Any, time: Any) -> tuple[str, ...] | None:
    if not attribute.HasAuthoredValue():
        return None
    return tuple("" if name == "allPurpose" else str(name) for name in attribute.Get(time) or ())
