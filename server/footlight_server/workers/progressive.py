"""Takes the samples of a render, pass by pass and slice by slice, and tells how far it is."""

import math
import os
import time
from dataclasses import dataclass
from typing import Protocol

from footlight.v1 import render_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.workers.link import Link
from footlight_server.workers.passes import LONGEST_SLICE, Pace, slice_seconds
from footlight_server.workers.publisher import Publisher

# [s] Between two reports of progress.
_REPORT_PERIOD = 0.2


class SampleTaker(Protocol):
    """The part of the core's Renderer that is needed here."""

    tiles: int

    def render(self, sample_begin: int, sample_end: int, tile_begin: int, tile_end: int) -> bool:
        """Take samples [begin, end) of each pixel of tiles [begin, end)."""
        ...

    def error(self) -> dict[str, float]:
        """Mean and p95 of the relative error over tiles."""
        ...


@dataclass(frozen=True, slots=True)
class Goal:
    """When to stop: [samples per pixel], [s], [relative], 0 for no limit; and [threads] to keep busy.

    `first`: the number of the first sample; those before it are taken elsewhere.
    """

    spp: int
    seconds: float
    error: float
    threads: int
    first: int = 0


class ProgressiveRender:
    """Samples taken so far, and the way to the goal."""

    def __init__(self, renderer: SampleTaker, goal: Goal, publisher: Publisher, link: Link) -> None:
        self._renderer = renderer
        self._goal = goal
        self._publisher = publisher
        self._link = link
        self._pace = Pace()
        self._began = time.monotonic()
        self._reported = 0.0
        self._progress = render_pb2.Progress(samples_total=goal.spp)
        # [samples per pixel] In every pixel.
        self.done = 0

    @property
    def elapsed(self) -> float:
        """[s] Since the first sample."""
        return time.monotonic() - self._began

    @property
    def _slice_seconds(self) -> float:
        """[s] How long the next slice shall last."""
        return slice_seconds(self.elapsed) if self._publisher.watched else LONGEST_SLICE

    @property
    def progress(self) -> render_pb2.Progress:
        """As last reported."""
        return self._progress

    def run(self) -> None:
        """Take samples until the goal is reached or the server asks to finish."""
        while (samples := self._next_pass()) > 0:
            if not self._take_pass(samples):
                break
            self.done += samples
            self._measure_error()
            self._report(self.done, force=True)
        self._publisher.publish_last()

    def _next_pass(self) -> int:
        goal = self._goal
        if self._link.finish_asked or self.done >= goal.spp:
            return 0
        if goal.error and self._progress.HasField("error_mean") and self._progress.error_mean <= goal.error:
            return 0
        samples = self._pace.pass_samples(self.done, goal.spp, self._slice_seconds, goal.threads)
        if goal.seconds and self.done:
            samples = min(samples, self._pace.samples_within(goal.seconds - self.elapsed, self._renderer.tiles))
        return samples

    def _take_pass(self, samples: int) -> bool:
        """Take a pass over all tiles; False if it was left because the server asked to finish."""
        tiles = self._renderer.tiles
        begin = 0
        while begin < tiles:
            if self._link.finish_asked:
                return False
            count = self._pace.slice_tiles(self._slice_seconds, samples, self._goal.threads)
            end = min(tiles, begin + count)
            before = time.monotonic()
            first = self._goal.first + self.done
            self._renderer.render(first, first + samples, begin, end)
            self._pace.saw(end - begin, samples, time.monotonic() - before)
            self._publisher.publish(begin, end, self.done + samples)
            self._report(self.done + samples * end / tiles)
            begin = end
        return True

    def _measure_error(self) -> None:
        if self.done >= 2:
            error = self._renderer.error()
            if math.isfinite(error["mean"]) and math.isfinite(error["p95"]):
                self._progress.error_mean = error["mean"]
                self._progress.error_p95 = error["p95"]

    def _report(self, done: float, *, force: bool = False) -> None:
        elapsed = self.elapsed
        if not force and elapsed - self._reported < _REPORT_PERIOD:
            return
        self._reported = elapsed
        self._progress.samples_done = done
        self._progress.seconds = elapsed
        remaining = elapsed * (self._goal.spp - done) / done
        if self._goal.seconds:
            remaining = min(remaining, max(0.0, self._goal.seconds - elapsed))
        self._progress.seconds_remaining = remaining
        self._link.send(worker_pb2.WorkerEvent(progress=self._progress))


def threads_of(spec: render_pb2.RenderSpec) -> int:
    """[threads] That the core will use."""
    return spec.threads or len(os.sched_getaffinity(0))
