"""What a job is to do, from plain Python values to the message."""

import os
from collections.abc import Iterable, Mapping

from footlight.paths import absolute
from footlight.spec import set_numbers
from footlight.v1 import job_pb2, render_pb2


def layer_spec(
    render: render_pb2.RenderSpec,
    *,
    name: str = "",
    frames: str = "",
    output: str | os.PathLike[str] = "",
    chunk: int = 0,
    split: int = 0,
    after: Iterable[str] = (),
    after_frames_of: Iterable[str] = (),
    limits: Iterable[str] = (),
) -> job_pb2.LayerSpec:
    """The LayerSpec, whose comments say what each option means and its default (0, "").

    `frames` is a range such as `1001-1100x2`. A relative `output` is taken from the current directory. `after` are
    layers that this one waits for as a whole, `after_frames_of` those of which each frame waits for the same frame.
    Raises ValueError for numbers that a message cannot hold, naming the option.
    """
    layer = job_pb2.LayerSpec(name=name, render=render, frames=frames, limits=limits)
    if os.fspath(output):
        layer.output = absolute(output)
    set_numbers(layer, chunk=chunk, split=split)
    layer.depends.extend(job_pb2.LayerDependency(layer=other) for other in after)
    layer.depends.extend(job_pb2.LayerDependency(layer=other, frame_by_frame=True) for other in after_frames_of)
    return layer


def job_spec(
    *layers: job_pb2.LayerSpec,
    title: str = "",
    show: str = "",
    shot: str = "",
    priority: int | None = None,
    tags: Iterable[str] = (),
    comment: str = "",
    depends: Iterable[str] = (),
    retries: int | None = None,
    timeout_seconds: float = 0.0,
    stall_timeout_seconds: float = 0.0,
    paused: bool = False,
    environment: Mapping[str, str] | None = None,
) -> job_pb2.JobSpec:
    """The JobSpec, whose comments say what each option means and its default (0, None, "").

    `depends` are names of jobs, `jobs/12`. Raises ValueError for numbers that a message cannot hold, naming the option.
    """
    spec = job_pb2.JobSpec(
        title=title,
        show=show,
        shot=shot,
        tags=tags,
        comment=comment,
        depends=depends,
        paused=paused,
        environment=environment or {},
        layers=layers,
    )
    set_numbers(
        spec,
        priority=priority,
        retries=retries,
        timeout_seconds=timeout_seconds,
        stall_timeout_seconds=stall_timeout_seconds,
    )
    return spec
