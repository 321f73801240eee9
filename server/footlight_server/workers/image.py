"""Writes what a render comes to: the EXR with its attributes, the PNG and the thumbnail if they are asked for."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from footlight.v1 import report_pb2, stats_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.images.display import write_png
from footlight_server.images.exr import Attribute, write_exr
from footlight_server.images.files import ImageError
from footlight_server.images.thumbnail import write_thumbnail
from footlight_server.workers.causes import failing_as
from footlight_server.workers.failure import FailureReason
from footlight_server.workers.shown import shown_stage
from footlight_server.workers.versions import versions

_ERRORS = ("error_mean", "error_p95")


class ImageSource(Protocol):
    """The part of the core's Renderer that is needed here."""

    def read(self, aov: str) -> NDArray[np.float32]:
        """(height, width, channels) float32."""
        ...


def write_image(
    task: worker_pb2.Task,
    source: ImageSource,
    aovs: Sequence[str],
    attributes: Mapping[str, Attribute],
) -> None:
    """All files of a task that hold pixels. Raises TaskFailedError."""
    planes = {aov: source.read(aov) for aov in aovs}
    with failing_as(FailureReason.OUTPUT, ImageError, OSError):
        write_exr(Path(task.exr_path), planes, attributes)
        if task.spec.HasField("png"):
            write_png(Path(task.png_path), planes["color"], view=task.spec.png.view)
        if task.thumbnail_path:
            write_thumbnail(Path(task.thumbnail_path), planes["color"])


def attributes_of(
    task: worker_pb2.Task, report: report_pb2.StageReport, samples: int, errors: stats_pb2.RenderStats
) -> dict[str, Attribute]:
    """What the EXR says of itself. `samples` [samples per pixel] from 0 on; of `errors` the two figures are read.

    The task's spec is as it was resolved.
    """
    spec = task.spec
    attributes: dict[str, Attribute] = {
        "version": versions()["footlight"],
        "stage": shown_stage(task, spec),
        "camera": spec.camera_path,
        "seed": spec.seed,
        "samples": (0, samples),
        "effects": [effect.name for effect in report.effects if effect.active],
        "pipeline": list(report.pipeline),
    }
    if spec.HasField("time_code"):
        attributes["time_code"] = spec.time_code
    for name in _ERRORS:
        if errors.HasField(name):  # type: ignore[arg-type]
            attributes[name] = float(getattr(errors, name))
    return attributes
