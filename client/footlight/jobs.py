"""One job of the farm queue: look, watch, steer, fetch what it made. Once with threads, once with asyncio."""

import os
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import aclosing
from pathlib import Path

import grpc

from footlight import job_calls as calls
from footlight.errors import rpc_errors
from footlight.files import replacing
from footlight.job_calls import ImageFormat
from footlight.pieces import Pieces
from footlight.resume import Patience, resumed, resumed_async
from footlight.v1 import job_pb2, job_service_pb2, job_service_pb2_grpc

# [s] That a stream of a job is tried again after it broke: the job outlives its server.
PATIENCE = 300.0


class Job:
    """A job by name, `jobs/12`. Made by `Farm.submit` and `Farm.job`; good until the client is closed.

    Every method raises FootlightError (see footlight.errors): ServerUnavailableError if no server answers,
    JobNotFoundError if it knows no such job, DeniedError if the token does not allow it.
    """

    def __init__(self, name: str, channel: grpc.Channel, address: str, timeout: float) -> None:
        self.name = name
        self._stub = job_service_pb2_grpc.JobServiceStub(channel)
        self._address = address
        self._timeout = timeout

    def get(self) -> job_pb2.Job:
        """The job as it is now."""
        with rpc_errors(self._address):
            return calls.job(self._stub.GetJob(calls.get(self.name), timeout=self._timeout))

    def tasks(self, *, states: Iterable[str] = (), layer: str = "", count: int | None = None) -> Iterator[job_pb2.Task]:
        """Its tasks by number, the first `count` or all, fetched as they are asked for.

        `states` are words as `failed`; `layer` is a layer's name. Raises ValueError for an unknown state.
        """
        request = calls.tasks(self.name, states, layer, count)
        with rpc_errors(self._address):
            for page in calls.pages(self._stub.ListTasks, request, self._timeout):
                yield from page.tasks
                if count is not None and (count := count - len(page.tasks)) <= 0:
                    return

    def attempts(self, task: str) -> list[job_pb2.Attempt]:
        """All attempts at a task, `jobs/12/tasks/3`, in order."""
        with rpc_errors(self._address):
            request = job_service_pb2.ListAttemptsRequest(task=task)
            return list(self._stub.ListAttempts(request, timeout=self._timeout).attempts)

    def frames(self) -> Iterator[job_pb2.Frame]:
        """The frames that have an image, by layer and number, fetched as they are asked for."""
        request = job_service_pb2.ListFramesRequest(job=self.name, page_size=calls.PAGE)
        with rpc_errors(self._address):
            for page in calls.pages(self._stub.ListFrames, request, self._timeout):
                yield from page.frames

    def pause(self) -> job_pb2.Job:
        """Start nothing new of it. Raises JobEndedError."""
        with rpc_errors(self._address):
            request = job_service_pb2.PauseJobRequest(name=self.name)
            return calls.job(self._stub.PauseJob(request, timeout=self._timeout))

    def resume(self) -> job_pb2.Job:
        """Undo `pause`. Raises JobEndedError."""
        with rpc_errors(self._address):
            request = job_service_pb2.ResumeJobRequest(name=self.name)
            return calls.job(self._stub.ResumeJob(request, timeout=self._timeout))

    def cancel(self) -> job_pb2.Job:
        """Stop what runs and start nothing more; images that are there stay."""
        with rpc_errors(self._address):
            request = job_service_pb2.CancelJobRequest(name=self.name)
            return calls.job(self._stub.CancelJob(request, timeout=self._timeout))

    def retry(self, *, tasks: Iterable[str] = (), layer: str = "", frames: str = "") -> int:
        """Give tasks that failed, were skipped or cancelled another round; by default all. The number of tasks."""
        with rpc_errors(self._address):
            request = calls.retry(self.name, tasks, layer, frames)
            return calls.changed(self._stub.RetryTasks(request, timeout=self._timeout))

    def skip(self, *, tasks: Iterable[str] = (), layer: str = "", frames: str = "") -> int:
        """Give up on tasks that have not succeeded; something has to be chosen. The number of tasks."""
        with rpc_errors(self._address):
            request = calls.skip(self.name, tasks, layer, frames)
            return calls.changed(self._stub.SkipTasks(request, timeout=self._timeout))

    def why(self, task: str = "") -> list[str]:
        """Why it, or one of its tasks, is not running; empty if it is, or has ended."""
        with rpc_errors(self._address):
            request = job_service_pb2.ExplainWaitRequest(name=task or self.name)
            return list(self._stub.ExplainWait(request, timeout=self._timeout).reasons)

    def events(
        self, *, after: int = 0, only_new: bool = False, patience: Patience | None = None
    ) -> Iterator[job_pb2.JobEvent]:
        """What happens until the job has ended, from the beginning, after the event `after`, or from now on.

        The first event is the job as it is. A stream that breaks is taken up where it was, for PATIENCE [s] or as
        `patience` says; then the job as it is comes again. A consumer may take its time.
        """
        watch = calls.Watch(self.name, after, only_new=only_new)
        patience = patience or Patience(PATIENCE)
        for response in resumed(self._address, patience, lambda: self._stub.WatchJob(watch.request())):
            yield watch(response)

    def wait(self) -> job_pb2.Job:
        """The job once it has succeeded. Raises JobFailedError, JobCancelledError."""
        last = None
        for event in self.events(only_new=True):
            last = event.changed if event.HasField("changed") else last
        job = calls.ended(self.name, last)
        return calls.outcome(job, tuple(self.tasks(states=["failed"], count=3)) if calls.has_failed(job) else ())

    def log(self, name: str, *, offset: int = 0, follow: bool = False) -> Iterator[bytes]:
        """The log of an attempt, or of the last one of a task, in pieces; to its end with `follow`."""
        at = calls.LogPosition(name, offset, follow=follow)
        for response in resumed(self._address, Patience(PATIENCE), lambda: self._stub.ReadLog(at.request())):
            yield at(response)

    def pieces(self, frame: int, layer: str = "", image_format: ImageFormat = "exr") -> Iterator[bytes]:
        """An image file of a frame in pieces of at most 256 KB, in order. Raises FrameNotFoundError."""
        assemble = Pieces()

        def call() -> object:
            return self._stub.GetFrame(calls.frame(self.name, frame, layer, image_format, assemble.offset))

        for response in resumed(self._address, Patience(PATIENCE), call):
            yield assemble(response)
        assemble.check()

    def image(self, frame: int, layer: str = "", image_format: ImageFormat = "exr") -> bytes:
        """An image file of a frame. Raises FrameNotFoundError."""
        return b"".join(self.pieces(frame, layer, image_format))

    def save(
        self, path: str | os.PathLike[str], frame: int, layer: str = "", image_format: ImageFormat = "exr"
    ) -> None:
        """Fetch an image file to `path`, which appears whole or not at all. Raises FrameNotFoundError, OSError."""
        with replacing(Path(path)) as temporary, temporary.open("wb") as file:
            for piece in self.pieces(frame, layer, image_format):
                file.write(piece)


