"""UsdLux lights: emission in the schema's words, to the sink's calls."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pxr import UsdLux

from footlight_server.usd.context import Context
from footlight_server.usd.roots import OUTSIDE, is_below
from footlight_server.usd.sink import Doubles, Floats, Rgb
from footlight_server.usd.values import BadValueError, read_color, read_number

# Adds one light at the given local-to-world matrix; "" or the reason it is not used.
AddLight = Callable[[Doubles], str]

_LATLONG = ("automatic", "latlong")
# Latitude-longitude with its pole on Z and longitude 0 on -Y (DomeLight_1.poleAxis): local Y to Z, local Z to -Y.
_POLE_Z = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def is_light(prim: Any) -> bool:
    """Whether the prim emits light by UsdLux: a light type, or anything with LightAPI (mesh lights)."""
    return bool(prim.HasAPI(UsdLux.LightAPI))


def translate_light(ctx: Context, prim: Any) -> AddLight | None:
    """How to add the light; None if it cannot be, which is then in the report."""
    kind = str(prim.GetTypeName())
    make = _LIGHTS.get(kind)
    if make is None:
        ctx.report.leave_out(prim.GetPath(), kind or "light", "no light of that type can be rendered")
        return None
    try:
        emission = _emission(ctx, prim)
        add = make(ctx, prim, emission)
    except BadValueError as error:
        ctx.report.leave_out(prim.GetPath(), kind, str(error))
        return None
    _leave_out_features(ctx, prim)
    return add


def add_white_dome(ctx: Context) -> None:
    """Radiance 1 from everywhere, for a stage that says nothing about light."""
    ctx.report.assume("light", "the stage has no light and nothing that emits: a white dome of radiance 1")
    reason = ctx.sink.add_dome_light(
        path="",
        transform=np.eye(4),
        emission=(1.0, 1.0, 1.0),
        image=None,
        visible_to_camera=ctx.request.lights_visible_to_camera,
    )
    if not reason:
        ctx.report.counts["lights"] += 1


def _emission(ctx: Context, prim: Any) -> Rgb:
    """The light's intensity * 2^exposure * color * blackbody(colorTemperature), in double (UsdLux LightAPI)."""
    light = UsdLux.LightAPI(prim)
    intensity = read_number(light.GetIntensityAttr(), ctx.time, 1.0)
    exposure = read_number(light.GetExposureAttr(), ctx.time, 0.0)
    color = read_color(light.GetColorAttr(), ctx.time, (1.0, 1.0, 1.0))
    try:
        scale = intensity * math.exp2(exposure)
    except OverflowError:
        scale = math.inf
    tint = (1.0, 1.0, 1.0)
    if light.GetEnableColorTemperatureAttr().Get(ctx.time):
        kelvin = read_number(light.GetColorTemperatureAttr(), ctx.time, 6500.0)
        red, green, blue = UsdLux.BlackbodyTemperatureAsRgb(kelvin)
        tint = (float(red), float(green), float(blue))
    emission = (scale * color[0] * tint[0], scale * color[1] * tint[1], scale * color[2] * tint[2])
    if not all(math.isfinite(e) for e in emission):
        raise BadValueError(f"intensity {intensity:g} at exposure {exposure:g} is not finite")
    return emission


def _size(ctx: Context, prim: Any, name: str, default: float) -> float:
    """A size of the light, not below 0. Raises BadValueError."""
    value = read_number(prim.GetAttribute(f"inputs:{name}"), ctx.time, default)
    if value < 0:
        raise BadValueError(f"{name} = {value:g} is negative")
    return value


def _is_normalized(ctx: Context, prim: Any) -> bool:
    return bool(UsdLux.LightAPI(prim).GetNormalizeAttr().Get(ctx.time))


