"""Camera: the one asked for, or one that frames everything; apertures conformed to the image."""

import math
from typing import Any

import numpy as np
from pxr import UsdGeom

from footlight_server.usd.context import Context
from footlight_server.usd.errors import CameraError
from footlight_server.usd.prims.settings import ImageSettings
from footlight_server.usd.sink import Doubles
from footlight_server.usd.values import BadValueError, read_number, why_singular

# UsdGeomCamera's fallbacks [tenths of a stage unit].
_FOCAL_LENGTH = 50.0
_HORIZONTAL_APERTURE = 20.955
_VERTICAL_APERTURE = 15.2908


def find_camera(stage: Any, wanted: str | None, settings: ImageSettings, ctx: Context) -> Any:
    """The prim of the camera to use: as asked for, as in the settings, or the first one; None to frame the stage.

    Raises CameraError if the one that was asked for is not there.
    """
    if wanted is not None:
        prim = stage.GetPrimAtPath(wanted) if wanted.startswith("/") else None
        if not prim or not prim.IsA(UsdGeom.Camera):
            found = _cameras(stage)
            have = f"it has {', '.join(found[:10])}" if found else "it has none"
            raise CameraError(f"{wanted}: no such camera on the stage; {have}")
        return prim
    if settings.camera is not None:
        prim = stage.GetPrimAtPath(settings.camera)
        if prim and prim.IsA(UsdGeom.Camera):
            return prim
        ctx.report.leave_out(settings.camera, "camera", f"named by {settings.path}, and not a camera on the stage")
    found = _cameras(stage)
    if not found:
        return None
    others = f", the first of {len(found)}" if len(found) > 1 else ""
    ctx.report.assume("camera", f"{found[0]}{others}: neither the request nor RenderSettings name one")
    return stage.GetPrimAtPath(found[0])


def set_camera(ctx: Context, prim: Any, settings: ImageSettings, world: Doubles) -> tuple[float, float]:
    """Hands a UsdGeom.Camera at `world` (local to world) to the sink; returns its clippingRange. Raises CameraError."""
    path = str(prim.GetPath())
    camera = UsdGeom.Camera(prim)
    if str(camera.GetProjectionAttr().Get(ctx.time)) == "orthographic":
        raise CameraError(f"{path}: is orthographic; only perspective cameras can be rendered")
    if singular := why_singular(world):
        raise CameraError(f"{path}: {singular}")
    try:
        focal_length = read_number(camera.GetFocalLengthAttr(), ctx.time, _FOCAL_LENGTH)
        apertures = (
            read_number(camera.GetHorizontalApertureAttr(), ctx.time, _HORIZONTAL_APERTURE),
            read_number(camera.GetVerticalApertureAttr(), ctx.time, _VERTICAL_APERTURE),
        )
        offsets = (
            read_number(camera.GetHorizontalApertureOffsetAttr(), ctx.time, 0.0),
            read_number(camera.GetVerticalApertureOffsetAttr(), ctx.time, 0.0),
        )
        f_stop = read_number(camera.GetFStopAttr(), ctx.time, 0.0)
        focus_distance = read_number(camera.GetFocusDistanceAttr(), ctx.time, 0.0)
        exposure_scale = float(camera.ComputeLinearExposureScale(ctx.time))
    except BadValueError as error:
        raise CameraError(f"{path}: {error}") from error
    if focal_length <= 0 or min(apertures) <= 0:
        raise CameraError(
            f"{path}: focalLength {focal_length:g} and apertures {apertures[0]:g} x {apertures[1]:g} must be above 0"
        )
    if not (math.isfinite(exposure_scale) and exposure_scale >= 0):
        raise CameraError(f"{path}: its exposure attributes give a scale of {exposure_scale}")
    if settings.without_depth_of_field or f_stop <= 0 or focus_distance <= 0:
        if f_stop > 0 and not settings.without_depth_of_field:
            ctx.report.leave_out(path, "depth of field", f"focusDistance {focus_distance:g} is not above 0")
        f_stop = 0.0
    if camera.GetClippingPlanesAttr().Get(ctx.time):
        ctx.report.leave_out(path, "clippingPlanes", "are not rendered; clippingRange is")
    horizontal, vertical = conform(*apertures, _image_aspect(ctx, settings), settings.conform)
    clipping_range = _clipping_range(ctx, camera)
    ctx.sink.set_camera(
        path=path,
        camera_to_world=_without_scale(world),
        focal_length=focal_length,
        horizontal_aperture=horizontal,
        vertical_aperture=vertical,
        horizontal_aperture_offset=offsets[0],
        vertical_aperture_offset=offsets[1],
        f_stop=f_stop,
        focus_distance=max(focus_distance, 0.0),
        clipping_range=clipping_range,
        exposure_scale=exposure_scale,
    )
    ctx.report.camera = path
    return clipping_range


