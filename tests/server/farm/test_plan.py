"""However a job is cut, its tasks take every sample of every frame once, and wait for what they have to."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight.v1 import job_pb2, render_pb2
from footlight_server.farm.model import JobPlan, TaskKind
from footlight_server.farm.plan import (
    OWN_TIME,
    CyclicLayersError,
    Submission,
    count_tasks,
    order_layers,
    plan_job,
    split_samples,
)

LAYERS = "abcd"


@st.composite
def submissions(draw: st.DrawFn) -> Submission:
    """Jobs of up to four layers that wait for layers before or, shuffled, after them."""
    names = list(LAYERS[: draw(st.integers(1, 4))])
    frames = {name: tuple(draw(st.lists(st.integers(1, 12), unique=True, max_size=9))) for name in names}
    layers = []
    for index, name in enumerate(names):
        split = draw(st.sampled_from([1, 1, 2, 3]))
        depends = [
            job_pb2.LayerDependency(layer=other, frame_by_frame=draw(st.booleans()))
            for other in names[:index]
            if draw(st.booleans())
        ]
        layers.append(
            job_pb2.LayerSpec(
                name=name,
                render=render_pb2.RenderSpec(spp=draw(st.integers(3, 64))),
                chunk=1 if split > 1 else draw(st.integers(1, 5)),
                split=split,
                depends=depends,
            )
        )
    return Submission(job_pb2.JobSpec(title="t", layers=draw(st.permutations(layers))), frames, "ann")


def makers(plan: JobPlan, split: bool, layer: str) -> dict[int, int]:
    """By frame the index of the task after which its image is there."""
    kind = TaskKind.MERGE if split else TaskKind.RENDER
    return {
        frame: index
        for index, task in enumerate(plan.tasks)
        if task.layer == layer and task.kind is kind
        for frame in task.frames
    }


@given(submissions())
def test_every_sample_of_every_frame_is_taken_once(asked: Submission) -> None:
    plan = plan_job(asked)
    for layer in asked.spec.layers:
        taken: Counter[tuple[int, int]] = Counter()
        for task in plan.tasks:
            if task.layer == layer.name and task.kind is TaskKind.RENDER:
                assert len(task.frames) <= layer.chunk
                assert task.sample_begin < task.sample_end
                taken.update((f, s) for f in task.frames for s in range(task.sample_begin, task.sample_end))
        frames = asked.frames[layer.name] or OWN_TIME
        assert taken == Counter((f, s) for f in frames for s in range(layer.render.spp))


@given(submissions())
def test_a_merge_waits_for_all_ranges_of_its_frame_and_nothing_else(asked: Submission) -> None:
    plan = plan_job(asked)
    split = {layer.name: layer.split for layer in asked.spec.layers}
    for task in plan.tasks:
        if task.kind is TaskKind.MERGE:
            ranges = [
                index
                for index, part in enumerate(plan.tasks)
                if part.kind is TaskKind.RENDER and (part.layer, part.frames) == (task.layer, task.frames)
            ]
            assert list(task.needs) == ranges
            assert len(ranges) == split[task.layer]
    merges = Counter(task.layer for task in plan.tasks if task.kind is TaskKind.MERGE)
    assert merges == {n: len(asked.frames[n] or OWN_TIME) for n, parts in split.items() if parts > 1}


@given(submissions())
def test_frame_by_frame_waits_for_the_images_of_the_same_frames(asked: Submission) -> None:
    plan = plan_job(asked)
    layers = {layer.name: layer for layer in asked.spec.layers}
    for task in plan.tasks:
        if task.kind is TaskKind.RENDER:
            expected = {
                made[frame]
                for need in layers[task.layer].depends
                if need.frame_by_frame
                for made in [makers(plan, layers[need.layer].split > 1, need.layer)]
                for frame in task.frames
                if frame in made
            }
            assert set(task.needs) == expected
    for planned in plan.layers:
        whole = [need.layer for need in layers[planned.name].depends if not need.frame_by_frame]
        assert list(planned.depends) == whole


@given(submissions())
def test_tasks_wait_for_tasks_before_them_so_there_is_no_circle(asked: Submission) -> None:
    plan = plan_job(asked)
    assert all(need < index for index, task in enumerate(plan.tasks) for need in task.needs)
    counted = sum(count_tasks(layer, len(asked.frames[layer.name]) or 1) for layer in asked.spec.layers)
    assert len(plan.tasks) == counted
    first = {task.layer: index for index, task in reversed(list(enumerate(plan.tasks)))}
    for layer in asked.spec.layers:
        assert all(first[need.layer] < first[layer.name] for need in layer.depends)


@given(st.integers(1, 5000), st.integers(1, 64))
def test_ranges_of_samples_cover_all_and_differ_by_one_at_most(spp: int, parts: int) -> None:
    ranges = split_samples(spp, min(parts, spp))
    assert [s for begin, end in ranges for s in range(begin, end)] == list(range(spp))
    sizes = {end - begin for begin, end in ranges}
    assert max(sizes) - min(sizes) <= 1


def test_layers_in_a_circle_are_refused_and_the_circle_is_named() -> None:
    def layer(name: str, needs: str) -> job_pb2.LayerSpec:
        return job_pb2.LayerSpec(name=name, depends=[job_pb2.LayerDependency(layer=needs)])

    with pytest.raises(CyclicLayersError) as caught:
        order_layers([layer("out", "a"), layer("a", "b"), layer("b", "c"), layer("c", "a")])
    assert str(caught.value) == "a -> b -> c -> a"


def test_the_same_job_is_the_same_plan() -> None:
    """So that a request that is sent again finds its job."""
    environment = {f"NAME{i}": str(i) for i in range(20)}

    def asked(items: list[tuple[str, str]]) -> Submission:
        layer = job_pb2.LayerSpec(name="a", chunk=1, split=1, render=render_pb2.RenderSpec(spp=4))
        return Submission(
            job_pb2.JobSpec(title="t", environment=dict(items), layers=[layer]), {"a": (1, 2)}, "ann", "r"
        )

    items = list(environment.items())
    assert plan_job(asked(items)) == plan_job(asked(items[::-1]))