class AsyncJob:
    """`Job` for asyncio: the same methods, awaited, and the same errors."""

    def __init__(self, name: str, channel: grpc.aio.Channel, address: str, timeout: float) -> None:
        self.name = name
        self._stub = job_service_pb2_grpc.JobServiceStub(channel)
        self._address = address
        self._timeout = timeout

    async def get(self) -> job_pb2.Job:
        """As `Job.get`."""
        with rpc_errors(self._address):
            return calls.job(await self._stub.GetJob(calls.get(self.name), timeout=self._timeout))

    async def tasks(
        self, *, states: Iterable[str] = (), layer: str = "", count: int | None = None
    ) -> AsyncIterator[job_pb2.Task]:
        """As `Job.tasks`."""
        request = calls.tasks(self.name, states, layer, count)
        with rpc_errors(self._address):
            async for page in calls.pages_async(self._stub.ListTasks, request, self._timeout):
                for task in page.tasks:
                    yield task
                if count is not None and (count := count - len(page.tasks)) <= 0:
                    return

    async def attempts(self, task: str) -> list[job_pb2.Attempt]:
        """As `Job.attempts`."""
        with rpc_errors(self._address):
            request = job_service_pb2.ListAttemptsRequest(task=task)
            return list((await self._stub.ListAttempts(request, timeout=self._timeout)).attempts)

    async def frames(self) -> AsyncIterator[job_pb2.Frame]:
        """As `Job.frames`."""
        request = job_service_pb2.ListFramesRequest(job=self.name, page_size=calls.PAGE)
        with rpc_errors(self._address):
            async for page in calls.pages_async(self._stub.ListFrames, request, self._timeout):
                for frame in page.frames:
                    yield frame

    async def pause(self) -> job_pb2.Job:
        """As `Job.pause`."""
        with rpc_errors(self._address):
            request = job_service_pb2.PauseJobRequest(name=self.name)
            return calls.job(await self._stub.PauseJob(request, timeout=self._timeout))

    async def resume(self) -> job_pb2.Job:
        """As `Job.resume`."""
        with rpc_errors(self._address):
            request = job_service_pb2.ResumeJobRequest(name=self.name)
            return calls.job(await self._stub.ResumeJob(request, timeout=self._timeout))

    async def cancel(self) -> job_pb2.Job:
        """As `Job.cancel`."""
        with rpc_errors(self._address):
            request = job_service_pb2.CancelJobRequest(name=self.name)
            return calls.job(await self._stub.CancelJob(request, timeout=self._timeout))

    async def retry(self, *, tasks: Iterable[str] = (), layer: str = "", frames: str = "") -> int:
        """As `Job.retry`."""
        with rpc_errors(self._address):
            request = calls.retry(self.name, tasks, layer, frames)
            return calls.changed(await self._stub.RetryTasks(request, timeout=self._timeout))

    async def skip(self, *, tasks: Iterable[str] = (), layer: str = "", frames: str = "") -> int:
        """As `Job.skip`."""
        with rpc_errors(self._address):
            request = calls.skip(self.name, tasks, layer, frames)
            return calls.changed(await self._stub.SkipTasks(request, timeout=self._timeout))

    async def why(self, task: str = "") -> list[str]:
        """As `Job.why`."""
        with rpc_errors(self._address):
            request = job_service_pb2.ExplainWaitRequest(name=task or self.name)
            return list((await self._stub.ExplainWait(request, timeout=self._timeout)).reasons)

    async def events(
        self, *, after: int = 0, only_new: bool = False, patience: Patience | None = None
    ) -> AsyncIterator[job_pb2.JobEvent]:
        """As `Job.events`."""
        watch = calls.Watch(self.name, after, only_new=only_new)
        patience = patience or Patience(PATIENCE)
        call = resumed_async(self._address, patience, lambda: self._stub.WatchJob(watch.request()))
        async with aclosing(call) as responses:
            async for response in responses:
                yield watch(response)

    async def wait(self) -> job_pb2.Job:
        """As `Job.wait`."""
        last = None
        async for event in self.events(only_new=True):
            last = event.changed if event.HasField("changed") else last
        job = calls.ended(self.name, last)
        failed = self.tasks(states=["failed"], count=3)
        return calls.outcome(job, tuple([task async for task in failed]) if calls.has_failed(job) else ())

    async def log(self, name: str, *, offset: int = 0, follow: bool = False) -> AsyncIterator[bytes]:
        """As `Job.log`."""
        at = calls.LogPosition(name, offset, follow=follow)
        call = resumed_async(self._address, Patience(PATIENCE), lambda: self._stub.ReadLog(at.request()))
        async with aclosing(call) as responses:
            async for response in responses:
                yield at(response)

    async def pieces(self, frame: int, layer: str = "", image_format: ImageFormat = "exr") -> AsyncIterator[bytes]:
        """As `Job.pieces`."""
        assemble = Pieces()

        def call() -> object:
            return self._stub.GetFrame(calls.frame(self.name, frame, layer, image_format, assemble.offset))

        async with aclosing(resumed_async(self._address, Patience(PATIENCE), call)) as responses:
            async for response in responses:
                yield assemble(response)
        assemble.check()

    async def image(self, frame: int, layer: str = "", image_format: ImageFormat = "exr") -> bytes:
        """As `Job.image`."""
        return b"".join([piece async for piece in self.pieces(frame, layer, image_format)])

    async def save(
        self, path: str | os.PathLike[str], frame: int, layer: str = "", image_format: ImageFormat = "exr"
    ) -> None:
        """As `Job.save`. Writing blocks the loop for a piece at a time."""
        with replacing(Path(path)) as temporary, temporary.open("wb") as file:
            async for piece in self.pieces(frame, layer, image_format):
                file.write(piece)
