"""Checks a JobSpec field by field, fills in the defaults that the protocol promises, and parses the frames."""

import math
import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import PurePosixPath

from footlight.v1 import job_pb2
from footlight_server.api.layer_spec import fill_in_layer, layer_violations
from footlight_server.api.names import job_number
from footlight_server.farm.frames import MOST_FRAMES, FramesError, parse_frames
from footlight_server.farm.outputs import parse_output
from footlight_server.farm.plan import MOST_TASKS, OWN_TIME, CyclicLayersError, count_tasks, order_layers
from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError, JobNotFoundError

_DEFAULT_PRIORITY = 50
_DEFAULT_RETRIES = 2
# As the proto's comments say: [characters], [1].
_LONGEST_TITLE = 200
_LONGEST_PLACE = 100
_LONGEST_COMMENT = 4096
_MOST_TAGS, _LONGEST_TAG = 32, 64
_HIGHEST_PRIORITY = 100
_MOST_RETRIES = 100
_MOST_LAYERS = 64
_MOST_DEPENDS = 100
_LONGEST_VALUE = 4096
# [s] Ten years; far from what a clock cannot add.
_LONGEST_TIMEOUT = 10 * 365 * 86400.0
_VARIABLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)


@dataclass(frozen=True, slots=True)
class CheckedJob:
    """A job with its defaults filled in, and the frames of each layer by name; none for one at the stage's own time."""

    spec: job_pb2.JobSpec
    frames: Mapping[str, tuple[int, ...]]


def complete_job(
    asked: job_pb2.JobSpec, allowed_environment: Collection[str], known_limits: Collection[str]
) -> CheckedJob:
    """The job as it will be. Raises InvalidFieldsError naming every field at fault. A million frames take seconds."""
    spec = job_pb2.JobSpec()
    spec.CopyFrom(asked)
    _fill_in(spec)
    violations = [
        *_text_violations(spec),
        *_number_violations(spec),
        *_depends_violations(spec),
        *_environment_violations(spec, allowed_environment),
        *_name_violations(spec),
    ]
    if len(spec.layers) > _MOST_LAYERS:  # each costs time to look at
        raise InvalidFieldsError(violations)
    frames: list[tuple[int, ...]] = []
    for index, layer in enumerate(spec.layers):
        where = f"spec.layers[{index}]"
        try:
            if sum(map(len, frames)) > MOST_FRAMES:
                raise FramesError(f"more than {MOST_FRAMES} frames in all layers together")
            frames.append(parse_frames(layer.frames))
        except FramesError as error:
            violations.append(FieldViolation(f"{where}.frames", str(error)))
            frames.append(())
        names = [other.name for other in spec.layers]
        violations += layer_violations(layer, where, len(frames[-1]) or 1, names, known_limits)
    if not violations:
        violations += _joint_violations(spec, frames)
    if violations:
        raise InvalidFieldsError(violations)
    return CheckedJob(spec, {layer.name: numbers for layer, numbers in zip(spec.layers, frames, strict=True)})


def _fill_in(spec: job_pb2.JobSpec) -> None:
    for layer in spec.layers:
        fill_in_layer(layer)
    if not spec.title and spec.layers:
        name = PurePosixPath(spec.layers[0].render.stage_path).name
        spec.title = "".join(c for c in name if c.isprintable())[:_LONGEST_TITLE]
    if not spec.HasField("priority"):
        spec.priority = _DEFAULT_PRIORITY
    if not spec.HasField("retries"):
        spec.retries = _DEFAULT_RETRIES


def _text_violations(spec: job_pb2.JobSpec) -> Iterator[FieldViolation]:
    for name, longest in (("title", _LONGEST_TITLE), ("show", _LONGEST_PLACE), ("shot", _LONGEST_PLACE)):
        value = getattr(spec, name)
        if len(value) > longest:
            yield FieldViolation(f"spec.{name}", f"{len(value)} characters: at most {longest} are allowed")
        elif not value.isprintable():
            yield FieldViolation(f"spec.{name}", f"{value!r}: holds characters that cannot be printed")
    if len(spec.comment) > _LONGEST_COMMENT:
        yield FieldViolation("spec.comment", f"{len(spec.comment)} characters: at most {_LONGEST_COMMENT} are allowed")
    elif "\0" in spec.comment:
        yield FieldViolation("spec.comment", "holds a NUL")
    if len(spec.tags) > _MOST_TAGS:
        yield FieldViolation("spec.tags", f"{len(spec.tags)} tags: at most {_MOST_TAGS} are allowed")
        return
    for index, tag in enumerate(spec.tags):
        if not 1 <= len(tag) <= _LONGEST_TAG or not tag.isprintable():
            yield FieldViolation(
                f"spec.tags[{index}]", f"{tag[:80]!r}: a tag has 1 to {_LONGEST_TAG} characters that can be printed"
            )
        elif tag in spec.tags[:index]:
            yield FieldViolation(f"spec.tags[{index}]", f"{tag!r} is there twice")


