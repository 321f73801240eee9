"""Cuts a checked job into tasks: chunks of frames, sample ranges with a merge, and what each has to wait for."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from footlight.v1 import job_pb2
from footlight_server.farm.model import JobPlan, LayerPlan, TaskKind, TaskPlan

# The frame a layer without a range has: the stage's own time.
OWN_TIME = (0,)
# [tasks] Of one job; said in the protocol.
MOST_TASKS = 200_000


class CyclicLayersError(ValueError):
    """Layers that wait for each other. `layers`: the circle, its first layer at both ends."""

    def __init__(self, layers: Sequence[str]) -> None:
        super().__init__(" -> ".join(layers))
        self.layers = tuple(layers)


@dataclass(frozen=True, slots=True)
class Submission:
    """A job that was checked, with the frames of each layer by its name, and who asks for it."""

    spec: job_pb2.JobSpec
    frames: Mapping[str, tuple[int, ...]]
    user: str
    request_id: str = ""


def count_tasks(layer: job_pb2.LayerSpec, frames: int) -> int:
    """[tasks] That a layer of so many frames is cut into."""
    if layer.split > 1:
        return frames * (layer.split + 1)
    return -(-frames // layer.chunk)


def plan_job(asked: Submission) -> JobPlan:
    """The job as the queue takes it. A layer's tasks come after those of the layers it waits for."""
    spec = asked.spec
    layers = {layer.name: layer for layer in spec.layers}
    tasks: list[TaskPlan] = []
    # layer -> frame -> index of the task after which its image is there.
    makers: dict[str, dict[int, int]] = {}
    for name in order_layers(spec.layers):
        makers[name] = _cut_layer(layers[name], asked.frames[name] or OWN_TIME, makers, tasks)
    return JobPlan(
        title=spec.title,
        user=asked.user,
        spec=spec.SerializeToString(deterministic=True),
        priority=spec.priority,
        retries=spec.retries,
        layers=tuple(_plan_layer(layer) for layer in spec.layers),
        tasks=tuple(tasks),
        show=spec.show,
        shot=spec.shot,
        tags=tuple(spec.tags),
        depends=tuple(int(name.removeprefix("jobs/")) for name in spec.depends),
        paused=spec.paused,
        request_id=asked.request_id,
        bundles=tuple(dict.fromkeys(layer.render.bundle for layer in spec.layers if layer.render.bundle)),
    )


def order_layers(layers: Sequence[job_pb2.LayerSpec]) -> list[str]:
    """Their names, each after all it waits for and otherwise as given. Raises CyclicLayersError."""
    waits = {layer.name: [need.layer for need in layer.depends] for layer in layers}
    ordered: dict[str, None] = {}

    def visit(name: str, path: tuple[str, ...]) -> None:
        if name in path:
            raise CyclicLayersError([*path[path.index(name) :], name])
        if name not in ordered:
            for needed in waits[name]:
                visit(needed, (*path, name))
            ordered[name] = None

    for name in waits:
        visit(name, ())
    return list(ordered)


def split_samples(spp: int, parts: int) -> list[tuple[int, int]]:
    """Ranges [begin, end) of samples that cover `spp` in order, as equal as whole samples allow."""
    edges = [spp * part // parts for part in range(parts + 1)]
    return list(itertools.pairwise(edges))


def _plan_layer(layer: job_pb2.LayerSpec) -> LayerPlan:
    return LayerPlan(
        name=layer.name,
        spec=layer.SerializeToString(deterministic=True),
        limits=tuple(layer.limits),
        depends=tuple(need.layer for need in layer.depends if not need.frame_by_frame),
    )


def _cut_layer(
    layer: job_pb2.LayerSpec, frames: Sequence[int], makers: Mapping[str, Mapping[int, int]], tasks: list[TaskPlan]
) -> dict[int, int]:
    """Append the layer's tasks; answers by frame the index of the task that makes its image."""
    waited_for = [makers[need.layer] for need in layer.depends if need.frame_by_frame]
    spp = layer.render.spp
    made: dict[int, int] = {}
    for start in range(0, len(frames), layer.chunk):
        chunk = tuple(frames[start : start + layer.chunk])
        needs = tuple(sorted({made_by[f] for made_by in waited_for for f in chunk if f in made_by}))
        first = len(tasks)
        tasks += (
            TaskPlan(layer.name, TaskKind.RENDER, chunk, begin, end, needs)
            for begin, end in split_samples(spp, layer.split)
        )
        if layer.split > 1:
            parts = tuple(range(first, len(tasks)))
            tasks.append(TaskPlan(layer.name, TaskKind.MERGE, chunk, 0, spp, parts))
        made.update(dict.fromkeys(chunk, len(tasks) - 1))
    return made
