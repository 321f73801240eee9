"""PointInstancer: which prototype goes where."""

from typing import Any

import numpy as np
from pxr import UsdGeom

from footlight_server.usd.context import Context
from footlight_server.usd.sink import Doubles
from footlight_server.usd.values import BadValueError, determinants, read_floats, read_ints, to_array


def read_placements(ctx: Context, prim: Any) -> list[tuple[Any, Doubles]]:
    """(prototype path, transforms (K, 4, 4) in the instancer's space) per prototype. Raises BadValueError.

    Instances that cannot be placed are left out with one line per reason.
    """
    instancer = UsdGeom.PointInstancer(prim)
    targets = instancer.GetPrototypesRel().GetForwardedTargets()
    prototypes = read_ints(instancer.GetProtoIndicesAttr(), ctx.time)
    if not targets:
        raise BadValueError("has no prototypes")
    if not prototypes.size:
        raise BadValueError(f"has no protoIndices at time {ctx.time}")
    transforms, bad = _transforms(ctx, instancer, prototypes.size)
    shown = _mask(ctx, instancer, prototypes.size)
    unknown = (prototypes < 0) | (prototypes >= len(targets))
    _leave_out_some(ctx, prim, "protoIndices", f"outside [0, {len(targets)})", unknown & shown)
    _leave_out_some(ctx, prim, "instances", "a position, orientation or scale that is not finite", bad & shown)
    with np.errstate(all="ignore"):
        singular = determinants(transforms) == 0
    _leave_out_some(ctx, prim, "instances", "a singular transform (determinant 0)", singular & ~bad & shown)
    shown &= ~(unknown | bad | singular)
    return [(target, np.ascontiguousarray(transforms[shown & (prototypes == i)])) for i, target in enumerate(targets)]


def _leave_out_some(ctx: Context, prim: Any, what: str, reason: str, mask: np.ndarray) -> None:
    count = int(np.count_nonzero(mask))
    if count:
        ctx.report.leave_out(
            prim.GetPath(), what, f"{count} of {mask.size} instances have {reason}, the first is {int(np.argmax(mask))}"
        )


def _mask(ctx: Context, instancer: Any, count: int) -> np.ndarray:
    """Instances that are neither invisible nor inactive (invisibleIds, inactiveIds, ids)."""
    ids = to_array(instancer.GetIdsAttr().Get(ctx.time), np.int64)
    if ids.size not in (0, count):
        ctx.report.leave_out(instancer.GetPath(), "ids", f"has {ids.size} entries for {count} instances")
        return np.ones(count, bool)
    mask = np.array(instancer.ComputeMaskAtTime(ctx.time), bool)
    return mask if mask.size == count else np.ones(count, bool)  # empty: all of them


def _transforms(ctx: Context, instancer: Any, count: int) -> tuple[Doubles, np.ndarray]:
    """Scale, then orientation, then position, (K, 4, 4); and which of them are not finite."""
    positions = _read(instancer.GetPositionsAttr(), ctx, 3, count)
    if positions is None:
        raise BadValueError(f"has no positions at time {ctx.time}")
    scales = _read(instancer.GetScalesAttr(), ctx, 3, count)
    rotations = _orientations(ctx, instancer, count)
    matrices = np.zeros((count, 4, 4))
    matrices[:, 3, 3] = 1.0
    matrices[:, 3, :3] = positions
    matrices[:, :3, :3] = np.eye(3) if rotations is None else rotations
    if scales is not None:
        matrices[:, :3, :3] *= scales[:, :, None]
    bad = np.logical_not(np.isfinite(matrices).all(axis=(1, 2)))
    return matrices, np.asarray(bad)


def _orientations(ctx: Context, instancer: Any, count: int) -> Doubles | None:
    """(K, 3, 3) rotations; orientationsf before orientations."""
    precise = instancer.GetOrientationsfAttr()
    if precise and precise.HasAuthoredValue():
        quaternions = _read(precise, ctx, 4, count)
        if quaternions is not None:
            return _rotations(quaternions)
    quaternions = _read(instancer.GetOrientationsAttr(), ctx, 4, count)
    return None if quaternions is None else _rotations(quaternions)


def _read(attribute: Any, ctx: Context, width: int, count: int) -> Doubles | None:
    """(count, width), or None if the attribute is empty. Raises BadValueError."""
    values = read_floats(attribute, ctx.time, width)
    if not len(values):
        return None
    if len(values) != count:
        raise BadValueError(f"{attribute.GetName()} has {len(values)} entries for {count} instances")
    return values.astype(np.float64)


def _rotations(quaternions: Doubles) -> Doubles:
    """Rotation matrices (K, 3, 3), row vectors, of (x, y, z, w); a zero quaternion turns nothing."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit = np.where(lengths > 0, quaternions / np.where(lengths > 0, lengths, 1.0), [0.0, 0.0, 0.0, 1.0])
    unit[~np.isfinite(quaternions).all(axis=1)] = np.nan
    x, y, z, w = unit.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
        [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
        [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