def leave_out_clipped(
    ctx: Context, prim: Any, world: Doubles, clipping_range: tuple[float, float], placed: list[tuple[str, Doubles]]
) -> None:
    """Names what is in front of the camera and wholly outside its clippingRange: nothing vanishes in silence."""
    near, far = clipping_range
    back = _without_scale(world)[2, :3]
    for path, (low, high) in placed:
        depth = float((world[3, :3] - (low + high) / 2.0) @ back)
        reach = float((high - low) / 2.0 @ np.abs(back))
        if 0 < depth + reach < near or depth - reach > far:
            where = f"at most {depth + reach:g} from" if depth + reach < near else f"at least {depth - reach:g} from"
            ctx.report.leave_out(path, "clippingRange", f"{where} {prim.GetPath()}, which sees {near:g} to {far:g}")


def frame_camera(ctx: Context, settings: ImageSettings, bounds: Doubles | None) -> None:
    """A camera that sees all of the bounds (2, 3), from +Z with Y up and from -Y with Z up (as usdrecord does)."""
    if bounds is None:
        low = high = np.zeros(3)
    else:
        low, high = bounds
    horizontal, vertical = conform(
        _HORIZONTAL_APERTURE, _VERTICAL_APERTURE, _image_aspect(ctx, settings), "adjustApertureHeight"
    )
    world = np.eye(4)
    if ctx.report.up_axis == "Z":
        world[1, :3], world[2, :3] = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
    extent = np.abs(world[:3, :3] @ (high - low)) / 2.0
    distance = max(extent[0] / horizontal, extent[1] / vertical) * 2.0 * _FOCAL_LENGTH + extent[2]
    distance = max(distance * 1.02, 1e-30) if distance > 0 else 10.0  # a margin of 2 %
    world[3, :3] = (low + high) / 2.0 + world[2, :3] * distance
    span = float(np.linalg.norm(high - low))
    ctx.sink.set_camera(
        path="",
        camera_to_world=world,
        focal_length=_FOCAL_LENGTH,
        horizontal_aperture=horizontal,
        vertical_aperture=vertical,
        horizontal_aperture_offset=0.0,
        vertical_aperture_offset=0.0,
        f_stop=0.0,
        focus_distance=distance,
        clipping_range=(0.0, 10.0 * (distance + span)),
        exposure_scale=1.0,
    )
    ctx.report.assume("camera", f"the stage has none; framed from {'-Y' if ctx.report.up_axis == 'Z' else '+Z'}")


def conform(horizontal: float, vertical: float, aspect: float, policy: str) -> tuple[float, float]:
    """The apertures changed to the image's aspect (width / height), as aspectRatioConformPolicy says."""
    narrow = aspect < horizontal / vertical  # the image is narrower than the aperture
    fixed_width = {
        "adjustApertureHeight": True,
        "adjustApertureWidth": False,
        "expandAperture": narrow,
        "cropAperture": not narrow,
    }
    if policy not in fixed_width:  # adjustPixelAspectRatio: the apertures stay, the pixels stretch
        return horizontal, vertical
    return (horizontal, horizontal / aspect) if fixed_width[policy] else (vertical * aspect, vertical)


def _image_aspect(ctx: Context, settings: ImageSettings) -> float:
    return ctx.report.width / ctx.report.height * settings.pixel_aspect


def _clipping_range(ctx: Context, camera: Any) -> tuple[float, float]:
    value = camera.GetClippingRangeAttr().Get(ctx.time)
    near, far = (float(value[0]), float(value[1])) if value is not None else (1.0, 1e6)
    if math.isfinite(near) and 0 <= near < far and not math.isnan(far):
        return near, min(far, 1e30)
    ctx.report.leave_out(camera.GetPath(), "clippingRange", f"({near:g}, {far:g}) must be 0 <= near < far")
    return 0.0, 1e30


def _without_scale(world: Doubles) -> Doubles:
    """The matrix with orthonormal axes (Gram-Schmidt from the view axis), mirrored if it was."""
    axes = [world[2, :3], world[1, :3], world[0, :3]]
    done: list[Doubles] = []
    for axis in axes:
        rest = axis / np.linalg.norm(axis)
        for other in done:
            rest = rest - (rest @ other) * other
        done.append(rest / np.linalg.norm(rest))
    rigid = world.copy()
    rigid[2, :3], rigid[1, :3], rigid[0, :3] = done
    rigid[:, 3] = (0.0, 0.0, 0.0, 1.0)
    return rigid


def _cameras(stage: Any) -> list[str]:
    return [str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
