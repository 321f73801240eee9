"""Polygons to triangles: fans for convex faces, ear clipping for concave ones."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from footlight_server.usd.sink import Floats, Indices, Ints
from footlight_server.usd.values import BadValueError, check_indices

_BLOCK = 1 << 17  # corners at a time: what is computed between two passes stays in the cache


@dataclass(frozen=True, slots=True)
class Topology:
    """Faces of a mesh and the triangles they are cut into.

    Attributes:
        point_count: number of points.
        counts: (F,) corners per face.
        indices: (C,) point of each corner.
        corners: (T, 3) triangles as indices into `indices`.
        faces: (T,) face of each triangle.
    """

    point_count: int
    counts: Ints
    indices: Ints
    corners: Indices
    faces: Indices

    @property
    def triangles(self) -> Indices:
        """(T, 3) triangles as point indices."""
        return np.ascontiguousarray(self.indices[self.corners].astype(np.uint32))

    @property
    def face_count(self) -> int:
        """Number of faces, those without area included."""
        return int(self.counts.size)


def check_topology(counts: Ints, indices: Ints, point_count: int) -> None:
    """Raises BadValueError naming the entry that does not fit."""
    if counts.size and int(counts.min()) < 0:
        first = int(np.argmax(counts < 0))
        raise BadValueError(f"faceVertexCounts[{first}] = {int(counts[first])} is negative")
    total = int(counts.sum(dtype=np.int64))
    if total != indices.size:
        raise BadValueError(f"faceVertexCounts add up to {total}, faceVertexIndices has {indices.size} entries")
    check_indices("faceVertexIndices", indices, point_count)


def triangulate(points: Floats, counts: Ints, indices: Ints, holes: Ints, *, left_handed: bool) -> Topology:
    """Cuts checked faces into triangles, in the order of the faces; faces with fewer than 3 corners have none.

    Quads are cut along the diagonal that keeps both halves on one side; larger polygons by a fan from their first
    corner if they are convex, by clipping ears if not.
    """
    starts = np.zeros(counts.size, np.int64)
    np.cumsum(counts[:-1], out=starts[1:])
    present = np.ones(counts.size, bool)
    present[holes] = False
    pieces: list[tuple[Indices, Indices]] = []
    for n in np.unique(counts[present & (counts >= 3)]).tolist():
        faces = np.flatnonzero(present & (counts == n))
        cut = _cut_faces(points, indices, starts[faces], n)  # (faces, n - 2, 3)
        pieces.append((cut.reshape(-1, 3), np.repeat(faces.astype(np.uint32), n - 2)))
    if not pieces:
        corners, owners = np.zeros((0, 3), np.uint32), np.zeros(0, np.uint32)
    elif len(pieces) == 1:
        corners, owners = pieces[0]
    else:
        owners = np.concatenate([owner for _, owner in pieces])
        order = np.argsort(owners, kind="stable")
        corners, owners = np.concatenate([corner for corner, _ in pieces])[order], owners[order]
    if left_handed:
        corners = corners[:, [0, 2, 1]]
    return Topology(len(points), counts, indices, np.ascontiguousarray(corners), owners)


def _cut_faces(points: Floats, indices: Ints, starts: np.ndarray, n: int) -> Indices:
    """Triangles (faces, n - 2, 3), as corners, of faces that all have n corners."""
    first = starts.astype(np.uint32)[:, None, None]
    fan = np.array([[0, k - 1, k] for k in range(2, n)], np.uint32)
    cut = first + fan
    if n == 3:
        return cut
    other = np.array([[1, 2, 3], [1, 3, 0]], np.uint32)
    step = max(1, _BLOCK // n)
    for begin in range(0, len(starts), step):
        block = starts[begin : begin + step]
        columns = [points[indices[block + k]].T.astype(np.float64, order="C") for k in range(n)]
        bent = np.flatnonzero(_is_fan_bad(columns))
        if not bent.size:
            continue
        if n == 4:
            cut[begin + bent] = first[begin + bent] + other
        else:
            for i in bent.tolist():
                cut[begin + i] = block[i] + _clip_ears(np.array([column[:, i] for column in columns]))
    return cut


def _is_fan_bad(corners: list[np.ndarray]) -> np.ndarray:
    """(F,) whether the fan from corner 0 folds back on itself somewhere; corners: n times (3, F)."""
    with np.errstate(all="ignore"):  # huge coordinates: the face keeps its fan
        edges = [corner - corners[0] for corner in corners[1:]]
        normals = [_cross(a, b) for a, b in pairwise(edges)]
        x, y, z = (sum(column[1:], start=column[0]) for column in zip(*normals, strict=True))
        bad = np.zeros(len(x), bool)
        for normal in normals:
            bad |= normal[0] * x + normal[1] * y + normal[2] * z < 0
    return bad


def _cross(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cross products of columns (3, F), as three columns: several times as fast as np.cross of rows."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _clip_ears(polygon: np.ndarray) -> Indices:
    """Triangles (n - 2, 3) of one polygon (n, 3) by ear clipping (Meisters 1975) in the plane of its mean normal."""
    normal = np.cross(polygon - polygon[0], np.roll(polygon, -1, axis=0) - polygon[0]).sum(axis=0)
    drop = int(np.argmax(np.abs(normal)))
    flat = np.delete(polygon, drop, axis=1) * (1.0 if normal[drop] > 0 else -1.0) ** np.array([0, 1])
    if drop == 1:
        flat = flat * np.array([-1.0, 1.0])
    left = list(range(len(polygon)))
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        k = next((k for k in range(len(left)) if _is_ear(flat, left, k)), 0)
        triangles.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles, np.uint32)


def _is_ear(flat: np.ndarray, left: list[int], k: int) -> bool:
    a, b, c = flat[left[k - 1]], flat[left[k]], flat[left[(k + 1) % len(left)]]
    if _area(a, b, c) <= 0:
        return False
    ends = {left[k - 1], left[k], left[(k + 1) % len(left)]}
    others = flat[[i for i in left if i not in ends]]
    inside = (_area(a, b, others) >= 0) & (_area(b, c, others) >= 0) & (_area(c, a, others) >= 0)
    return not bool(inside.any())


def _area(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Twice the signed area of (a, b, p), for one p or many."""
    area: np.ndarray = (b[0] - a[0]) * (p[..., 1] - a[1]) - (b[1] - a[1]) * (p[..., 0] - a[0])
    return area
