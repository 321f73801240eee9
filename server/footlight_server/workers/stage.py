"""From a task's stage to a filled scene, and from USD's errors to failures."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from footlight.v1 import render_pb2, stats_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.images.texture import read_image
from footlight_server.usd import (
    Admit,
    Budget,
    CameraError,
    OpenLimits,
    Report,
    SceneSink,
    StageError,
    StageMalformedError,
    StageNotFoundError,
    StageUnreadableError,
    TranslateRequest,
    open_stage,
    translate,
)
from footlight_server.workers.causes import failing_as
from footlight_server.workers.failure import FailureReason


@dataclass(frozen=True, slots=True)
class LoadedStage:
    """What the translation says, and what of the spec it has settled: size, camera, time code."""

    report: Report
    resolved: render_pb2.RenderSpec


def load_stage(task: worker_pb2.Task, sink: SceneSink, seconds: stats_pb2.StageSeconds) -> LoadedStage:
    """Open the stage and translate it into `sink`; fills in `seconds`. Raises TaskFailedError."""
    spec = task.spec
    roots = tuple(Path(root) for root in task.roots)
    request = TranslateRequest(
        camera=spec.camera_path or None,
        time_code=spec.time_code if spec.HasField("time_code") else None,
        size=(spec.width, spec.height) if spec.width else None,
        roots=roots,
        budget=_budget(task),
    )
    limits = OpenLimits(prims=task.budget.prims, every_file=task.HasField("budget"))
    unreadable = (StageNotFoundError, StageUnreadableError, StageMalformedError, OSError)
    before = time.monotonic()
    with failing_as(FailureReason.SCENE, StageError), failing_as(FailureReason.STAGE_UNREADABLE, *unreadable):
        opened = open_stage(Path(spec.stage_path), roots=roots, limits=limits)
    seconds.open = time.monotonic() - before
    before = time.monotonic()
    with (
        failing_as(FailureReason.SCENE, StageError, ValueError),
        failing_as(FailureReason.STAGE_UNREADABLE, StageUnreadableError),
        failing_as(FailureReason.INVALID_ARGUMENT, CameraError),
    ):
        report = translate(opened, sink, request, load_image=_load_image)
    seconds.translate = time.monotonic() - before
    resolved = render_pb2.RenderSpec(
        camera_path=report.camera, time_code=report.time_code, width=report.width, height=report.height
    )
    return LoadedStage(report, resolved)


def _budget(task: worker_pb2.Task) -> Budget:
    """What the stage may hold: what the task says, else the translator's own limits."""
    if not task.HasField("budget"):
        return Budget()
    given = task.budget
    return replace(Budget(), prims=given.prims, instances=given.instances, points=given.points, texels=given.texels)


def _load_image(path: str, admit: Admit) -> NDArray[np.float32]:
    """(H, W, 3) linear texels. Raises ImageError, a ValueError, naming the file."""
    return read_image(Path(path), admit=admit)
