"""Mesh: polygons, normals and primvars of every interpolation, subdivision, one mesh per material subset."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import UsdGeom, UsdShade

from footlight_server.usd.context import Context
from footlight_server.usd.prims.materials import Look
from footlight_server.usd.prims.subdivision import choose_level, subdivide
from footlight_server.usd.primvars import OnCorners, Primvar, check_count, make_primvar, on_corners, read_primvar
from footlight_server.usd.sink import Floats, Indices, Ints
from footlight_server.usd.triangulate import Topology, check_topology, triangulate
from footlight_server.usd.values import BadValueError, check_finite, check_indices, read_floats, read_ints

_SUBDIVIDED = ("catmullClark", "loop")


@dataclass(slots=True)
class Geometry:
    """Triangles ready for the sink: normals and primvars are (values, indices per corner or None for one per point)."""

    points: Floats
    triangles: Indices
    faces: Indices  # (T,) face of the mesh each triangle came from
    normals: OnCorners | None = None
    colors: OnCorners | None = None
    opacities: OnCorners | None = None

    def only(self, chosen: np.ndarray) -> "Geometry":
        """The triangles where `chosen` (T,) is true, and no more points than they need."""
        used, compact = np.unique(self.triangles[chosen], return_inverse=True)

        def cut(primvar: OnCorners | None) -> OnCorners | None:
            if primvar is None:
                return None
            values, indices = primvar
            return (values[used], None) if indices is None else (values, np.ascontiguousarray(indices[chosen]))

        return Geometry(
            np.ascontiguousarray(self.points[used]),
            np.ascontiguousarray(compact.reshape(-1, 3).astype(np.uint32)),
            self.faces[chosen],
            cut(self.normals),
            cut(self.colors),
            cut(self.opacities),
        )


def translate_mesh(ctx: Context, prim: Any) -> list[tuple[int, None]]:
    """Ids of the meshes of one prim; what cannot be used is a line in the report."""
    path = str(prim.GetPath())
    try:
        looks = _looks_of_faces(ctx, prim)
        geometry = _read(ctx, UsdGeom.Mesh(prim), [look for look, _ in looks])
        if len(looks) == 1:
            pieces = [(looks[0][0], geometry)]
        else:
            pieces = [(look, geometry.only(mask[geometry.faces])) for look, mask in looks if mask is not None]
        return [(add_mesh(ctx, path, look, piece), None) for look, piece in pieces if len(piece.triangles)]
    except ValueError as error:  # a bad value found here, or refused by the sink
        ctx.report.leave_out(path, "Mesh", str(error))
        return []


def add_mesh(ctx: Context, path: str, look: Look, geometry: Geometry) -> int:
    """Hands one piece of geometry to the sink, with the primvars that its look reads."""
    normals = geometry.normals or (None, None)
    colors = (geometry.colors if look.reads_color else None) or (None, None)
    opacities = (geometry.opacities if look.reads_opacity else None) or (None, None)
    values = opacities[0]
    if values is not None:
        values = np.clip(values.reshape(-1), 0.0, 1.0)
        if look.opacity_threshold > 0:
            values = (values >= look.opacity_threshold).astype(np.float32)
    ctx.count("points", len(geometry.points), path)
    ctx.count("triangles", len(geometry.triangles), path)
    ctx.count("meshes", 1, path)
    mesh = ctx.sink.add_mesh(
        path=path,
        material=look.id,
        points=geometry.points,
        triangles=geometry.triangles,
        normals=normals[0],
        normal_indices=normals[1],
        colors=colors[0],
        color_indices=colors[1],
        opacities=values,
        opacity_indices=opacities[1],
    )
    ctx.mesh_bounds[mesh] = np.stack([geometry.points.min(axis=0), geometry.points.max(axis=0)])
    return mesh


def _looks_of_faces(ctx: Context, prim: Any) -> list[tuple[Look, np.ndarray | None]]:
    """The prim's looks with the faces (F,) each one covers; a single look covers all of them (None)."""
    whole = ctx.looks.of_prim(prim)
    subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
    if not subsets:
        return [(whole, None)]
    face_count = len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get(ctx.time) or ())
    owner = np.full(face_count, -1, np.int64)
    looks: list[Look] = []
    for subset in subsets:
        try:
            faces = _faces_of_subset(ctx, subset, face_count)
        except BadValueError as error:
            ctx.report.leave_out(subset.GetPath(), "GeomSubset", str(error))
            continue
        faces = faces[owner[faces] < 0]  # a face in two subsets keeps the first
        owner[faces] = len(looks)
        looks.append(ctx.looks.of_prim(subset.GetPrim()))
    owner[owner < 0] = len(looks)
    looks.append(whole)
    return [(look, owner == i) for i, look in enumerate(looks)]


def _faces_of_subset(ctx: Context, subset: Any, face_count: int) -> Ints:
    if str(subset.GetElementTypeAttr().Get(ctx.time)) != "face":
        raise BadValueError("its elements are not faces")
    faces = read_ints(subset.GetIndicesAttr(), ctx.time)
    check_indices("indices", faces, face_count)
    return faces


