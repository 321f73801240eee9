"""`footlight job`: one job on a page."""

from collections.abc import Iterator

from footlight.cli.connect import connect, path_map
from footlight.cli.options import MappedConnection
from footlight.cli.report import duration, usage, visible
from footlight.cli.tables import console, write_json
from footlight.cli.words import complaint, count, job_word, lasted, moment, what
from footlight.names import short
from footlight.paths import PathMap
from footlight.plain import plain
from footlight.v1 import job_pb2

# [tasks] That failed, of which the page says how.
FIRST = 10


def run_job(connection: MappedConnection, name: str, *, as_json: bool) -> None:
    """Print the job."""
    with usage():
        paths = path_map(connection)
    with connect(connection) as client:
        with usage():
            handle = client.farm.job(name)
        job = handle.get()
        failed = list(handle.tasks(states=["failed"], count=FIRST)) if job.tasks.failed else []
    if as_json:
        write_json(plain(job))
        return
    for line in page(job, failed, paths):
        console().print(visible(line), soft_wrap=True)


def page(job: job_pb2.Job, failed: list[job_pb2.Task], paths: PathMap) -> Iterator[str]:
    """Its lines; paths as this machine sees them."""
    spec = job.spec
    yield f"{job.name}: {spec.title}"
    yield from _pairs(
        ("state", job_word(job) + (f" in {lasted(job)}" if lasted(job) else "")),
        ("frames", f"{job.frames_done} of {job.frames_total}"),
        ("tasks", tasks(job.tasks)),
        ("render time", duration(job.render_seconds) if job.render_seconds else ""),
        ("user", job.user),
        ("show, shot", " ".join(filter(None, (spec.show, spec.shot)))),
        ("tags", ", ".join(spec.tags)),
        ("comment", spec.comment),
        ("priority", str(spec.priority)),
        ("retries", str(spec.retries)),
        ("waits for", ", ".join(spec.depends)),
        ("submitted", moment(job, "create_time")),
        ("started", moment(job, "start_time")),
        ("ended", moment(job, "end_time")),
    )
    for layer in spec.layers:
        yield f"layer {layer.name}"
        size = f"{layer.render.width}x{layer.render.height}, " if layer.render.width else ""
        yield from _pairs(
            ("stage", paths.to_client(layer.render.stage_path) + (" (uploaded)" if layer.render.bundle else "")),
            ("frames", layer.frames or "one, at the stage's own time"),
            ("image", f"{size}{layer.render.spp} spp"),
            ("output", paths.to_client(layer.output) if layer.output else "kept by the server; see `footlight fetch`"),
            ("cut into", ", ".join(_cut(layer))),
            ("limits", ", ".join(layer.limits)),
            ("after", ", ".join(_after(layer))),
        )
    if failed:
        yield "failed"
        yield from (f"  {what(task)}: {complaint(task.last_attempt)}" for task in failed)
        more = job.tasks.failed - len(failed)
        yield from [f"  … and {more} more; see `footlight tasks {short(job.name)} --state failed`"] * (more > 0)


def tasks(counts: job_pb2.TaskCounts) -> str:
    """`2 running, 3 ready`; states without tasks are left out."""
    numbers = [(getattr(counts, field.name), field.name) for field in counts.DESCRIPTOR.fields]
    return ", ".join(f"{number} {word}" for number, word in numbers if number)


def _cut(layer: job_pb2.LayerSpec) -> Iterator[str]:
    if layer.chunk > 1:
        yield f"tasks of {count(layer.chunk, 'frame')}"
    if layer.split > 1:
        yield f"{layer.split} sample ranges"


def _after(layer: job_pb2.LayerSpec) -> Iterator[str]:
    for other in layer.depends:
        yield f"{other.layer}, frame by frame" if other.frame_by_frame else other.layer


def _pairs(*pairs: tuple[str, str]) -> Iterator[str]:
    return (f"  {name:12} {value}" for name, value in pairs if value)
