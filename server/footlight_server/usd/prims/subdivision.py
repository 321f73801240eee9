"""Subdivision surfaces: the cage as USD describes it, to triangles on the limit surface."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from footlight_server.usd.context import Context
from footlight_server.usd.primvars import Primvar, check_count
from footlight_server.usd.sink import Floats, Indices, Ints
from footlight_server.usd.triangulate import Topology
from footlight_server.usd.values import BadValueError, check_indices, read_floats, read_ints

# Level n makes a quad of every corner of the cage and cuts it 4^(n-1) times. Small cages are seen large and cost
# little: the level is the highest of 1..4 (64 quads around a cube) whose surface stays below this many quads.
AUTOMATIC_QUADS = 20_000
_AUTOMATIC_LEVELS = range(4, 0, -1)


@dataclass(frozen=True, slots=True)
class Surface:
    """Triangles on the limit surface; primvars in the order they were given."""

    points: Floats
    triangles: Indices
    normals: Floats
    normal_indices: Indices
    faces: Indices
    primvars: list[tuple[Floats, Indices]]


def choose_level(corners: int, refinement: int | None) -> tuple[int, str]:
    """The level for a cage with that many corners, and the reason in words; 0 draws the cage."""
    if refinement is not None:
        return min(max(refinement, 0), 10), f"level {min(max(refinement, 0), 10)}, as asked for"
    level = next((n for n in _AUTOMATIC_LEVELS if corners * 4 ** (n - 1) <= AUTOMATIC_QUADS), 1)
    return level, f"level {level}, the highest of 1..4 with at most {AUTOMATIC_QUADS} quads per mesh, else 1"


def subdivide(
    ctx: Context, mesh: Any, points: Floats, topology: Topology, level: int, primvars: list[Primvar]
) -> Surface:
    """The limit surface of a UsdGeom.Mesh; primvars are vertex, varying or faceVarying. Raises BadValueError."""
    counts, indices, kept = _faces(topology)
    scheme = str(mesh.GetSubdivisionSchemeAttr().Get(ctx.time))
    columns = []
    for primvar in primvars:
        check_count(primvar, topology)
        columns.append(_column(primvar, kept))
    try:
        out = ctx.subdivide(
            points,
            counts,
            indices,
            scheme,
            level,
            boundary=str(mesh.GetInterpolateBoundaryAttr().Get(ctx.time)),
            face_varying=str(mesh.GetFaceVaryingLinearInterpolationAttr().Get(ctx.time)),
            triangle_rule=str(mesh.GetTriangleSubdivisionRuleAttr().Get(ctx.time)),
            holes=_holes(ctx, mesh, topology),
            primvars=columns,
            **_sharpness(ctx, mesh, len(points)),
        )
    except ValueError as error:
        raise BadValueError(str(error)) from error
    faces = out["face_of_triangle"]
    if kept is not None:
        faces = np.ascontiguousarray(np.flatnonzero(topology.counts >= 3).astype(np.uint32)[faces])
    return Surface(out["points"], out["triangles"], out["normals"], out["normal_indices"], faces, list(out["primvars"]))


def _faces(topology: Topology) -> tuple[Ints, Ints, np.ndarray | None]:
    """Counts and indices without faces of fewer than 3 corners; the mask of the corners kept, None for all of them."""
    good = topology.counts >= 3
    if good.all():
        return topology.counts, topology.indices, None
    kept = np.repeat(good, topology.counts)
    return topology.counts[good], topology.indices[kept], kept


def _column(primvar: Primvar, kept: np.ndarray | None) -> tuple[str, Floats, Ints | None]:
    if primvar.interpolation != "faceVarying":
        return primvar.interpolation, primvar.flat(), None
    indices = primvar.indices
    if kept is not None:
        indices = (np.arange(kept.size, dtype=np.int32) if indices is None else indices)[kept]
    return "faceVarying", primvar.values, indices


def _holes(ctx: Context, mesh: Any, topology: Topology) -> Ints:
    holes = read_ints(mesh.GetHoleIndicesAttr(), ctx.time)
    holes = holes[(holes >= 0) & (holes < topology.face_count)]  # the others are reported where the faces are cut
    good = topology.counts >= 3
    if good.all() or not holes.size:
        return holes
    numbers = np.cumsum(good) - 1
    return np.ascontiguousarray(numbers[holes[good[holes]]].astype(np.int32))


def _sharpness(ctx: Context, mesh: Any, point_count: int) -> dict[str, Any]:
    """Creases and corners; those that cannot be used are reported and the mesh stays smooth there."""
    found: dict[str, Any] = {}
    creases = {
        "crease_indices": read_ints(mesh.GetCreaseIndicesAttr(), ctx.time),
        "crease_lengths": read_ints(mesh.GetCreaseLengthsAttr(), ctx.time),
        "crease_sharpnesses": read_floats(mesh.GetCreaseSharpnessesAttr(), ctx.time, 0),
    }
    corners = {
        "corner_indices": read_ints(mesh.GetCornerIndicesAttr(), ctx.time),
        "corner_sharpnesses": read_floats(mesh.GetCornerSharpnessesAttr(), ctx.time, 0),
    }
    for what, values, check in (("creases", creases, _check_creases), ("corners", corners, _check_corners)):
        if not any(array.size for array in values.values()):
            continue
        try:
            check(values, point_count)
        except BadValueError as error:
            ctx.report.leave_out(mesh.GetPath(), what, str(error))
        else:
            found.update(values)
    return found


def _check_creases(values: dict[str, Any], point_count: int) -> None:
    lengths, sharpnesses = values["crease_lengths"], values["crease_sharpnesses"]
    check_indices("creaseIndices", values["crease_indices"], point_count)
    if lengths.size and int(lengths.min()) < 2:
        raise BadValueError(f"creaseLengths[{int(np.argmin(lengths))}] = {int(lengths.min())} is below 2")
    total = int(lengths.sum(dtype=np.int64))
    if total != values["crease_indices"].size:
        raise BadValueError(
            f"creaseLengths add up to {total}, creaseIndices has {values['crease_indices'].size} entries"
        )
    if sharpnesses.size not in (lengths.size, total - lengths.size):
        raise BadValueError(f"creaseSharpnesses has {sharpnesses.size} entries for {lengths.size} creases")
    _check_sharpnesses("creaseSharpnesses", sharpnesses)


def _check_corners(values: dict[str, Any], point_count: int) -> None:
    check_indices("cornerIndices", values["corner_indices"], point_count)
    if values["corner_indices"].size != values["corner_sharpnesses"].size:
        raise BadValueError("cornerIndices and cornerSharpnesses differ in length")
    _check_sharpnesses("cornerSharpnesses", values["corner_sharpnesses"])


def _check_sharpnesses(name: str, sharpnesses: Floats) -> None:
    """Infinite is allowed: it means sharp for ever."""
    bad = np.isnan(sharpnesses) | (sharpnesses < 0)
    if bad.any():
        raise BadValueError(f"{name}[{int(np.argmax(bad))}] is negative or not a number")
