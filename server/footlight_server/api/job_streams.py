"""The streams of JobService: what happens to a job, the log of an attempt, the image of a frame."""

import asyncio
import contextlib
import os
from pathlib import Path

import grpc

from footlight.v1 import job_pb2, job_service_pb2
from footlight_server.api.job_feed import PAGE, JobFeed
from footlight_server.api.job_messages import job_message
from footlight_server.api.job_views import JobViews, Seen
from footlight_server.api.names import attempt_name, attempt_numbers, job_name, job_number, task_name
from footlight_server.api.streams import CHUNK_BYTES, patiently, send, send_file
from footlight_server.farm.model import Job
from footlight_server.sessions.errors import (
    FieldViolation,
    FrameNotFoundError,
    InvalidFieldsError,
    TaskNotFoundError,
)

# [s] Between two looks at a log that somebody follows; without news of the job.
_LOG_PERIOD = 0.3
_IDLE = 30.0
# [bytes] Of what pread(2) takes.
_LARGEST_OFFSET = (1 << 63) - 1


class JobWatch:
    """One client that watches a job: a place in the queue's record, moved on by what was sent."""

    def __init__(self, number: int, views: JobViews, context: grpc.aio.ServicerContext) -> None:
        self._number = number
        self._views = views
        self._context = context
        self._seen = 0
        # As the client saw it last.
        self._state = job_pb2.JOB_STATE_UNSPECIFIED

    async def run(self, feed: JobFeed, after: int, *, only_new: bool) -> None:
        """Send the job, then what happens after that event, until the job has ended."""
        # Before the job is looked at: what happens in between is sent rather than missed.
        self._seen = self._views.queue.last_event() if only_new else after
        job = await self._views.queue.job(self._number)
        await self._show(job)
        while not await self._has_ended(feed):
            await self._catch_up(feed)
            await self._follow(feed)

    async def _catch_up(self, feed: JobFeed) -> None:
        """Send what the feed does not have any more, or never had, from the queue's record."""
        while feed.position(self._seen) is None:
            latest = self._views.queue.last_event()
            events = await self._views.queue.events(self._number, self._seen, PAGE)
            for seen in (await self._views.resolve(self._number, events)).seen:
                await self._send(seen)
            self._seen = events[-1].id if len(events) == PAGE else max(self._seen, latest)

    async def _follow(self, feed: JobFeed) -> None:
        """Send what comes, until it comes no more, or the feed is ahead by more than it keeps."""
        position = feed.position(self._seen)
        while position is not None and feed.error is None:
            count = feed.news.count
            messages = feed.since(position)
            if messages is None:
                return
            for seen in messages:
                # The queue's record may be ahead of the feed.
                if seen.id == 0 or seen.id > self._seen:
                    await self._send(seen)
            position += len(messages)
            if not messages:
                if feed.ended:
                    return
                await self._wait(feed, count)
        if feed.error is not None:
            raise feed.error

    async def _has_ended(self, feed: JobFeed) -> bool:
        """Asks the queue itself: the feed may not have heard yet that an ended job was opened again."""
        if not feed.ended:
            return False
        count = feed.news.count
        job = await self._views.queue.job(self._number)
        if not job.state.ended or await self._views.queue.events(self._number, self._seen, 1, certain=True):
            if feed.position(self._seen) is not None:
                await self._wait(feed, count)
            return False
        if job_message(job).state != self._state:
            await self._show(job)
        return True

    async def _wait(self, feed: JobFeed, count: int) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_IDLE):
                await feed.news.wait(count)

    async def _show(self, job: Job) -> None:
        event = job_pb2.JobEvent(job=job_name(self._number), changed=job_message(job))
        event.time.GetCurrentTime()
        await self._send(Seen(0, event, 0))

    async def _send(self, seen: Seen) -> None:
        if seen.event.HasField("changed"):
            self._state = seen.event.changed.state
        await send(self._context, job_service_pb2.WatchJobResponse(event=seen.event))
        self._seen = max(self._seen, seen.id)