def _read(ctx: Context, mesh: Any, looks: list[Look]) -> Geometry:
    path = mesh.GetPath()
    points = read_floats(mesh.GetPointsAttr(), ctx.time, 3)
    counts = read_ints(mesh.GetFaceVertexCountsAttr(), ctx.time)
    indices = read_ints(mesh.GetFaceVertexIndicesAttr(), ctx.time)
    check_finite("points", points)
    check_topology(counts, indices, len(points))
    if not counts.size:
        raise BadValueError(f"has no faces at time {ctx.time}")
    small = int(np.count_nonzero(counts < 3))
    if small:
        ctx.report.leave_out(path, "faces", f"{small} of {counts.size} have fewer than 3 points")
        if small == counts.size:
            raise BadValueError("has no face with 3 points")
    left_handed = str(mesh.GetOrientationAttr().Get(ctx.time)) == "leftHanded"
    topology = triangulate(points, counts, indices, _read_holes(ctx, mesh, counts.size), left_handed=left_handed)
    colors = _read_or_leave_out(ctx, mesh.GetPrim(), "displayColor", 3) if any(k.reads_color for k in looks) else None
    opacities = (
        _read_or_leave_out(ctx, mesh.GetPrim(), "displayOpacity", 1) if any(k.reads_opacity for k in looks) else None
    )
    if str(mesh.GetSubdivisionSchemeAttr().Get(ctx.time)) in _SUBDIVIDED:
        level, reason = choose_level(indices.size, ctx.request.refinement)
        if level > 0:
            return _subdivided(ctx, mesh, points, topology, colors, opacities, level, reason, left_handed=left_handed)
    return Geometry(
        points,
        topology.triangles,
        topology.faces,
        _on_corners(ctx, path, _read_normals(ctx, mesh), topology),
        _on_corners(ctx, path, colors, topology),
        _on_corners(ctx, path, opacities, topology),
    )


def _subdivided(
    ctx: Context,
    mesh: Any,
    points: Floats,
    topology: Topology,
    colors: Primvar | None,
    opacities: Primvar | None,
    level: int,
    reason: str,
    *,
    left_handed: bool,
) -> Geometry:
    path = str(mesh.GetPath())
    wanted = {"colors": colors, "opacities": opacities}
    for name, primvar in wanted.items():
        if primvar is not None and not _fits(ctx, path, primvar, topology):
            wanted[name] = None
    smooth = {k: p for k, p in wanted.items() if p is not None and p.interpolation not in ("constant", "uniform")}
    surface = subdivide(ctx, mesh, points, topology, level, list(smooth.values()))
    ctx.refined.setdefault(reason, []).append(path)
    geometry = Geometry(surface.points, surface.triangles, surface.faces, (surface.normals, surface.normal_indices))
    refined: dict[str, OnCorners | None] = dict(zip(smooth, surface.primvars, strict=True))
    for name, primvar in wanted.items():
        if primvar is not None and name not in smooth:
            refined[name] = _by_face(primvar, surface.faces)
    geometry.colors, geometry.opacities = refined.get("colors"), refined.get("opacities")
    if left_handed:
        _turn_over(geometry)
    return geometry


def _turn_over(geometry: Geometry) -> None:
    """The same surface seen from the other side."""
    flip = [0, 2, 1]

    def flipped(primvar: OnCorners | None) -> OnCorners | None:
        if primvar is None or primvar[1] is None:
            return primvar
        return primvar[0], np.ascontiguousarray(primvar[1][:, flip])

    geometry.triangles = np.ascontiguousarray(geometry.triangles[:, flip])
    geometry.colors, geometry.opacities = flipped(geometry.colors), flipped(geometry.opacities)
    if geometry.normals is not None:
        normals = flipped((-geometry.normals[0], geometry.normals[1]))
        geometry.normals = normals


def _by_face(primvar: Primvar, faces: Indices) -> OnCorners:
    """A constant or uniform primvar on triangles of the given faces."""
    elements: Any = np.zeros(len(faces), np.uint32) if primvar.interpolation == "constant" else faces
    if primvar.indices is not None:
        elements = primvar.indices[elements].astype(np.uint32)
    return primvar.values, np.ascontiguousarray(np.repeat(elements[:, None], 3, axis=1))


def _read_holes(ctx: Context, mesh: Any, face_count: int) -> Ints:
    holes = read_ints(mesh.GetHoleIndicesAttr(), ctx.time)
    try:
        check_indices("holeIndices", holes, face_count)
    except BadValueError as error:
        ctx.report.leave_out(mesh.GetPath(), "holeIndices", str(error))
        return holes[(holes >= 0) & (holes < face_count)]
    return holes


def _read_normals(ctx: Context, mesh: Any) -> Primvar | None:
    """primvars:normals before normals (UsdGeomPointBased); None: the faces' own."""
    try:
        primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
        if primvar and primvar.HasValue():
            return read_primvar(mesh.GetPrim(), "normals", 3, ctx.time)
        normals = read_floats(mesh.GetNormalsAttr(), ctx.time, 3)
        return make_primvar("normals", normals, None, mesh.GetNormalsInterpolation()) if len(normals) else None
    except BadValueError as error:
        ctx.report.leave_out(mesh.GetPath(), "normals", str(error))
        return None


def _read_or_leave_out(ctx: Context, prim: Any, name: str, width: int) -> Primvar | None:
    try:
        return read_primvar(prim, name, width, ctx.time)
    except BadValueError as error:
        ctx.report.leave_out(prim.GetPath(), f"primvars:{name}", str(error))
        return None


def _fits(ctx: Context, path: object, primvar: Primvar, topology: Topology) -> bool:
    try:
        check_count(primvar, topology)
    except BadValueError as error:
        ctx.report.leave_out(path, primvar.name, str(error))
        return False
    return True


def _on_corners(ctx: Context, path: object, primvar: Primvar | None, topology: Topology) -> OnCorners | None:
    if primvar is None or not _fits(ctx, path, primvar, topology):
        return None
    return on_corners(primvar, topology)
