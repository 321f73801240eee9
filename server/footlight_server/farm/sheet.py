"""Contact sheets: made by a worker when somebody asks and there are other thumbnails than before."""

import asyncio
import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

from footlight.v1 import job_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.farm.places import Places, frame_file, frame_of
from footlight_server.farm.queue import Queue
from footlight_server.sessions.errors import FrameNotFoundError, StorageError
from footlight_server.settings import Settings
from footlight_server.workers.process import WorkerGoneError
from footlight_server.workers.source import WorkerSource

# [s] For the thumbnails of a layer; ten thousand take about a minute.
_PATIENCE = 300.0


class Sheets:
    """Makes one sheet at a time: they are for looking at, and renders need the processor more.

    `source`: of workers on this machine.
    """

    def __init__(self, settings: Settings, places: Places, queue: Queue, source: WorkerSource) -> None:
        self._settings = settings
        self._places = places
        self._queue = queue
        self._source = source
        self._turn = asyncio.Lock()

    async def sheet(self, job: int, layer: str) -> Path:
        """The file, up to date.

        Raises JobNotFoundError, FrameNotFoundError if there is no thumbnail, StorageError if it cannot be made.
        """
        spec = job_pb2.LayerSpec.FromString(await self._queue.layer_spec(job, layer))
        sheet = self._places.sheet(job, layer)
        folder = self._places.thumbnail(job, layer, 0).parent
        async with self._turn:
            known = await asyncio.to_thread(_look, folder, layer)
            if not known.frames:
                raise FrameNotFoundError(f"jobs/{job}: no frame of layer {layer!r} is done")
            if await asyncio.to_thread(_changed, sheet) != known.changed:
                task = worker_pb2.Task(thumbnail_path=str(sheet), memory_bytes=self._settings.worker_memory)
                task.sheet_paths.extend(str(folder / frame_file(layer, frame, ".png")) for frame in known.frames)
                if spec.render.bundle and not self._settings.trust_scenes:
                    task.confinement.read_paths.append(str(folder))
                    task.confinement.write_paths.append(str(sheet.parent))
                await asyncio.to_thread(sheet.parent.mkdir, parents=True, exist_ok=True)
                await self._make(task)
                # Not the time it is now: a thumbnail that came while the sheet was made is not on it.
                times = known.changed, known.changed
                await asyncio.to_thread(os.utime, sheet, ns=times, follow_symlinks=False)
        return sheet

    async def _make(self, task: worker_pb2.Task) -> None:
        try:
            async with asyncio.timeout(_PATIENCE):
                worker = await self._source.take(task)
                try:
                    await worker.send(worker_pb2.WorkerRequest(task=task))
                    event = await worker.receive()
                finally:
                    await worker.close()
        except TimeoutError:
            raise StorageError(f"the contact sheet was not made within {_PATIENCE:g} s") from None
        except WorkerGoneError as gone:
            raise StorageError(f"the contact sheet cannot be made: {gone}") from gone
        if not event.HasField("done"):
            raise StorageError(f"the contact sheet cannot be made: {event.failed.message}")


@dataclass(frozen=True, slots=True)
class _Thumbnails:
    """Frames of a layer that have one, and when the folder changed last [ns]."""

    frames: list[int]
    changed: int


def _look(folder: Path, layer: str) -> _Thumbnails:
    """What there is. Blocks."""
    changed = _changed(folder)
    with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:
        frames = (frame_of(Path(entry.name), layer) for entry in entries if not entry.name.startswith(f".{layer}."))
        return _Thumbnails(sorted(frame for frame in frames if frame is not None), changed)
    return _Thumbnails([], changed)


def _changed(path: Path) -> int:
    """[ns] 0 if it is not there. Blocks."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0
