"""From a claimed task to what a worker is given for one of its frames, and where the result goes. Pure."""

from dataclasses import dataclass, replace
from pathlib import Path

from footlight.v1 import job_pb2, render_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.farm.model import Claim, Frame, Task, TaskKind
from footlight_server.farm.outputs import parse_output
from footlight_server.farm.places import Places, workspace
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.tasks import make_task
from footlight_server.settings import Settings


@dataclass(frozen=True, slots=True)
class Assignment:
    """One frame of a claim: the worker's task, the directory it works in, and files in it with where they go.

    `made`: the image or part, on the same disk as its `target`. `ours`: that is in the data folder, whose directories
    we make. `extras`: small files, as (made, target).
    """

    task: worker_pb2.Task
    frame: int
    directory: Path
    made: Path
    target: Path
    ours: bool
    extras: tuple[tuple[Path, Path], ...]


def target_of(layer: job_pb2.LayerSpec, task: Task, frame: int, places: Places) -> Path:
    """Where the image of a frame goes, or for a task with a part of the samples, the part."""
    if is_part(layer, task):
        return places.part(task.job, task.layer, frame, task.sample_begin)
    if layer.output:
        return parse_output(layer.output).path(frame)
    return places.image(task.job, task.layer, frame)


def is_part(layer: job_pb2.LayerSpec, task: Task) -> bool:
    """The task takes a range of the samples, and a merge makes the image of it."""
    return layer.split > 1 and task.kind is TaskKind.RENDER


def bundle_of(claim: Claim) -> str:
    """Digest of the bundle that the stage is in; empty: it is a file of this machine."""
    return str(job_pb2.LayerSpec.FromString(claim.layer_spec).render.bundle)


def assign(
    claim: Claim,
    frame: int,
    *,
    settings: Settings,
    places: Places,
    parts: tuple[Frame, ...] = (),
    files: Path | None = None,
) -> Assignment:
    """What a worker does for a frame.

    `parts`: for a merge, those of this frame. `files`: of the layer's bundle, if it has one.
    """
    layer = job_pb2.LayerSpec.FromString(claim.layer_spec)
    job = job_pb2.JobSpec.FromString(claim.job_spec)
    target = target_of(layer, claim.task, frame, places)
    directory = workspace(target, claim.attempt, frame)
    task = make_task(_spec(layer, frame), settings, directory, files)
    task.environment.update(job.environment)
    extras: list[tuple[Path, Path]] = []
    if is_part(layer, claim.task):
        task.sample_begin, task.sample_end = claim.task.sample_begin, claim.task.sample_end
        task.part_path = str(directory / "film.part")
        task.spec.ClearField("png")
        made = Path(task.part_path)
    else:
        made = Path(task.exr_path)
        task.thumbnail_path = str(directory / "thumbnail.png")
        extras.append((Path(task.thumbnail_path), places.thumbnail(claim.task.job, layer.name, frame)))
        if task.spec.HasField("png"):
            extras.append((Path(task.png_path), places.picture(claim.task.job, layer.name, frame)))
    if claim.task.kind is TaskKind.MERGE:
        task.merge_paths.extend(part.path for part in parts)
        if task.HasField("confinement"):
            task.confinement.read_paths.extend(part.path for part in parts)
    return Assignment(task, frame, directory, made, target, target.is_relative_to(places.data), tuple(extras))


def patience_of(claim: Claim, settings: Settings) -> Patience:
    """How long a frame of this claim may take, and be silent."""
    job = job_pb2.JobSpec.FromString(claim.job_spec)
    patience = replace(settings.patience, total=job.timeout_seconds)
    return replace(patience, rendering=job.stall_timeout_seconds) if job.stall_timeout_seconds else patience


def _spec(layer: job_pb2.LayerSpec, frame: int) -> render_pb2.RenderSpec:
    """The layer's, at the frame's time; a layer without a range is rendered at the stage's own."""
    spec = render_pb2.RenderSpec()
    spec.CopyFrom(layer.render)
    if layer.frames.strip():
        spec.time_code = frame
    return spec
