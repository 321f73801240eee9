"""Every field of a job outside what is allowed is named with what is allowed; what is left out gets its default."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

import footlight_core
from footlight.v1 import job_pb2, render_pb2
from footlight_server.api.job_spec import complete_job
from footlight_server.api.layer_spec import AOVS
from footlight_server.farm.frames import MOST_FRAMES
from footlight_server.farm.plan import MOST_TASKS
from footlight_server.sessions.errors import InvalidFieldsError

ALLOWED = frozenset({"SHOT", "PATH"})
LIMITS = frozenset({"licences"})

Change = Callable[[job_pb2.JobSpec], object]


def good() -> job_pb2.JobSpec:
    """Two layers, the second waits for the first."""
    beauty = job_pb2.LayerSpec(
        name="beauty", render=render_pb2.RenderSpec(stage_path="/s/shot.usd"), frames="1-10", output="/o/b.####.exr"
    )
    matte = job_pb2.LayerSpec(
        name="matte",
        render=render_pb2.RenderSpec(stage_path="/s/matte.usd", spp=4),
        frames="1-10",
        output="/o/m.####.exr",
        depends=[job_pb2.LayerDependency(layer="beauty", frame_by_frame=True)],
        limits=["licences"],
    )
    return job_pb2.JobSpec(layers=[beauty, matte])


def test_what_is_left_out_gets_the_default_of_the_protocol() -> None:
    checked = complete_job(good(), ALLOWED, LIMITS)
    spec = checked.spec
    assert (spec.title, spec.priority, spec.retries) == ("shot.usd", 50, 2)
    assert [(layer.chunk, layer.split, layer.render.spp) for layer in spec.layers] == [(1, 1, 64), (1, 1, 4)]
    assert checked.frames == {"beauty": tuple(range(1, 11)), "matte": tuple(range(1, 11))}


def test_a_zero_that_was_given_is_no_default() -> None:
    asked = good()
    asked.priority = asked.retries = 0
    spec = complete_job(asked, ALLOWED, LIMITS).spec
    assert (spec.priority, spec.retries) == (0, 0)


def test_one_layer_without_a_name_or_frames_is_one_frame_of_main() -> None:
    asked = job_pb2.JobSpec(layers=[job_pb2.LayerSpec(render=render_pb2.RenderSpec(stage_path="/s/a.usd"))])
    checked = complete_job(asked, ALLOWED, LIMITS)
    assert checked.spec.layers[0].name == "main"
    assert checked.frames == {"main": ()}


def layer(spec: job_pb2.JobSpec, index: int = 0) -> job_pb2.LayerSpec:
    found: job_pb2.LayerSpec = spec.layers[index]
    return found


def split(spec: job_pb2.JobSpec, parts: int, **render: float) -> None:
    layer(spec).split = parts
    for name, value in render.items():
        setattr(layer(spec).render, name, value)


CASES: list[tuple[Change, str, str]] = [
    (lambda s: setattr(s, "title", "x" * 201), "spec.title", "at most 200"),
    (lambda s: setattr(s, "title", "a\nb"), "spec.title", "printed"),
    (lambda s: setattr(s, "show", "x" * 101), "spec.show", "at most 100"),
    (lambda s: setattr(s, "shot", "x" * 101), "spec.shot", "at most 100"),
    (lambda s: setattr(s, "priority", 101), "spec.priority", "0 to 100"),
    (lambda s: setattr(s, "retries", 101), "spec.retries", "0 to 100"),
    (lambda s: s.tags.extend(str(i) for i in range(33)), "spec.tags", "at most 32"),
    (lambda s: s.tags.append(""), "spec.tags[0]", "1 to 64"),
    (lambda s: s.tags.extend(["a", "a"]), "spec.tags[1]", "twice"),
    (lambda s: setattr(s, "comment", "x" * 4097), "spec.comment", "at most 4096"),
    (lambda s: s.depends.append("job/1"), "spec.depends[0]", "jobs/12"),
    (lambda s: s.depends.extend(["jobs/1", "jobs/1"]), "spec.depends[1]", "twice"),
    (lambda s: setattr(s, "timeout_seconds", -1.0), "spec.timeout_seconds", "0, no limit"),
    (lambda s: setattr(s, "timeout_seconds", math.nan), "spec.timeout_seconds", "0, no limit"),
    (lambda s: setattr(s, "stall_timeout_seconds", math.inf), "spec.stall_timeout_seconds", "0, no limit"),
    (lambda s: s.environment.update({"LD_PRELOAD": "x"}), "spec.environment[LD_PRELOAD]", "PATH, SHOT"),
    (lambda s: s.environment.update({"SHOT": "a\0b"}), "spec.environment[SHOT]", "NUL"),
    (lambda s: s.ClearField("layers"), "spec.layers", "1 to 64"),
    (lambda s: s.layers.extend([layer(s)] * 63), "spec.layers", "1 to 64"),
    (lambda s: s.layers.append(layer(s)), "spec.layers[2].name", "twice"),
    (lambda s: setattr(layer(s, 1), "name", "../etc"), "spec.layers[1].name", "A-Za-z0-9"),
    (lambda s: setattr(layer(s), "frames", "1-10x0"), "spec.layers[0].frames", "step"),
    (lambda s: setattr(layer(s), "chunk", 10_001), "spec.layers[0].chunk", "1 to 10000"),
    (lambda s: split(s, 65), "spec.layers[0].split", "1 to 64"),
    (lambda s: split(s, 8, spp=7), "spec.layers[0].split", "one for each sample"),
    (lambda s: split(s, 2, error_limit=0.1), "spec.layers[0].split", "error_limit"),
    (lambda s: split(s, 2, time_limit_seconds=1.0), "spec.layers[0].split", "time_limit_seconds"),
    (lambda s: setattr(layer(s), "output", "b.####.exr"), "spec.layers[0].output", "absolute"),
    (lambda s: setattr(layer(s), "output", "/o/b.exr"), "spec.layers[0].output", "no frame token"),
    (lambda s: setattr(layer(s, 1), "output", "/o/b.$F4.exr"), "spec.layers[1].output", "written by layer 'beauty'"),
    (lambda s: setattr(layer(s).render, "stage_path", ""), "spec.layers[0].render.stage_path", "required"),
    (lambda s: setattr(layer(s).render, "time_code", 1.0), "spec.layers[0].render.time_code", "left out"),
    (lambda s: setattr(layer(s).render, "spp", 1 << 21), "spec.layers[0].render.spp", "1 to 1048576"),
    (lambda s: layer(s).render.aovs.append("beuty"), "spec.layers[0].render.aovs", "there are color, alpha, depth"),
    (lambda s: setattr(layer(s).render, "bundle", "abc"), "spec.layers[0].render.bundle", "{sha256}/{size}"),
    (lambda s: layer(s).limits.append("licence"), "spec.layers[0].limits[0]", "there are licences"),
    (lambda s: layer(s).limits.extend(["licences"] * 2), "spec.layers[0].limits[1]", "twice"),
    (lambda s: layer(s).depends.add(layer="mate"), "spec.layers[0].depends[0].layer", "beauty, matte"),
    (lambda s: layer(s).depends.add(layer="beauty"), "spec.layers[0].depends[0].layer", "itself"),
    (lambda s: layer(s, 1).depends.add(layer="beauty"), "spec.layers[1].depends[1].layer", "twice"),
    (lambda s: layer(s).depends.add(layer="matte"), "spec.layers[0].depends", "beauty -> matte -> beauty"),
    (lambda s: setattr(layer(s), "frames", f"1-{MOST_TASKS}"), "spec.layers", f"at most {MOST_TASKS}"),
    (lambda s: setattr(layer(s), "frames", f"1-{MOST_FRAMES}"), "spec.layers", f"more than {MOST_FRAMES}"),
]


@pytest.mark.parametrize(("change", "field", "allowed"), CASES, ids=[case[1] for case in CASES])
def test_the_field_at_fault_is_named_with_what_is_allowed(change: Change, field: str, allowed: str) -> None:
    asked = good()
    change(asked)
    with pytest.raises(InvalidFieldsError) as caught:
        complete_job(asked, ALLOWED, LIMITS)
    assert [violation.field for violation in caught.value.violations] == [field]
    assert allowed in caught.value.violations[0].description


def test_all_fields_at_fault_are_named_at_once() -> None:
    asked = good()
    faults = [CASES[0], CASES[4], CASES[12], CASES[21], CASES[34]]
    for change, _, _ in faults:
        change(asked)
    with pytest.raises(InvalidFieldsError) as caught:
        complete_job(asked, ALLOWED, LIMITS)
    assert {violation.field for violation in caught.value.violations} == {field for _, field, _ in faults}


def test_layers_that_differ_in_padding_may_still_write_the_same_file() -> None:
    """A comparison of the patterns alone would let these pass, or refuse the second pair."""
    asked = good()
    asked.layers[0].frames, asked.layers[0].output = "10001", "/o/a####.exr"
    asked.layers[1].frames, asked.layers[1].output = "1", "/o/a1####.exr"
    with pytest.raises(InvalidFieldsError, match=r"/o/a10001\.exr is written by layer 'beauty' too"):
        complete_job(asked, ALLOWED, LIMITS)
    asked.layers[1].frames = "2"
    complete_job(asked, ALLOWED, LIMITS)


def test_the_aovs_are_those_of_the_core() -> None:
    footlight_core.RenderOptions(width=1, height=1, aovs=list(AOVS))
    with pytest.raises(ValueError, match=f"allowed: {', '.join(AOVS)}$"):
        footlight_core.RenderOptions(width=1, height=1, aovs=["beuty"])


def test_the_comments_of_the_protocol_name_the_same_limits() -> None:
    text = (Path(__file__).parents[3] / "proto" / "footlight" / "v1" / "job.proto").read_text()
    for number in (MOST_FRAMES, MOST_TASKS):
        assert f"{number:_}".replace("_", " ") in text
