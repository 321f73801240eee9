"""From what is asked for to what a worker is given: the spec with the server's limits around it."""

import math
import os
from pathlib import Path

from footlight.v1 import render_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.settings import Settings


def make_task(
    spec: render_pb2.RenderSpec, settings: Settings, directory: Path, files: Path | None = None
) -> worker_pb2.Task:
    """The task that renders `spec` into `directory`.

    `files`: where the files of its bundle are; the stage's path is taken below it. Such a stage is not trusted, its
    worker is confined to these files and the directory. None: the spec names no bundle.
    """
    task = worker_pb2.Task(
        spec=spec,
        exr_path=str(directory / "image.exr"),
        png_path=str(directory / "image.png"),
        roots=[str(root) for root in settings.roots],
        open_cpu_seconds=math.ceil(settings.patience.opening * (os.cpu_count() or 1)),
        memory_bytes=settings.worker_memory,
    )
    if files is not None:
        task.spec.stage_path = str(files / spec.stage_path.lstrip("/"))
        del task.roots[:]
        task.roots.append(str(files))
        budget = settings.budget
        task.budget.CopyFrom(
            worker_pb2.Budget(
                prims=budget.prims, instances=budget.instances, points=budget.points, texels=budget.texels
            )
        )
        if not settings.trust_scenes:
            task.confinement.read_paths.append(str(files))
            task.confinement.write_paths.append(str(directory))
    return task
