"""The implicit shapes: Sphere, Cube, Cylinder, Cone, Capsule, Plane, as tessellated unit shapes under a transform.

Prims of the same shape and look share one mesh, so that thousands of spheres cost one sphere.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from pxr import UsdGeom

from footlight_server.usd import shapes
from footlight_server.usd.context import Context
from footlight_server.usd.prims.mesh import Geometry, add_mesh
from footlight_server.usd.primvars import OnCorners, Primvar, read_primvar
from footlight_server.usd.shapes import Shape
from footlight_server.usd.sink import Doubles
from footlight_server.usd.values import BadValueError, read_number

# A shape along Z, its key among the shared meshes, and its size along X, Y and Z.
Sized = tuple[Shape, tuple[object, ...], tuple[float, float, float]]


def translate_shape(ctx: Context, prim: Any) -> list[tuple[int, Doubles]]:
    """The mesh of an implicit shape, and the transform from the unit shape to the prim."""
    try:
        shape, key, size = _SHAPES[str(prim.GetTypeName())](ctx, prim)
    except BadValueError as error:
        ctx.report.leave_out(prim.GetPath(), str(prim.GetTypeName()), str(error))
        return []
    look = ctx.looks.of_prim(prim)
    colors = _constant(ctx, prim, "displayColor", 3) if look.reads_color else None
    opacities = _constant(ctx, prim, "displayOpacity", 1) if look.reads_opacity else None
    left_handed = str(UsdGeom.Gprim(prim).GetOrientationAttr().Get(ctx.time)) == "leftHanded"
    mesh_key: tuple[object, ...] = (*key, look.id, left_handed, _bytes(colors), _bytes(opacities))
    mesh = ctx.shape_meshes.get(mesh_key)
    if mesh is None:
        mesh = add_mesh(ctx, str(prim.GetPath()), look, _geometry(shape, colors, opacities, left_handed=left_handed))
        ctx.shape_meshes[mesh_key] = mesh
    scale = np.diag([*size, 1.0])
    return [(mesh, scale @ _axis(ctx, prim))]


def _geometry(shape: Shape, colors: Primvar | None, opacities: Primvar | None, *, left_handed: bool) -> Geometry:
    zeros = np.zeros((len(shape.triangles), 3), np.uint32)

    def constant(primvar: Primvar | None) -> OnCorners | None:
        return None if primvar is None else (primvar.flat(), zeros)

    triangles = np.ascontiguousarray(shape.triangles[:, [0, 2, 1]]) if left_handed else shape.triangles
    normals = -shape.normals if left_handed else shape.normals
    return Geometry(shape.points, triangles, zeros[:, 0], (normals, None), constant(colors), constant(opacities))


def _constant(ctx: Context, prim: Any, name: str, width: int) -> Primvar | None:
    try:
        primvar = read_primvar(prim, name, width, ctx.time)
        if primvar is not None and primvar.count != 1:
            raise BadValueError(f"{primvar.count} entries ({primvar.interpolation}): an implicit shape can use one")
    except BadValueError as error:
        ctx.report.leave_out(prim.GetPath(), f"primvars:{name}", str(error))
        return None
    return primvar


def _bytes(primvar: Primvar | None) -> bytes:
    return b"" if primvar is None else primvar.flat().tobytes()


def _axis(ctx: Context, prim: Any) -> Doubles:
    """Turns Z to the prim's axis, the other axes following in order."""
    attribute = prim.GetAttribute("axis")
    axis = str(attribute.Get(ctx.time)) if attribute else "Z"
    matrix = np.eye(4)
    if axis in ("X", "Y"):
        matrix[:3, :3] = np.roll(np.eye(3), 1 if axis == "X" else 2, axis=1)
    return matrix


def _length(ctx: Context, prim: Any, name: str) -> float:
    """A size above 0. Raises BadValueError."""
    value = read_number(prim.GetAttribute(name), ctx.time, 1.0)
    if value <= 0:
        raise BadValueError(f"{name} = {value:g} is not above 0")
    return value


def _sphere(ctx: Context, prim: Any) -> Sized:
    radius = _length(ctx, prim, "radius")
    return shapes.sphere(), ("sphere",), (radius, radius, radius)


def _cube(ctx: Context, prim: Any) -> Sized:
    size = _length(ctx, prim, "size")
    return shapes.cube(), ("cube",), (size, size, size)


def _cylinder(ctx: Context, prim: Any) -> Sized:
    radius = _length(ctx, prim, "radius")
    return shapes.cylinder(), ("cylinder", 1.0, 1.0), (radius, radius, _length(ctx, prim, "height"))


def _cone(ctx: Context, prim: Any) -> Sized:
    radius = _length(ctx, prim, "radius")
    return shapes.cone(), ("cone",), (radius, radius, _length(ctx, prim, "height"))


def _two_radii(ctx: Context, prim: Any) -> tuple[float, float, float]:
    """Top and bottom as parts of the larger radius, and that radius."""
    top = read_number(prim.GetAttribute("radiusTop"), ctx.time, 1.0)
    bottom = read_number(prim.GetAttribute("radiusBottom"), ctx.time, 1.0)
    radius = max(top, bottom)
    if min(top, bottom) < 0 or radius <= 0:
        raise BadValueError(f"radiusTop = {top:g}, radiusBottom = {bottom:g}: one must be above 0, none below")
    return top / radius, bottom / radius, radius


def _cylinder_1(ctx: Context, prim: Any) -> Sized:
    top, bottom, radius = _two_radii(ctx, prim)
    height = _length(ctx, prim, "height")
    return shapes.cylinder(top, bottom), ("cylinder", top, bottom), (radius, radius, height)


def _capsule(ctx: Context, prim: Any) -> Sized:
    radius = _length(ctx, prim, "radius")
    return _capsule_of(ctx, prim, 1.0, 1.0, radius)


def _capsule_1(ctx: Context, prim: Any) -> Sized:
    return _capsule_of(ctx, prim, *_two_radii(ctx, prim))


def _capsule_of(ctx: Context, prim: Any, top: float, bottom: float, radius: float) -> Sized:
    height = read_number(prim.GetAttribute("height"), ctx.time, 1.0)
    if height < 0:
        raise BadValueError(f"height = {height:g} is negative")
    shape = shapes.capsule(height / radius, top, bottom)
    return shape, ("capsule", height / radius, top, bottom), (radius, radius, radius)


def _plane(ctx: Context, prim: Any) -> Sized:
    width, length = _length(ctx, prim, "width"), _length(ctx, prim, "length")
    axis = str(prim.GetAttribute("axis").Get(ctx.time))
    # Width runs along X for axes Y and Z, along Z for axis X; the unit plane's X turns to Y (axis X) or Z (axis Y).
    return shapes.plane(), ("plane",), (width, length, 1.0) if axis == "Z" else (length, width, 1.0)


_SHAPES: dict[str, Callable[[Context, Any], Sized]] = {
    "Sphere": _sphere,
    "Cube": _cube,
    "Cylinder": _cylinder,
    "Cylinder_1": _cylinder_1,
    "Cone": _cone,
    "Capsule": _capsule,
    "Capsule_1": _capsule_1,
    "Plane": _plane,
}
SHAPE_TYPES = tuple(_SHAPES)
