"""The names in the data folder: where the queue, its jobs' logs, images, parts and thumbnails are. Pure."""

import re
from dataclasses import dataclass
from pathlib import Path

from footlight_server.farm.model import Attempt

# A file of a layer's frame, as `frame_file` names it.
_FRAME_FILE = re.compile(r"(?P<layer>.+)\.(?P<frame>-?\d+)")


@dataclass(frozen=True, slots=True)
class Places:
    """All below `data`, an absolute directory that one server owns."""

    data: Path

    @property
    def database(self) -> Path:
        """Of the queue, unless it is elsewhere."""
        return self.data / "queue.db"

    @property
    def lock(self) -> Path:
        """Held by the server that owns the folder."""
        return self.data / "lock"

    @property
    def blobs(self) -> Path:
        """Uploaded files by digest."""
        return self.data / "blobs"

    @property
    def bundles(self) -> Path:
        """Uploaded stages with their files, materialised."""
        return self.data / "bundles"

    def job(self, job: int) -> Path:
        """All that is kept of a job."""
        return self.data / "jobs" / str(job)

    def pruned(self, job: int) -> Path:
        """A mark: the job is to be forgotten, or is already, and its folder with it."""
        return self.data / "jobs" / f".pruned-{job}"

    def log(self, job: int, task: int, attempt: int) -> Path:
        """Of an attempt."""
        return self.job(job) / "logs" / f"{task}-{attempt}.log"

    def image(self, job: int, layer: str, frame: int) -> Path:
        """The EXR of a frame whose layer has no output path."""
        return self.job(job) / "frames" / frame_file(layer, frame, ".exr")

    def part(self, job: int, layer: str, frame: int, sample_begin: int) -> Path:
        """The sums of a sample range of a frame."""
        return self.job(job) / "parts" / frame_file(layer, frame, f".{sample_begin}.part")

    def thumbnail(self, job: int, layer: str, frame: int) -> Path:
        """A small PNG of a frame."""
        return self.job(job) / "thumbs" / frame_file(layer, frame, ".png")

    def picture(self, job: int, layer: str, frame: int) -> Path:
        """The PNG of a frame whose render spec asks for one."""
        return self.job(job) / "pictures" / frame_file(layer, frame, ".png")

    def sheet(self, job: int, layer: str) -> Path:
        """The contact sheet of a layer."""
        return self.job(job) / "sheets" / f"{layer}.png"


def frame_file(layer: str, frame: int, suffix: str) -> str:
    """`layer.frame` and the suffix; told apart again by `frame_of`."""
    return f"{layer}.{frame}{suffix}"


def frame_of(path: Path, layer: str) -> int | None:
    """The frame whose file this is; None if it is none of that layer."""
    found = _FRAME_FILE.fullmatch(path.stem)
    return int(found["frame"]) if found is not None and found["layer"] == layer else None


def workspace(target: Path, attempt: Attempt, frame: int) -> Path:
    """The directory beside `target` where an attempt makes it: on the same disk, so that a rename is all it takes."""
    return target.parent / f".footlight-{attempt.job}-{attempt.task}-{attempt.number}-{frame}"
