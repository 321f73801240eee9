"""Primvars of every interpolation, as values and an index per triangle corner."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import UsdGeom

from footlight_server.usd.sink import Floats, Indices, Ints
from footlight_server.usd.triangulate import Topology
from footlight_server.usd.values import BadValueError, check_finite, check_indices, to_array

OnCorners = tuple[Floats, Indices | None]


@dataclass(frozen=True, slots=True)
class Primvar:
    """values (M, C) float32; indices (K,) or None; interpolation as USD names it."""

    name: str
    values: Floats
    indices: Ints | None
    interpolation: str

    @property
    def count(self) -> int:
        """Number of elements: what the interpolation prescribes."""
        return len(self.values) if self.indices is None else len(self.indices)

    def flat(self) -> Floats:
        """Values (K, C) with the indices applied."""
        return self.values if self.indices is None else np.ascontiguousarray(self.values[self.indices])


def read_primvar(prim: Any, name: str, width: int, time: Any) -> Primvar | None:
    """The primvar of a prim, inherited ones included; None if there is none. Raises BadValueError."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    value = primvar.Get(time)
    if value is None:
        return None
    try:
        len(value)
        is_array = primvar.GetTypeName().isArray
    except TypeError:
        is_array = False
    values = to_array(value if is_array else [value], np.float32, 0 if width == 1 else width)
    indices = to_array(primvar.GetIndices(time), np.int32) if primvar.IsIndexed() else None
    return make_primvar(name, values.reshape(-1, width), indices, primvar.GetInterpolation())


def make_primvar(name: str, values: Floats, indices: Ints | None, interpolation: str) -> Primvar:
    """A checked primvar. Raises BadValueError naming the first bad entry."""
    check_finite(name, values)
    if indices is not None:
        check_indices(f"{name}:indices", indices, len(values))
    return Primvar(name, values, indices, str(interpolation))


def expected_count(interpolation: str, topology: Topology) -> int:
    """How many elements a primvar of that interpolation has."""
    counts = {
        "constant": 1,
        "uniform": topology.face_count,
        "varying": topology.point_count,
        "vertex": topology.point_count,
        "faceVarying": topology.indices.size,
    }
    if interpolation not in counts:
        raise BadValueError(f"unknown interpolation {interpolation}")
    return counts[interpolation]


def check_count(primvar: Primvar, topology: Topology) -> None:
    """Raises BadValueError unless the primvar fits the topology."""
    wanted = expected_count(primvar.interpolation, topology)
    if primvar.count != wanted:
        raise BadValueError(
            f"{primvar.name} ({primvar.interpolation}) has {primvar.count} entries, the mesh needs {wanted}"
        )


def on_corners(primvar: Primvar, topology: Topology) -> OnCorners:
    """Values and (T, 3) indices, or None as indices where the values are one per point. Raises BadValueError."""
    check_count(primvar, topology)
    if primvar.interpolation == "constant":
        return primvar.flat(), np.zeros((len(topology.faces), 3), np.uint32)
    if primvar.interpolation in ("vertex", "varying"):
        if primvar.indices is None:
            return primvar.values, None
        elements: Any = topology.triangles
    elif primvar.interpolation == "uniform":
        elements = np.repeat(topology.faces[:, None], 3, axis=1)
    else:
        elements = topology.corners
    if primvar.indices is not None:
        elements = primvar.indices[elements]
    return primvar.values, np.ascontiguousarray(elements, np.uint32)