def _rect(ctx: Context, prim: Any, emission: Rgb) -> AddLight:
    width, height = _size(ctx, prim, "width", 1.0), _size(ctx, prim, "height", 1.0)
    normalize, path = _is_normalized(ctx, prim), str(prim.GetPath())
    if _asset(prim.GetAttribute("inputs:texture:file"), ctx.time):
        ctx.report.leave_out(path, "inputs:texture:file", "textures on RectLight are not rendered yet")
    return lambda transform: ctx.sink.add_rect_light(
        path=path,
        transform=transform,
        width=width,
        height=height,
        emission=emission,
        normalize=normalize,
        visible_to_camera=ctx.request.lights_visible_to_camera,
    )


def _disk(ctx: Context, prim: Any, emission: Rgb) -> AddLight:
    radius = _size(ctx, prim, "radius", 0.5)
    normalize, path = _is_normalized(ctx, prim), str(prim.GetPath())
    return lambda transform: ctx.sink.add_disk_light(
        path=path,
        transform=transform,
        radius=radius,
        emission=emission,
        normalize=normalize,
        visible_to_camera=ctx.request.lights_visible_to_camera,
    )


def _sphere(ctx: Context, prim: Any, emission: Rgb) -> AddLight:
    radius = _size(ctx, prim, "radius", 0.5)
    normalize, path = _is_normalized(ctx, prim), str(prim.GetPath())
    if UsdLux.SphereLight(prim).GetTreatAsPointAttr().Get(ctx.time):
        ctx.report.note(path, f"treatAsPoint is a hint that is not taken: a sphere of radius {radius:g}")
    return lambda transform: ctx.sink.add_sphere_light(
        path=path,
        transform=transform,
        radius=radius,
        emission=emission,
        normalize=normalize,
        visible_to_camera=ctx.request.lights_visible_to_camera,
    )


def _cylinder(ctx: Context, prim: Any, emission: Rgb) -> AddLight:
    radius, length = _size(ctx, prim, "radius", 0.5), _size(ctx, prim, "length", 1.0)
    normalize, path = _is_normalized(ctx, prim), str(prim.GetPath())
    if UsdLux.CylinderLight(prim).GetTreatAsLineAttr().Get(ctx.time):
        ctx.report.note(path, f"treatAsLine is a hint that is not taken: a cylinder of radius {radius:g}")
    return lambda transform: ctx.sink.add_cylinder_light(
        path=path,
        transform=transform,
        radius=radius,
        length=length,
        emission=emission,
        normalize=normalize,
        visible_to_camera=ctx.request.lights_visible_to_camera,
    )


def _distant(ctx: Context, prim: Any, emission: Rgb) -> AddLight:
    angle = _size(ctx, prim, "angle", 0.53)
    normalize, path = _is_normalized(ctx, prim), str(prim.GetPath())
    return lambda transform: ctx.sink.add_distant_light(
        path=path,
        transform=transform,
        angle=angle,
        emission=emission,
        normalize=normalize,
        visible_to_camera=ctx.request.lights_visible_to_camera,
    )


def _dome(ctx: Context, prim: Any, emission: Rgb) -> AddLight:
    path = str(prim.GetPath())
    image = _dome_image(ctx, prim)
    local = _dome_orientation(ctx, prim)
    return lambda transform: ctx.sink.add_dome_light(
        path=path,
        transform=np.ascontiguousarray(local @ transform),
        emission=emission,
        image=image,
        visible_to_camera=ctx.request.lights_visible_to_camera,
    )


def _dome_orientation(ctx: Context, prim: Any) -> Doubles:
    if str(prim.GetTypeName()) != "DomeLight_1":
        return np.eye(4)
    pole = str(UsdLux.DomeLight_1(prim).GetPoleAxisAttr().Get(ctx.time))
    return _POLE_Z if pole == "Z" or (pole == "scene" and ctx.report.up_axis == "Z") else np.eye(4)


