"""Tessellations of the implicit shapes, with exact normals; triangles wind counter-clockwise from outside."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from footlight_server.usd.sink import Floats, Indices

# A chord of 1/128 of a circle is off by 0.03 % of the radius: a third of a pixel on a sphere 1000 pixels in radius.
AROUND = 128
ALONG = 64
_KEPT = 64  # shapes; only cylinders and capsules come in many ratios
_TINY = 1e-12  # of a unit radius: the poles, where sin(pi) is not quite 0


@dataclass(frozen=True, slots=True)
class Shape:
    """points (N, 3), triangles (T, 3), normals (M, 3) and normal_indices (T, 3) or None for one per point."""

    points: Floats
    triangles: Indices
    normals: Floats
    normal_indices: Indices | None


@lru_cache(maxsize=_KEPT)
def sphere() -> Shape:
    """Radius 1, poles on Z."""
    angles = np.linspace(0.0, math.pi, ALONG + 1)
    return _revolve(np.sin(angles), -np.cos(angles), np.sin(angles), -np.cos(angles))


@lru_cache(maxsize=_KEPT)
def cylinder(top: float = 1.0, bottom: float = 1.0) -> Shape:
    """Around Z from -1/2 to 1/2 with flat caps; radii at the top and bottom, one of them 1, the other 0 to 1."""
    slope = bottom - top  # the height is 1
    side = np.array([1.0, slope]) / math.hypot(1.0, slope)
    parts = [_revolve(np.array([bottom, top]), np.array([-0.5, 0.5]), side[[0, 0]], side[[1, 1]])]
    if bottom > 0:
        parts.append(_revolve(np.array([0.0, bottom]), np.full(2, -0.5), np.zeros(2), np.full(2, -1.0)))
    if top > 0:
        parts.append(_revolve(np.array([top, 0.0]), np.full(2, 0.5), np.zeros(2), np.full(2, 1.0)))
    return _join(parts)


@lru_cache(maxsize=_KEPT)
def cone() -> Shape:
    """Around Z: radius 1 at -1/2, the apex at 1/2."""
    return cylinder(top=0.0, bottom=1.0)


@lru_cache(maxsize=_KEPT)
def capsule(height: float, top: float = 1.0, bottom: float = 1.0) -> Shape:
    """Around Z: a spine of `height` between caps that meet the side without a crease (Capsule_1); radii per cap."""
    tilt = math.atan2(bottom - top, height) if height > 0 else 0.0
    half = ALONG // 2
    low = np.linspace(-math.pi / 2, tilt, half + 1)
    high = np.linspace(tilt, math.pi / 2, half + 1)
    radial = np.concatenate([np.cos(low), np.cos(high)])
    axial = np.concatenate([np.sin(low), np.sin(high)])
    if tilt == 0.0:
        centres = -height / 2, height / 2
    else:
        # The sphere of radius R is tangent to the side at height h: its centre is R sin(tilt) below that point.
        bottom, top = bottom / math.cos(tilt), top / math.cos(tilt)
        centres = -height / 2 - bottom * math.sin(tilt), height / 2 - top * math.sin(tilt)
    rho = np.concatenate([bottom * np.cos(low), top * np.cos(high)])
    z = np.concatenate([bottom * np.sin(low) + centres[0], top * np.sin(high) + centres[1]])
    return _revolve(rho, z, radial, axial)


@lru_cache(maxsize=_KEPT)
def cube() -> Shape:
    """Edge 1, six flat faces."""
    sides = []
    for axis in range(3):
        for sign in (-0.5, 0.5):
            corners = np.zeros((4, 3))
            corners[:, axis] = sign
            corners[:, (axis + 1) % 3] = np.array([-0.5, 0.5, 0.5, -0.5]) * math.copysign(1.0, sign)
            corners[:, (axis + 2) % 3] = [-0.5, -0.5, 0.5, 0.5]
            normal = np.zeros((4, 3))
            normal[:, axis] = math.copysign(1.0, sign)
            sides.append(_shape(corners, np.array([[0, 1, 2], [0, 2, 3]]), normal))
    return _join(sides)


@lru_cache(maxsize=_KEPT)
def plane() -> Shape:
    """Edges 1 along X and Y, facing +Z."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    return _shape(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0.0, 0.0, 1.0], (4, 1)))


def _shape(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> Shape:
    return Shape(
        np.ascontiguousarray(points, np.float32),
        np.ascontiguousarray(triangles, np.uint32),
        np.ascontiguousarray(normals, np.float32),
        None,
    )


def _revolve(rho: np.ndarray, z: np.ndarray, normal_rho: np.ndarray, normal_z: np.ndarray) -> Shape:
    """A profile from bottom to top (or, for a cap, such that its right side is outside) turned around Z."""
    angles = np.arange(AROUND) * (2.0 * math.pi / AROUND)
    cos, sin = np.cos(angles), np.sin(angles)

    def turned(radius: np.ndarray, height: np.ndarray) -> np.ndarray:
        return np.stack(
            [np.outer(radius, cos), np.outer(radius, sin), np.repeat(height[:, None], AROUND, axis=1)], axis=-1
        )

    rings = len(rho)
    points = turned(rho, z)
    normals = turned(normal_rho, normal_z)
    ring, step = np.meshgrid(np.arange(rings - 1), np.arange(AROUND), indexing="ij")
    a = ring * AROUND + step
    b = ring * AROUND + (step + 1) % AROUND
    lower = np.stack([a, b, b + AROUND], axis=-1)[rho[:-1] > _TINY]
    upper = np.stack([a, b + AROUND, a + AROUND], axis=-1)[rho[1:] > _TINY]
    triangles = np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    return _shape(points.reshape(-1, 3), triangles, normals.reshape(-1, 3))


def _join(parts: list[Shape]) -> Shape:
    offsets = np.cumsum([0] + [len(part.points) for part in parts])
    return Shape(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.triangles + np.uint32(o) for part, o in zip(parts, offsets, strict=False)]),
        np.concatenate([part.normals for part in parts]),
        None,
    )
