"""Checks one layer of a JobSpec, and fills in its defaults."""

import re
from collections.abc import Collection, Iterator, Sequence

from footlight.v1 import job_pb2
from footlight_server.api.spec import fill_in, spec_violations
from footlight_server.farm.outputs import OutputError, check_frames_apart, parse_output
from footlight_server.sessions.errors import FieldViolation

# Names of layers and limits, as the proto's comments say.
NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}", re.ASCII)
_DEFAULT_NAME = "main"
_LARGEST_CHUNK = 10_000
_MOST_PARTS = 64
_MOST_LIMITS = 16
# The core's list, which this process does not load; held to it by a test. A thousand tasks shall not fail of a typo.
AOVS = ("color", "alpha", "depth", "normal", "albedo", "position", "error", "sample_count")


def fill_in_layer(layer: job_pb2.LayerSpec) -> None:
    """Write the defaults into a layer."""
    layer.name = layer.name or _DEFAULT_NAME
    layer.frames = layer.frames.strip()
    layer.chunk = layer.chunk or 1
    layer.split = layer.split or 1
    fill_in(layer.render)


def layer_violations(
    layer: job_pb2.LayerSpec, where: str, frames: int, layers: Sequence[str], known_limits: Collection[str]
) -> Iterator[FieldViolation]:
    """What of a filled in layer of so many frames is outside what is allowed; `where`: its path in the request."""
    if not NAME.fullmatch(layer.name):
        yield FieldViolation(f"{where}.name", f"{layer.name[:80]!r}: does not match [A-Za-z0-9_.-]{{1,64}}")
    yield from spec_violations(layer.render, f"{where}.render")
    if layer.render.HasField("time_code"):
        yield FieldViolation(f"{where}.render.time_code", "has to be left out; `frames` says it")
    for name in layer.render.aovs:
        if name not in AOVS:
            yield FieldViolation(f"{where}.render.aovs", f"no AOV {name[:80]!r}; there are {', '.join(AOVS)}")
    yield from _cut_violations(layer, where)
    if layer.output:
        try:
            check_frames_apart(parse_output(layer.output), frames)
        except OutputError as error:
            yield FieldViolation(f"{where}.output", str(error))
    yield from _depends_violations(layer, where, layers)
    yield from _limit_violations(layer, where, known_limits)


def _cut_violations(layer: job_pb2.LayerSpec, where: str) -> Iterator[FieldViolation]:
    if layer.chunk > _LARGEST_CHUNK:
        yield FieldViolation(f"{where}.chunk", f"{layer.chunk}: allowed are 1 to {_LARGEST_CHUNK} frames")
    if layer.split > _MOST_PARTS:
        yield FieldViolation(f"{where}.split", f"{layer.split}: allowed are 1 to {_MOST_PARTS} ranges")
    elif layer.split > 1:
        if layer.split > layer.render.spp:
            yield FieldViolation(
                f"{where}.split", f"{layer.split} ranges of {layer.render.spp} samples: at most one for each sample"
            )
        if layer.chunk > 1:
            yield FieldViolation(f"{where}.split", f"not together with a chunk of {layer.chunk}")
        for name in ("error_limit", "time_limit_seconds"):
            if getattr(layer.render, name):
                yield FieldViolation(f"{where}.split", f"not together with {name}, which stops at any sample")


def _depends_violations(layer: job_pb2.LayerSpec, where: str, layers: Sequence[str]) -> Iterator[FieldViolation]:
    seen: set[str] = set()
    for index, need in enumerate(layer.depends):
        field = f"{where}.depends[{index}].layer"
        if need.layer not in layers:
            yield FieldViolation(field, f"no layer {need.layer[:80]!r}; this job has {', '.join(layers)}")
        elif need.layer == layer.name:
            yield FieldViolation(field, "a layer cannot wait for itself")
        elif need.layer in seen:
            yield FieldViolation(field, f"{need.layer!r} is there twice")
        seen.add(need.layer)


def _limit_violations(layer: job_pb2.LayerSpec, where: str, known: Collection[str]) -> Iterator[FieldViolation]:
    if len(layer.limits) > _MOST_LIMITS:
        yield FieldViolation(f"{where}.limits", f"{len(layer.limits)} limits: at most {_MOST_LIMITS} are allowed")
        return
    for index, name in enumerate(layer.limits):
        if name not in known:
            yield FieldViolation(
                f"{where}.limits[{index}]", f"no limit {name[:80]!r}; there are {', '.join(sorted(known)) or 'none'}"
            )
        elif name in layer.limits[:index]:
            yield FieldViolation(f"{where}.limits[{index}]", f"{name!r} is there twice")