def _dome_image(ctx: Context, prim: Any) -> Floats | None:
    """The dome's texture (H, W, 3), None if it has none. Raises BadValueError: without its texture a dome is wrong."""
    attribute = prim.GetAttribute("inputs:texture:file")
    asset = _asset(attribute, ctx.time)
    if not asset:
        return None
    layout = str(prim.GetAttribute("inputs:texture:format").Get(ctx.time))
    if layout not in _LATLONG:
        raise BadValueError(f"texture:format {layout} cannot be rendered, allowed are {' and '.join(_LATLONG)}")
    resolved = attribute.Get(ctx.time).resolvedPath
    if not resolved or not is_below(Path(resolved), ctx.request.roots):
        # In one breath: whether there is such a file outside is not told.
        why = "no such file" + (f", or {OUTSIDE}" if ctx.request.roots else "")
        raise BadValueError(f"texture {asset}: {why}")
    if ctx.load_image is None:
        raise BadValueError(f"texture {resolved}: images are not read here")
    try:
        texels = ctx.load_image(resolved, lambda count: ctx.count("texels", count, prim.GetPath()))
        image: Floats = np.ascontiguousarray(texels, np.float32)
    except (OSError, ValueError) as error:
        raise BadValueError(f"texture {resolved}: {error}") from error
    if image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise BadValueError(f"texture {resolved}: its shape is {image.shape}, wanted is (height, width, 3)")
    return image


def _asset(attribute: Any, time: Any) -> str:
    value = attribute.Get(time) if attribute else None
    return str(value.path) if value is not None else ""


def _leave_out_features(ctx: Context, prim: Any) -> None:
    """What the light has, and the image will not show."""
    light = UsdLux.LightAPI(prim)
    report, path, time = ctx.report, prim.GetPath(), ctx.time
    for name in ("diffuse", "specular"):
        value = light.GetPrim().GetAttribute(f"inputs:{name}").Get(time)
        if value is not None and value != 1.0:
            report.leave_out(path, f"inputs:{name}", f"{value:g}: lights shine on all lobes alike")
    if light.GetFiltersRel().GetForwardedTargets():
        report.leave_out(path, "light:filters", "are not rendered yet")
    for collection, what in (
        (light.GetLightLinkCollectionAPI(), "light linking"),
        (light.GetShadowLinkCollectionAPI(), "shadow linking"),
    ):
        include_root = collection.GetIncludeRootAttr()
        if (
            collection.GetIncludesRel().HasAuthoredTargets()
            or collection.GetExcludesRel().HasAuthoredTargets()
            or (include_root.HasAuthoredValue() and include_root.Get(time) is False)
        ):
            report.leave_out(path, what, "is not rendered yet; the light shines on everything")
    enabled = prim.GetAttribute("inputs:shadow:enable")
    if enabled and enabled.Get(time) is False:
        report.leave_out(path, "inputs:shadow:enable", "false: every light casts shadows")
    for reason in _shaping(prim, time):
        report.leave_out(path, "shaping", f"{reason}; the light is not shaped")


def _shaping(prim: Any, time: Any) -> list[str]:
    """What ShapingAPI asks for and would be visible."""
    shaping = UsdLux.ShapingAPI(prim)
    # A flat light emits into a hemisphere only: an angle of 90 degrees or more changes nothing.
    widest = 90.0 if str(prim.GetTypeName()) in ("RectLight", "DiskLight") else 180.0
    found = []
    angle = shaping.GetShapingConeAngleAttr()
    if angle.HasAuthoredValue() and (angle.Get(time) or 0.0) < widest:
        found.append(f"cone:angle {angle.Get(time):g}")
    focus = shaping.GetShapingFocusAttr()
    if focus.HasAuthoredValue() and focus.Get(time):
        found.append(f"focus {focus.Get(time):g}")
    if _asset(shaping.GetShapingIesFileAttr(), time):
        found.append(f"ies:file {_asset(shaping.GetShapingIesFileAttr(), time)}")
    return found


_LIGHTS: dict[str, Callable[[Context, Any, Rgb], AddLight]] = {
    "RectLight": _rect,
    "DiskLight": _disk,
    "SphereLight": _sphere,
    "CylinderLight": _cylinder,
    "DistantLight": _distant,
    "DomeLight": _dome,
    "DomeLight_1": _dome,
}
