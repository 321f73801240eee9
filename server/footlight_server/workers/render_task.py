"""One task from stage to image, in the worker: open, translate, commit, render, write, tell."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import footlight_core
from footlight.v1 import render_pb2, report_pb2, stats_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.images.display import check_view, write_png
from footlight_server.images.exr import Attribute, write_exr
from footlight_server.images.files import ImageError
from footlight_server.workers.causes import failing_as
from footlight_server.workers.coarse import SCALE, coarse_image, worth_it
from footlight_server.workers.failure import FailureReason
from footlight_server.workers.limits import lift_cpu_limit, peak_memory, set_limits
from footlight_server.workers.link import Link
from footlight_server.workers.progressive import Goal, ProgressiveRender, threads_of
from footlight_server.workers.publisher import Publisher
from footlight_server.workers.reports import effects_of, refuse_left_out, stage_report
from footlight_server.workers.stage import LoadedStage, load_stage
from footlight_server.workers.versions import versions

_FILTERS = {
    render_pb2.PIXEL_FILTER_BOX: "box",
    render_pb2.PIXEL_FILTER_GAUSSIAN: "gaussian",
    render_pb2.PIXEL_FILTER_BLACKMAN_HARRIS: "blackman-harris",
}
_STRATEGIES = {
    render_pb2.STRATEGY_MIS: "mis",
    render_pb2.STRATEGY_LIGHT: "light",
    render_pb2.STRATEGY_BSDF: "bsdf",
}
# Always in the image.
_BASE_AOVS = ("color", "alpha")


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
        self._check_options()
        set_limits(self._task.memory_bytes, self._task.open_cpu_seconds)
        scene = footlight_core.Scene()
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
            self._render(renderer, build, report, loaded)

    @property
    def _aovs(self) -> list[str]:
        return [*_BASE_AOVS, *(aov for aov in self._spec.aovs if aov not in _BASE_AOVS)]

    def _options(self, width: int, height: int) -> footlight_core.RenderOptions:
        spec = self._spec
        return footlight_core.RenderOptions(
            width=width,
            height=height,
            seed=spec.seed,
            max_depth=spec.max_depth,
            pixel_filter=_FILTERS[spec.pixel_filter],
            filter_width=spec.filter_width,
            strategy=_STRATEGIES[spec.strategy],
            aovs=self._aovs,
            threads=spec.threads,
            force_effects=list(spec.force_effects),
        )

    def _build(self, scene: footlight_core.Scene, width: int, height: int) -> footlight_core.Renderer:
        return footlight_core.Renderer(scene, self._options(width, height))

    def _check_options(self) -> None:
        """What can be known to be wrong before the stage is read. Raises TaskFailedError."""
        with failing_as(FailureReason.INVALID_ARGUMENT, ValueError):
            options = self._options(self._spec.width or 1, self._spec.height or 1)
            if self._spec.force_effects:  # their names are looked at when a scene is committed
                footlight_core.Renderer(footlight_core.Scene(), options)
            if self._spec.HasField("png"):
                check_view(self._spec.png.view)

    def _render(
        self,
        renderer: footlight_core.Renderer,
        build: Callable[[int, int], footlight_core.Renderer],
        report: report_pb2.StageReport,
        loaded: LoadedStage,
    ) -> None:
        spec = self._spec
        publisher = Publisher(self._link, renderer, spec.width, spec.height, self._aovs)
        goal = Goal(spec.spp, spec.time_limit_seconds, spec.error_limit, threads_of(spec))
        work = ProgressiveRender(renderer, goal, publisher, self._link)
        with self._timed("render"):
            if worth_it(renderer.tiles, renderer.stats()["triangles"]):
                publisher.publish_coarse(coarse_image(spec.width, spec.height, build), SCALE)
            work.run()
        done = worker_pb2.Done(has_image=work.done > 0)
        done.cancelled = self._link.finish_asked and work.done < spec.spp
        if done.has_image:
            self._link.send(worker_pb2.WorkerEvent(writing=worker_pb2.Writing()))
            with self._timed("write"):
                self._write(renderer, work, report)
        self._seconds.total = time.monotonic() - self._began
        done.stats.CopyFrom(self._stats(renderer, work, loaded))
        self._link.send(worker_pb2.WorkerEvent(done=done))

    def _write(
        self, renderer: footlight_core.Renderer, work: ProgressiveRender, report: report_pb2.StageReport
    ) -> None:
        planes = {aov: renderer.read(aov) for aov in self._aovs}
        attributes: dict[str, Attribute] = {
            "version": versions()["footlight"],
            "stage": self._spec.stage_path,
            "camera": self._spec.camera_path,
            "seed": self._spec.seed,
            "samples": (0, work.done),
            "effects": [effect.name for effect in report.effects if effect.active],
            "pipeline": list(report.pipeline),
        }
        if self._spec.HasField("time_code"):
            attributes["time_code"] = self._spec.time_code
        for name in ("error_mean", "error_p95"):
            if work.progress.HasField(name):  # type: ignore[arg-type]
                attributes[name] = float(getattr(work.progress, name))
        with failing_as(FailureReason.OUTPUT, ImageError, OSError):
            write_exr(Path(self._task.exr_path), planes, attributes)
            if self._spec.HasField("png"):
                write_png(Path(self._task.png_path), planes["color"], view=self._spec.png.view)

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
