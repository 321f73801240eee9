"""Attribute values as numpy arrays and checked numbers."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from footlight_server.usd.sink import Doubles, Floats, Ints


class BadValueError(ValueError):
    """A value that cannot be used; the message is the reason in the report."""


def to_array(value: Any, dtype: DTypeLike, width: int = 0) -> NDArray[Any]:
    """A Vt array as numpy, (n,) or (n, width), without a copy where the type allows; None is an empty array."""
    shape = (0, width) if width else (0,)
    if value is None or len(value) == 0:
        return np.zeros(shape, dtype)
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise BadValueError(f"not an array of numbers: {error}") from error
    if array.dtype.kind not in "fiub" or array.ndim != len(shape) or array.shape[1:] != shape[1:]:
        raise BadValueError(f"not an array of {max(width, 1)} number(s) per entry")
    return np.ascontiguousarray(array, dtype)


def read_floats(attribute: Any, time: Any, width: int) -> Floats:
    """An attribute's value, (n, width) float32; empty without a value."""
    return to_array(attribute.Get(time), np.float32, width)


def read_ints(attribute: Any, time: Any) -> Ints:
    """An attribute's value, (n,) int32; empty without a value."""
    return to_array(attribute.Get(time), np.int32)


def check_finite(what: str, values: NDArray[Any]) -> None:
    """Raises BadValueError naming the first entry that is NaN or infinite."""
    finite = np.isfinite(values)
    if not finite.all():
        rows = finite if finite.ndim == 1 else finite.all(axis=tuple(range(1, finite.ndim)))
        first = int(np.argmin(rows))
        count = int(rows.size - np.count_nonzero(rows))
        raise BadValueError(f"{what}[{first}] is not finite ({count} of {rows.size} are not)")


def check_indices(what: str, indices: Ints, end: int) -> None:
    """Raises BadValueError naming the first index outside [0, end)."""
    if indices.size and (int(indices.min()) < 0 or int(indices.max()) >= end):
        first = int(np.argmax((indices < 0) | (indices >= end)))
        raise BadValueError(f"{what}[{first}] = {int(indices[first])} is outside [0, {end})")


def read_number(attribute: Any, time: Any, default: float) -> float:
    """A finite number; the default without a value. Raises BadValueError."""
    value = attribute.Get(time) if attribute else None
    if value is None:
        return default
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise BadValueError(f"{attribute.GetName()} = {value} is not a finite number")
    return float(value)


def read_color(attribute: Any, time: Any, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Three finite numbers; the default without a value. Raises BadValueError."""
    value = attribute.Get(time) if attribute else None
    if value is None:
        return default
    try:
        red, green, blue = (float(component) for component in value)
    except (TypeError, ValueError) as error:
        raise BadValueError(f"{attribute.GetName()} = {value} is not a colour") from error
    if not (math.isfinite(red) and math.isfinite(green) and math.isfinite(blue)):
        raise BadValueError(f"{attribute.GetName()} = {value} is not finite")
    return red, green, blue


def to_matrix(value: Any) -> Doubles:
    """A Gf.Matrix4d as (4, 4) float64, row vectors."""
    return np.array(value, np.float64)


def why_singular(matrix: Doubles) -> str:
    """Why a transform cannot be used, or an empty string."""
    # One matrix per prim: plain numbers are ten times as fast as numpy here.
    (a, b, c, _), (d, e, f, _), (g, h, i, _), _ = rows = matrix.tolist()
    if not all(math.isfinite(value) for row in rows for value in row):
        return "its transform is not finite"
    if a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) == 0:
        return "its transform is singular (determinant 0)"
    return ""


def determinants(matrices: Doubles) -> Doubles:
    """Determinants of the linear parts of (K, 4, 4), exactly 0 for repeated or zero rows."""
    (a, b, c), (d, e, f), (g, h, i) = matrices[:, :3, :3].transpose(1, 2, 0)
    with np.errstate(all="ignore"):  # not finite is the caller's test
        result: Doubles = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return result
