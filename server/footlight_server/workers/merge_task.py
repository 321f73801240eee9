"""Adds the parts of a frame up and writes its image, the same bytes as if one worker had taken all the samples."""

import math
import os
import time
from pathlib import Path

import footlight_core
from footlight.v1 import render_pb2, stats_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.workers.causes import TaskFailedError, failing_as
from footlight_server.workers.failure import Failure, FailureReason
from footlight_server.workers.image import attributes_of, write_image
from footlight_server.workers.limits import lift_cpu_limit, peak_memory
from footlight_server.workers.link import Link
from footlight_server.workers.options import aovs_of, check_options, options_of
from footlight_server.workers.part import PartError, read_head, read_part
from footlight_server.workers.placed_scene import empty_scene
from footlight_server.workers.publisher import Publisher
from footlight_server.workers.versions import versions


class MergeTask:
    """Runs a task given by the server; every outcome but success is an exception."""

    def __init__(self, task: worker_pb2.Task, link: Link) -> None:
        self._task = task
        self._link = link
        self._began = time.monotonic()

    def run(self) -> None:
        """Do all of it."""
        lift_cpu_limit()
        os.environ.update(self._task.environment)
        check_options(without_effects(self._task.spec))
        with failing_as(FailureReason.OUTPUT, PartError):
            heads = [read_head(Path(path)) for path in self._task.merge_paths]
        samples = check_parts(heads)
        first = heads[0]
        spec = resolved(self._task.spec, first.spec)
        self._task.spec.CopyFrom(spec)
        self._link.send(worker_pb2.WorkerEvent(opened=worker_pb2.Opened(spec=spec, report=first.report)))
        with failing_as(FailureReason.INTERNAL, ValueError, RuntimeError):
            options = options_of(without_effects(spec), spec.width, spec.height)
            renderer = footlight_core.Renderer(empty_scene(tuple(first.origin)), options)
        aovs = aovs_of(spec)
        publisher = Publisher(self._link, renderer, spec.width, spec.height, aovs)
        self._add_up(renderer, publisher, samples)
        publisher.publish_last()
        self._link.send(worker_pb2.WorkerEvent(writing=worker_pb2.Writing()))
        stats = add_up([head.stats for head in heads])
        stats.spp = samples
        error = renderer.error()
        if samples >= 2 and math.isfinite(error["mean"]) and math.isfinite(error["p95"]):
            stats.error_mean, stats.error_p95 = error["mean"], error["p95"]
        before = time.monotonic()
        write_image(self._task, renderer, aovs, attributes_of(self._task, first.report, samples, stats))
        stats.seconds.write += time.monotonic() - before
        stats.seconds.total += time.monotonic() - self._began
        stats.peak_memory_bytes = max(stats.peak_memory_bytes, peak_memory())
        self._link.send(worker_pb2.WorkerEvent(done=worker_pb2.Done(stats=stats, has_image=True)))

    def _add_up(self, renderer: footlight_core.Renderer, publisher: Publisher, samples: int) -> None:
        progress = render_pb2.Progress(samples_total=samples)
        for path in self._task.merge_paths:
            with failing_as(FailureReason.OUTPUT, PartError, ValueError):
                head, film = read_part(Path(path))
                renderer.merge(film)
            progress.samples_done += head.sample_end - head.sample_begin
            progress.seconds = time.monotonic() - self._began
            publisher.publish(0, renderer.tiles, int(progress.samples_done))
            self._link.send(worker_pb2.WorkerEvent(progress=progress))


def check_parts(heads: list[worker_pb2.Part]) -> int:
    """[samples per pixel] In all. Raises TaskFailedError unless these are all the samples of one image, each once."""
    first = heads[0]
    for head in heads:
        if head.spec != first.spec or head.origin != first.origin:
            raise _refused("the sample ranges are of different images; was the stage changed while the job ran?")
    done = 0
    for head in sorted(heads, key=lambda head: head.sample_begin):
        if head.sample_begin != done:
            raise _refused(f"the sample ranges do not fit: {done} are there, then those from {head.sample_begin} on")
        done = head.sample_end
    if done != first.spec.spp:
        raise _refused(f"there are {done} samples of {first.spec.spp}")
    return done


def add_up(parts: list[stats_pb2.RenderStats]) -> stats_pb2.RenderStats:
    """What all of them cost together."""
    total = stats_pb2.RenderStats()
    total.CopyFrom(parts[0])
    for part in parts[1:]:
        for name in ("open", "translate", "commit", "render", "write", "total"):
            setattr(total.seconds, name, getattr(total.seconds, name) + getattr(part.seconds, name))
        for name in ("cpu_seconds", "rays", "guards"):
            sums = getattr(total, name)
            for key, value in getattr(part, name).items():
                sums[key] += value
        total.embree_cpu_seconds += part.embree_cpu_seconds
        total.samples += part.samples
        total.peak_memory_bytes = max(total.peak_memory_bytes, part.peak_memory_bytes)
    total.ClearField("error_mean")
    total.ClearField("error_p95")
    total.versions.update(versions())
    return total


def resolved(asked: render_pb2.RenderSpec, rendered: render_pb2.RenderSpec) -> render_pb2.RenderSpec:
    """What is asked for, with size, camera and time code as they were used. Parts have no PNG, their image may."""
    spec = render_pb2.RenderSpec()
    spec.CopyFrom(rendered)
    if asked.HasField("png"):
        spec.png.CopyFrom(asked.png)
    return spec


def without_effects(spec: render_pb2.RenderSpec) -> render_pb2.RenderSpec:
    """The spec for a renderer that takes no samples."""
    plain = render_pb2.RenderSpec()
    plain.CopyFrom(spec)
    plain.ClearField("force_effects")
    return plain


def _refused(message: str) -> TaskFailedError:
    return TaskFailedError(Failure(FailureReason.SCENE, message))