async def read_log(request: job_service_pb2.ReadLogRequest, views: JobViews, context: grpc.aio.ServicerContext) -> None:
    """The log of an attempt; a follower gets what is added until the attempt has ended."""
    job, task, attempt = attempt_numbers(request.name)
    if request.offset > _LARGEST_OFFSET:
        raise _invalid("offset", f"{request.offset}: no file is that long")
    attempt = await _which_attempt(views, job, task, attempt)
    path = views.farm.log_path(job, task, attempt)
    offset = request.offset
    count = -1
    ended = False
    while True:
        if views.queue.changed.count != count:
            # Before the log is read: its last lines are written before the attempt is recorded as ended.
            count = views.queue.changed.count
            ended = await _attempt_ended(views, job, task, attempt)
        while data := await patiently(asyncio.to_thread(_read_piece, path, offset)):
            await send(context, job_service_pb2.ReadLogResponse(offset=offset, data=data))
            offset += len(data)
        if ended or not request.follow:
            return
        await asyncio.sleep(_LOG_PERIOD)


async def send_frame(
    request: job_service_pb2.GetFrameRequest, views: JobViews, context: grpc.aio.ServicerContext
) -> None:
    """An image file of a frame."""
    job = await views.queue.job(job_number(request.job))
    layers = {layer.name: layer for layer in job_pb2.JobSpec.FromString(job.spec).layers}
    if not request.layer and len(layers) > 1:
        raise _invalid("layer", f"{job_name(job.number)} has {', '.join(layers)}; say which")
    name = request.layer or next(iter(layers))
    if name not in layers:
        raise FrameNotFoundError(f"{job_name(job.number)} has no layer {name[:80]!r}; it has {', '.join(layers)}")
    path = await _frame_path(request, views, job.number, layers[name])
    try:
        await send_file(context, path, request.offset, _frame_piece)
    except FileNotFoundError:
        raise FrameNotFoundError(f"the image of frame {request.frame} of layer {name} is gone: {path}") from None


async def _frame_path(
    request: job_service_pb2.GetFrameRequest, views: JobViews, job: int, layer: job_pb2.LayerSpec
) -> Path:
    places = views.farm.places
    match request.format:
        case job_service_pb2.FRAME_FORMAT_CONTACT_SHEET:
            return await views.farm.sheet(job, layer.name)
        case job_service_pb2.FRAME_FORMAT_UNSPECIFIED | job_service_pb2.FRAME_FORMAT_EXR:
            return Path((await views.queue.frame(job, layer.name, request.frame)).path)
        case job_service_pb2.FRAME_FORMAT_THUMBNAIL:
            await views.queue.frame(job, layer.name, request.frame)
            return places.thumbnail(job, layer.name, request.frame)
        case job_service_pb2.FRAME_FORMAT_PNG:
            if not layer.render.HasField("png"):
                raise FrameNotFoundError(f"layer {layer.name} was asked for without a PNG")
            await views.queue.frame(job, layer.name, request.frame)
            return places.picture(job, layer.name, request.frame)
    raise _invalid("format", f"{request.format}: not a FrameFormat of this server")


def _frame_piece(total: int, offset: int, data: bytes) -> job_service_pb2.GetFrameResponse:
    return job_service_pb2.GetFrameResponse(total_bytes=total, offset=offset, data=data)


async def _which_attempt(views: JobViews, job: int, task: int, attempt: int | None) -> int:
    """The attempt asked for, or the last. Raises TaskNotFoundError if there is none."""
    last = (await views.queue.task(job, task)).attempt
    if attempt is None and last == 0:
        raise TaskNotFoundError(f"{task_name(job, task)} has not been taken up yet, so it has no log")
    if attempt is not None and attempt > last:
        raise TaskNotFoundError(f"no {attempt_name(job, task, attempt)}; there were {last} attempts")
    return attempt or last


async def _attempt_ended(views: JobViews, job: int, task: int, attempt: int) -> bool:
    last = (await views.queue.task(job, task)).last_attempt
    return last is None or last.number != attempt or last.exit_class is not None


def _read_piece(path: Path, offset: int) -> bytes:
    """At most CHUNK_BYTES from `offset` on; nothing beyond the end, or before the file is there. Blocks."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return b""
    try:
        return os.pread(descriptor, CHUNK_BYTES, offset)
    finally:
        os.close(descriptor)


def _invalid(field: str, description: str) -> InvalidFieldsError:
    return InvalidFieldsError([FieldViolation(field, description)])