def _number_violations(spec: job_pb2.JobSpec) -> Iterator[FieldViolation]:
    for name, highest in (("priority", _HIGHEST_PRIORITY), ("retries", _MOST_RETRIES)):
        value = getattr(spec, name)
        if value > highest:
            yield FieldViolation(f"spec.{name}", f"{value}: allowed are 0 to {highest}")
    for name in ("timeout_seconds", "stall_timeout_seconds"):
        seconds = getattr(spec, name)
        if not (math.isfinite(seconds) and 0 <= seconds <= _LONGEST_TIMEOUT):
            yield FieldViolation(
                f"spec.{name}", f"{seconds:g}: allowed is 0, no limit of one's own, to {_LONGEST_TIMEOUT:g}"
            )


def _depends_violations(spec: job_pb2.JobSpec) -> Iterator[FieldViolation]:
    if len(spec.depends) > _MOST_DEPENDS:
        yield FieldViolation("spec.depends", f"{len(spec.depends)} jobs: at most {_MOST_DEPENDS} are allowed")
        return
    for index, name in enumerate(spec.depends):
        try:
            job_number(name)
        except JobNotFoundError as error:
            yield FieldViolation(f"spec.depends[{index}]", str(error))
        if name in spec.depends[:index]:
            yield FieldViolation(f"spec.depends[{index}]", f"{name} is there twice")


def _environment_violations(spec: job_pb2.JobSpec, allowed: Collection[str]) -> Iterator[FieldViolation]:
    for name in sorted(spec.environment):
        where, value = f"spec.environment[{name[:80]}]", spec.environment[name]
        if name not in allowed or not _VARIABLE.fullmatch(name):
            what = f"{name[:80]!r}: not allowed by this server; allowed are {_listed(sorted(allowed))}"
            yield FieldViolation(where, what)
        elif "\0" in value or len(value) > _LONGEST_VALUE:
            yield FieldViolation(where, f"a value has at most {_LONGEST_VALUE} characters and no NUL")


def _name_violations(spec: job_pb2.JobSpec) -> Iterator[FieldViolation]:
    if not 1 <= len(spec.layers) <= _MOST_LAYERS:
        yield FieldViolation("spec.layers", f"{len(spec.layers)} layers: allowed are 1 to {_MOST_LAYERS}")
        return
    names = [layer.name for layer in spec.layers]
    for index, name in enumerate(names):
        if name in names[:index]:
            yield FieldViolation(f"spec.layers[{index}].name", f"{name!r} is there twice")


def _joint_violations(spec: job_pb2.JobSpec, frames: list[tuple[int, ...]]) -> Iterator[FieldViolation]:
    """What is wrong between layers that are each right."""
    try:
        order_layers(spec.layers)
    except CyclicLayersError as error:
        index = [layer.name for layer in spec.layers].index(error.layers[0])
        yield FieldViolation(f"spec.layers[{index}].depends", f"layers wait for each other: {error}")
    if sum(map(len, frames)) > MOST_FRAMES:
        yield FieldViolation("spec.layers", f"more than {MOST_FRAMES} frames in all layers together")
        return
    tasks = sum(count_tasks(layer, len(f) or 1) for layer, f in zip(spec.layers, frames, strict=True))
    if tasks > MOST_TASKS:
        yield FieldViolation(
            "spec.layers",
            f"{tasks} tasks: at most {MOST_TASKS} are allowed; put more frames into a chunk, or split less",
        )
        return
    yield from _shared_outputs(spec, frames)


def _shared_outputs(spec: job_pb2.JobSpec, frames: list[tuple[int, ...]]) -> Iterator[FieldViolation]:
    """Files that two layers would write."""
    if sum(bool(layer.output) for layer in spec.layers) < 2:
        return
    # By digest: a million paths may be four thousand characters long.
    writers: dict[bytes, str] = {}
    for index, (layer, numbers) in enumerate(zip(spec.layers, frames, strict=True)):
        if not layer.output:
            continue
        pattern = parse_output(layer.output)
        for path in (str(pattern.path(frame)) for frame in numbers or OWN_TIME):
            key = blake2b(os.fsencode(path), digest_size=16).digest()
            if (writer := writers.setdefault(key, layer.name)) != layer.name:
                yield FieldViolation(f"spec.layers[{index}].output", f"{path} is written by layer {writer!r} too")
                break


def _listed(names: list[str]) -> str:
    return ", ".join(names) or "none"
