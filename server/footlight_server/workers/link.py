"""The worker's side of the conversation: requests come in on a thread of their own, events go out."""

import os
import socket
import threading

from footlight.worker.v1 import worker_pb2
from footlight_server.workers.channel import BrokenFrameError, WorkerEnd
from footlight_server.workers.failure import Failure


class Link:
    """Holds what the server asks for while the main thread renders."""

    def __init__(self, connection: socket.socket) -> None:
        self._end = WorkerEnd(connection)
        self._finish = threading.Event()
        self._aovs: frozenset[str] = frozenset()

    @property
    def finish_asked(self) -> bool:
        """No more samples shall be taken."""
        return self._finish.is_set()

    @property
    def wanted_aovs(self) -> frozenset[str]:
        """What somebody looks at."""
        return self._aovs

    def receive_task(self) -> worker_pb2.Task:
        """Wait for the task. Ends the process when the server has gone."""
        request = self._end.receive(worker_pb2.WorkerRequest)
        if request is None:
            os._exit(0)
        return request.task

    def listen(self) -> None:
        """Take in further requests, on a thread. Ends the process when the server has gone."""
        threading.Thread(target=self._listen, name="link", daemon=True).start()

    def send(self, event: worker_pb2.WorkerEvent, descriptor: int | None = None) -> None:
        """Tell the server."""
        self._end.send(event, descriptor)

    def send_failure(self, failure: Failure) -> None:
        """Tell the server that nothing will come of it."""
        event = worker_pb2.WorkerEvent()
        event.failed.reason = "FAILURE_REASON_" + failure.reason.name  # type: ignore[assignment]
        event.failed.message = failure.message
        event.failed.prim_path = failure.prim_path
        self._end.send(event)

    def _listen(self) -> None:
        try:
            while (request := self._end.receive(worker_pb2.WorkerRequest)) is not None:
                if request.HasField("finish"):
                    self._finish.set()
                elif request.HasField("publish"):
                    self._aovs = frozenset(request.publish.aovs)
        except (OSError, BrokenFrameError):
            pass
        os._exit(0)
