"""Makes a contact sheet, in a worker because thumbnails of stages that are not trusted are not trusted either."""

from pathlib import Path

from footlight.worker.v1 import worker_pb2
from footlight_server.images.contact_sheet import write_contact_sheet
from footlight_server.images.files import ImageError
from footlight_server.workers.causes import failing_as
from footlight_server.workers.failure import FailureReason
from footlight_server.workers.link import Link


class SheetTask:
    """Runs a task given by the server; every outcome but success is an exception."""

    def __init__(self, task: worker_pb2.Task, link: Link) -> None:
        self._task = task
        self._link = link

    def run(self) -> None:
        """Do all of it."""
        with failing_as(FailureReason.OUTPUT, ImageError, OSError):
            write_contact_sheet(Path(self._task.thumbnail_path), [Path(path) for path in self._task.sheet_paths])
        self._link.send(worker_pb2.WorkerEvent(done=worker_pb2.Done(has_image=True)))
