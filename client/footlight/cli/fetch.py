"""`footlight fetch`: the images of a job, to files here."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from footlight.cli.connect import connect
from footlight.cli.options import MappedConnection
from footlight.cli.report import note, usage
from footlight.cli.tables import write_json
from footlight.cli.words import count
from footlight.errors import FrameNotFoundError
from footlight.job_calls import ImageFormat
from footlight.jobs import Job
from footlight.sequence import frame_path, has_frame
from footlight.v1 import job_pb2

SUFFIXES: dict[ImageFormat, str] = {"exr": ".exr", "png": ".png", "thumbnail": ".png", "contact-sheet": ".png"}


@dataclass(frozen=True, slots=True)
class Wanted:
    """A file to fetch. `sha256` is of the file if it is known."""

    layer: str
    frame: int
    path: Path
    sha256: str = ""

    def is_here(self) -> bool:
        """The file is there, with the bytes that would be fetched."""
        if not (self.sha256 and self.path.is_file()):
            return False
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == self.sha256


def run_fetch(
    connection: MappedConnection,
    name: str,
    output: str,
    image_format: ImageFormat,
    layer: str,
    frames: Sequence[int],
    *,
    as_json: bool,
) -> None:
    """Fetch what is there of the choice, and say what is not."""
    with connect(connection) as client:
        with usage():
            job = client.farm.job(name)
        state = job.get()
        layers = [each.name for each in state.spec.layers]
        if layer and layer not in layers:
            raise FrameNotFoundError(f"{job.name} has no layer {layer}; it has {', '.join(layers)}")
        found = [frame for frame in job.frames() if not layer or frame.layer == layer]
        missing = sorted(set(frames) - {frame.frame for frame in found})
        if missing:
            raise FrameNotFoundError(f"{job.name} has no image of frame {', '.join(map(str, missing))}, or not yet")
        chosen = [frame for frame in found if not frames or frame.frame in frames]
        wanted = list(_wanted(chosen, output, image_format))
        fetched = [file for file in wanted if _fetch(job, file, image_format)]
    if as_json:
        write_json([{"layer": file.layer, "frame": file.frame, "path": str(file.path)} for file in wanted])
    already = len(wanted) - len(fetched)
    here = f", {already} here already" if already else ""
    rest = state.frames_total - state.frames_done
    note(f"{count(len(fetched), 'file')} fetched{here}" + (f"; {count(rest, 'frame')} not done" if rest else ""))


def _fetch(job: Job, file: Wanted, image_format: ImageFormat) -> bool:
    """Fetch a file unless it is here. Raises OSError naming it."""
    if file.is_here():
        return False
    job.save(file.path, file.frame, file.layer, image_format)
    note(str(file.path))
    return True


def _wanted(frames: Sequence[job_pb2.Frame], output: str, image_format: ImageFormat) -> Iterator[Wanted]:
    """The files for these frames. Raises typer.BadParameter for a pattern that gives two of them one name."""
    sheet = image_format == "contact-sheet"
    layers = sorted({frame.layer for frame in frames})
    pattern = _pattern(output, image_format)
    if not sheet and len(frames) > 1 and not has_frame(pattern):
        raise typer.BadParameter(f"{output!r} is one file for {len(frames)} frames; write ####", param_hint="--output")
    if len(layers) > 1 and "<layer>" not in pattern:
        text = f"{output!r} is one file for layers {', '.join(layers)}; write <layer> or choose --layer"
        raise typer.BadParameter(text, param_hint="--output")
    if sheet:
        # A sheet has no number: its layer's first frame stands for it.
        frames = [next(frame for frame in frames if frame.layer == layer) for layer in layers]
    if {".", ".."} & set(layers):
        raise typer.BadParameter("a layer of this job has a name that no file can have", param_hint="--output")
    for frame in frames:
        path = Path(frame_path(pattern, frame.frame, frame.layer))
        path.parent.mkdir(parents=True, exist_ok=True)
        yield Wanted(frame.layer, frame.frame, path, frame.sha256 if image_format == "exr" else "")


def _pattern(output: str, image_format: ImageFormat) -> str:
    """A directory becomes a pattern in it."""
    suffix = SUFFIXES[image_format]
    if not (Path(output).is_dir() or output.endswith("/")):
        if Path(output).suffix.lower() != suffix:
            raise typer.BadParameter(
                f"{output!r} is no directory and does not end in {suffix}; for a new directory write {output}/",
                param_hint="--output",
            )
        return output
    if image_format == "contact-sheet":
        return str(Path(output) / "<layer>.contact-sheet.png")
    kind = ".thumbnail" if image_format == "thumbnail" else ""
    return str(Path(output) / f"<layer>.####{kind}{suffix}")
