"""Checks a RenderSpec field by field and fills in the defaults that the protocol promises."""

import math
import os
import stat
from collections.abc import Sequence
from pathlib import Path

from footlight.v1 import render_pb2
from footlight_server.blobs.digest import Digest
from footlight_server.sessions.errors import (
    FieldViolation,
    InvalidFieldsError,
    OutsideRootsError,
    StageNotFoundError,
)

_DEFAULTS = {"spp": 64, "max_depth": 8}
# [low, high] As the proto's comments say. 0 means "not given".
_RANGES = {
    "width": (1, 32768),
    "height": (1, 32768),
    "spp": (1, 1 << 20),
    "max_depth": (1, 1024),
    "threads": (1, 1024),
}
_MOST_PIXELS = 1 << 28
_WIDEST_FILTER = 16.0
# [characters] Of a path; more than any file system takes. Of the name of an AOV or effect, and how many there may be.
_LONGEST_PATH = 4096
_LONGEST_NAME, _MOST_NAMES = 64, 64


def complete_spec(asked: render_pb2.RenderSpec) -> render_pb2.RenderSpec:
    """The spec with defaults filled in. Raises InvalidFieldsError naming every field at fault."""
    spec = render_pb2.RenderSpec()
    spec.CopyFrom(asked)
    fill_in(spec)
    if violations := spec_violations(spec, "spec"):
        raise InvalidFieldsError(violations)
    return spec


def fill_in(spec: render_pb2.RenderSpec) -> None:
    """Write the defaults that are known before the stage is open into a spec."""
    for name, value in _DEFAULTS.items():
        setattr(spec, name, getattr(spec, name) or value)
    spec.strategy = spec.strategy or render_pb2.STRATEGY_MIS
    spec.pixel_filter = spec.pixel_filter or render_pb2.PIXEL_FILTER_BLACKMAN_HARRIS


def spec_violations(spec: render_pb2.RenderSpec, where: str) -> list[FieldViolation]:
    """What of a filled in spec is outside what is allowed; `where`: the path of the spec in the request."""
    found = _length_violations(spec)
    if found:  # what is that long is neither looked at nor quoted
        return [FieldViolation(f"{where}.{violation.field}", violation.description) for violation in found]
    found = [*_text_violations(spec), *_range_violations(spec), *_number_violations(spec)]
    return [FieldViolation(f"{where}.{violation.field}", violation.description) for violation in found]


def check_stage(path: str, roots: Sequence[Path], where: str = "spec") -> None:
    """The stage's file has to be there, and below a root if there are any. Blocks on the file system."""
    real = Path(os.path.realpath(path))
    if roots and not any(real.is_relative_to(root) for root in roots):
        raise OutsideRootsError(f"{path}: not below a directory this server may read ({_listed(roots)})")
    try:
        mode = real.stat().st_mode
    except OSError as error:
        raise StageNotFoundError(f"{path}: {error.strerror}") from error
    if not stat.S_ISREG(mode):
        raise InvalidFieldsError([FieldViolation(f"{where}.stage_path", f"{path}: not a file")])


def _length_violations(spec: render_pb2.RenderSpec) -> list[FieldViolation]:
    texts = {"stage_path": spec.stage_path, "camera_path": spec.camera_path, "bundle": spec.bundle}
    violations = [
        FieldViolation(name, f"longer than {_LONGEST_PATH} characters")
        for name, text in {**texts, "png.view": spec.png.view}.items()
        if len(text) > _LONGEST_PATH
    ]
    for name, names in (("aovs", spec.aovs), ("force_effects", spec.force_effects)):
        if len(names) > _MOST_NAMES or any(len(each) > _LONGEST_NAME for each in names):
            violations.append(
                FieldViolation(name, f"at most {_MOST_NAMES} names of {_LONGEST_NAME} characters are allowed")
            )
    return violations


def _text_violations(spec: render_pb2.RenderSpec) -> list[FieldViolation]:
    violations = []
    if not spec.stage_path:
        violations.append(FieldViolation("stage_path", "required"))
    elif "\0" in spec.stage_path:
        violations.append(FieldViolation("stage_path", "holds a NUL"))
    elif not spec.bundle and not spec.stage_path.startswith("/"):
        violations.append(FieldViolation("stage_path", f"{spec.stage_path!r}: has to be absolute"))
    if spec.bundle:
        try:
            Digest.parse(spec.bundle)
        except ValueError as error:
            violations.append(FieldViolation("bundle", str(error)))
    if spec.camera_path and not spec.camera_path.startswith("/"):
        violations.append(
            FieldViolation("camera_path", f"{spec.camera_path!r}: has to be an absolute prim path, such as /World/cam")
        )
    return violations


def _range_violations(spec: render_pb2.RenderSpec) -> list[FieldViolation]:
    violations = []
    for name, (low, high) in _RANGES.items():
        value = getattr(spec, name)
        if value and not low <= value <= high:
            violations.append(FieldViolation(name, f"{value}: allowed are {low} to {high}"))
    if bool(spec.width) != bool(spec.height):
        violations.append(FieldViolation("width" if spec.height else "height", "give width and height, or neither"))
    elif spec.width * spec.height > _MOST_PIXELS:
        violations.append(
            FieldViolation("width", f"{spec.width}x{spec.height}: at most {_MOST_PIXELS} pixels are allowed")
        )
    return violations


def _number_violations(spec: render_pb2.RenderSpec) -> list[FieldViolation]:
    violations = []
    if spec.pixel_filter not in render_pb2.PixelFilter.values():
        violations.append(FieldViolation("pixel_filter", f"{spec.pixel_filter}: not a PixelFilter of this server"))
    if spec.strategy not in render_pb2.Strategy.values():
        violations.append(FieldViolation("strategy", f"{spec.strategy}: not a Strategy of this server"))
    if not 0 <= spec.filter_width <= _WIDEST_FILTER:
        violations.append(FieldViolation("filter_width", f"{spec.filter_width:g}: allowed is 0 to {_WIDEST_FILTER:g}"))
    if spec.HasField("time_code") and not math.isfinite(spec.time_code):
        violations.append(FieldViolation("time_code", f"{spec.time_code}: has to be finite"))
    for name in ("time_limit_seconds", "error_limit"):
        value = getattr(spec, name)
        if not (value >= 0 and math.isfinite(value)):
            violations.append(FieldViolation(name, f"{value:g}: has to be finite and not negative"))
    return violations


def _listed(roots: Sequence[Path]) -> str:
    return ", ".join(str(root) for root in roots)
