"""One task from stage to image, in the worker: open, translate, commit, render, write, tell."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import footlight_core
from footlight.v1 import report_pb2, stats_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.images.files import ImageError
from footlight_server.workers.causes import failing_as
from footlight_server.workers.coarse import SCALE, coarse_image, worth_it
from footlight_server.workers.failure import FailureReason
from footlight_server.workers.image import attributes_of, write_image
from footlight_server.workers.limits import lift_cpu_limit, peak_memory
from footlight_server.workers.link import Link
from footlight_server.workers.options import aovs_of, check_options, options_of
from footlight_server.workers.part import write_part
from footlight_server.workers.placed_scene import PlacedScene
from footlight_server.workers.progressive import Goal, ProgressiveRender, threads_of
from footlight_server.workers.publisher import Publisher
from footlight_server.workers.reports import effects_of, refuse_left_out, stage_report
from footlight_server.workers.stage import LoadedStage, load_stage
from footlight_server.workers.versions import versions


class RenderTask:
    """Runs a task given by the server; every outcome but success is an exception."""

    def __init__(self, task: worker_pb2.Task, link: Link) -> None:
        self._task = task
        self._spec = task.spec
        self._link = link
        self._seconds = stats_pb2.StageSeconds()
        self._began = time.monotonic()

    def run(self) -> None:
        """Do all of it."""
        os.environ.update(self._task.environment)
        check_options(self._spec)
        scene = PlacedScene()
        loaded = load_stage(self._task, scene, self._seconds)
        self._spec.MergeFrom(loaded.resolved)
        build = partial(self._build, scene)
        with self._timed("commit"), failing_as(FailureReason.SCENE, ValueError, RuntimeError):
            renderer = build(self._spec.width, self._spec.height)
        lift_cpu_limit()
        report = stage_report(loaded.report, renderer)
        if self._spec.strict:
            refuse_left_out(report)
        self._link.send(worker_pb2.WorkerEvent(opened=worker_pb2.Opened(spec=self._spec, report=report)))
        if self._task.explain:
            self._link.send(worker_pb2.WorkerEvent(done=worker_pb2.Done()))
        else:
            self._render(renderer, build, report, loaded, scene.origin)

    def _build(self, scene: footlight_core.Scene, width: int, height: int) -> footlight_core.Renderer:
        return footlight_core.Renderer(scene, options_of(self._spec, width, height))

    def _render(
        self,
        renderer: footlight_core.Renderer,
        build: Callable[[int, int], footlight_core.Renderer],
        report: report_pb2.StageReport,
        loaded: LoadedStage,
        origin: tuple[float, ...],
    ) -> None:
        spec = self._spec
        publisher = Publisher(self._link, renderer, spec.width, spec.height, aovs_of(spec))
        work = ProgressiveRender(renderer, self._goal, publisher, self._link)
        with self._timed("render"):
            if worth_it(renderer.tiles, renderer.stats()["triangles"]):
                publisher.publish_coarse(coarse_image(spec.width, spec.height, build), SCALE)
            work.run()
        done = worker_pb2.Done(has_image=work.done > 0)
        done.cancelled = self._link.finish_asked and work.done < self._goal.spp
        if done.has_image:
            self._link.send(worker_pb2.WorkerEvent(writing=worker_pb2.Writing()))
            stats = self._stats(renderer, work, loaded)
            with self._timed("write"):
                if self._task.part_path:
                    self._write_part(renderer, report, stats, origin, work.done)
                else:
                    write_image(
                        self._task, renderer, aovs_of(spec), attributes_of(self._task, report, work.done, stats)
                    )
        self._seconds.total = time.monotonic() - self._began
        done.stats.CopyFrom(self._stats(renderer, work, loaded))
        self._link.send(worker_pb2.WorkerEvent(done=done))

    @property
    def _goal(self) -> Goal:
        spec, task = self._spec, self._task
        if task.part_path:
            return Goal(task.sample_end - task.sample_begin, 0.0, 0.0, threads_of(spec), task.sample_begin)
        return Goal(spec.spp, spec.time_limit_seconds, spec.error_limit, threads_of(spec))

    def _write_part(
        self,
        renderer: footlight_core.Renderer,
        report: report_pb2.StageReport,
        stats: stats_pb2.RenderStats,
        origin: tuple[float, ...],
        done: int,
    ) -> None:
        task = self._task
        head = worker_pb2.Part(
            spec=self._spec,
            report=report,
            stats=stats,
            sample_begin=task.sample_begin,
            sample_end=task.sample_begin + done,
            origin=origin,
        )
        with failing_as(FailureReason.OUTPUT, ImageError, OSError):
            write_part(Path(task.part_path), head, renderer.state())

    def _stats(
        self, renderer: footlight_core.Renderer, work: ProgressiveRender, loaded: LoadedStage
    ) -> stats_pb2.RenderStats:
        core = renderer.stats()
        stats = stats_pb2.RenderStats(
            seconds=self._seconds,
            cpu_seconds=core["cpu_seconds"],
            embree_cpu_seconds=core["embree_cpu_seconds"],
            rays=core["rays"],
            samples=core["samples"],
            spp=work.done,
            effects=effects_of(renderer, loaded.report),
            pipeline=list(renderer.pipeline),
            guards=core["guards"],
            peak_memory_bytes=peak_memory(),
            memory_bytes=core["bytes"],
            versions=versions(),
            seed=self._spec.seed,
            threads=threads_of(self._spec),
            counts={name: core[name] for name in ("triangles", "instances", "lights")},
        )
        for name in ("error_mean", "error_p95"):
            if work.progress.HasField(name):  # type: ignore[arg-type]
                setattr(stats, name, getattr(work.progress, name))
        return stats

    @contextmanager
    def _timed(self, step: str) -> Iterator[None]:
        before = time.monotonic()
        try:
            yield
        finally:
            setattr(self._seconds, step, time.monotonic() - before)
