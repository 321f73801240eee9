"""JobService: the handlers; each checks whose job it is, asks the queue, answers."""

import asyncio
import re
from collections.abc import Awaitable, Mapping, Sequence
from typing import TypeAlias, TypeVar

import grpc
from google.protobuf.message import Message

from footlight.v1 import job_pb2, job_service_pb2, job_service_pb2_grpc
from footlight_server.api.auth import caller
from footlight_server.api.errors import told
from footlight_server.api.job_feed import JobFeeds
from footlight_server.api.job_messages import (
    JOB_STATES,
    LIMIT_UNITS,
    TASK_STATES,
    frame_message,
    job_message,
    limit_message,
)
from footlight_server.api.job_streams import JobWatch, read_log, send_frame
from footlight_server.api.job_views import JobViews
from footlight_server.api.layer_spec import NAME
from footlight_server.api.names import is_task_name, job_name, job_number, task_name, task_numbers
from footlight_server.api.owner import check_owner
from footlight_server.api.streams import ClientGoneError
from footlight_server.api.submission import Bundles, Submissions
from footlight_server.farm.dispatcher import Farm
from footlight_server.farm.model import Job, Limit, Selection
from footlight_server.farm.queue import Queue
from footlight_server.farm.why import explain_wait
from footlight_server.sessions.errors import (
    FieldViolation,
    InvalidFieldsError,
    JobNotEndedError,
)
from footlight_server.settings import Settings

_LARGEST_PAGE = 1000
_JOBS_PAGE = 50
_JOBS_TOGETHER = 100
_PAGE = 100
# [bytes] Of a page; clients take 4 MB, and one more message may be as large as a request.
_PAGE_BYTES = 1 << 20
_MOST_RUNNING = (1 << 31) - 1
_LATEST_EVENT = (1 << 63) - 1
_MOST_PRUNED = 10_000
# [s] For files that are being removed when the server stops.
_CLOSING = 5.0
_NUMBER = re.compile(r"-?[0-9]{1,18}", re.ASCII)

Context: TypeAlias = grpc.aio.ServicerContext
M = TypeVar("M", bound=Message)
S = TypeVar("S")


class JobService(job_service_pb2_grpc.JobServiceServicer):  # type: ignore[misc]
    """Knows gRPC, the queue and the farm. `close` before the queue is."""

    def __init__(self, queue: Queue, farm: Farm, bundles: Bundles, settings: Settings) -> None:
        self._queue = queue
        self._farm = farm
        self._views = JobViews(queue, farm)
        self._feeds = JobFeeds(self._views)
        self._submissions = Submissions(queue, bundles, settings)
        self._pruning: set[asyncio.Task[int]] = set()

    async def close(self) -> None:
        """End the streams of those who watch, and what is being removed."""
        await self._feeds.close()
        if self._pruning:
            await asyncio.wait(self._pruning, timeout=_CLOSING)

    # --- submitting and looking ---

    @told
    async def CreateJob(
        self, request: job_service_pb2.CreateJobRequest, context: Context
    ) -> job_service_pb2.CreateJobResponse:
        """Check, cut up, accept."""
        submitted = await self._submissions.submit(request, caller(context))
        return job_service_pb2.CreateJobResponse(job=submitted.job, notes=submitted.notes)

    @told
    async def GetJob(self, request: job_service_pb2.GetJobRequest, context: Context) -> job_service_pb2.GetJobResponse:
        """As it is now."""
        job = await self._queue.job(job_number(request.name))
        return job_service_pb2.GetJobResponse(job=job_message(job))

    @told
    async def ListJobs(
        self, request: job_service_pb2.ListJobsRequest, context: Context
    ) -> job_service_pb2.ListJobsResponse:
        """A page of them."""
        size = _page_size(request.page_size, _JOBS_PAGE)
        before = _token(request.page_token) if request.page_token else None
        states = _chosen(request.states, JOB_STATES, "JobState")
        found: list[job_pb2.Job] = []
        while True:
            # Not all at once: the specs of a thousand jobs may be a gigabyte, and a page holds little of that.
            some = min(size - len(found), _JOBS_TOGETHER)
            jobs = await self._queue.jobs(
                some + 1, before, states, request.user, request.show, request.shot, request.tag
            )
            found += [job_message(job) for job in jobs[:some]]
            page = _fitting(found)
            if len(page) < len(found) or len(jobs) <= some or len(found) == size:
                break
            before = jobs[some - 1].number
        whole = len(page) == len(found) and len(jobs) <= some
        more = "" if whole else str(job_number(page[-1].name))
        return job_service_pb2.ListJobsResponse(jobs=page, next_page_token=more)

    @told
    async def ListTasks(
        self, request: job_service_pb2.ListTasksRequest, context: Context
    ) -> job_service_pb2.ListTasksResponse:
        """A page of them."""
        size = _page_size(request.page_size, _PAGE)
        tasks = await self._queue.tasks(
            job_number(request.job),
            size + 1,
            after=_token(request.page_token) if request.page_token else 0,
            states=_chosen(request.states, TASK_STATES, "TaskState"),
            layer=request.layer,
        )
        page = _fitting(await self._views.tasks(tasks[:size]))
        more = str(tasks[len(page) - 1].number) if len(page) < len(tasks) else ""
        return job_service_pb2.ListTasksResponse(tasks=page, next_page_token=more)

    @told
    async def ListAttempts(
        self, request: job_service_pb2.ListAttemptsRequest, context: Context
    ) -> job_service_pb2.ListAttemptsResponse:
        """All of them."""
        attempts = await self._queue.attempts(*task_numbers(request.task))
        return job_service_pb2.ListAttemptsResponse(attempts=await self._views.attempts(attempts))

    @told
    async def ListFrames(
        self, request: job_service_pb2.ListFramesRequest, context: Context
    ) -> job_service_pb2.ListFramesResponse:
        """A page of them; its token is the last frame and layer."""
        size = _page_size(request.page_size, _PAGE)
        after = None
        if request.page_token:
            number, _, layer = request.page_token.partition(" ")
            after = (layer, _token(number))
        frames = await self._queue.frames(job_number(request.job), size + 1, after)
        page = _fitting([frame_message(frame) for frame in frames[:size]])
        more = f"{page[-1].frame} {page[-1].layer}" if len(page) < len(frames) else ""
        return job_service_pb2.ListFramesResponse(frames=page, next_page_token=more)

    @told
    async def ExplainWait(
        self, request: job_service_pb2.ExplainWaitRequest, context: Context
    ) -> job_service_pb2.ExplainWaitResponse:
        """In words."""
        if is_task_name(request.name):
            facts = await self._queue.wait_facts(*task_numbers(request.name))
        else:
            facts = await self._queue.wait_facts(job_number(request.name))
        return job_service_pb2.ExplainWaitResponse(reasons=explain_wait(facts, self._farm.lanes()))

    # --- steering ---

    @told
    async def PauseJob(
        self, request: job_service_pb2.PauseJobRequest, context: Context
    ) -> job_service_pb2.PauseJobResponse:
        """Start nothing new."""
        await self._own(request.name, context)
        job = await self._queue.pause(job_number(request.name))
        return job_service_pb2.PauseJobResponse(job=job_message(job))

    @told
    async def ResumeJob(
        self, request: job_service_pb2.ResumeJobRequest, context: Context
    ) -> job_service_pb2.ResumeJobResponse:
        """Start tasks again."""
        await self._own(request.name, context)
        job = await self._queue.resume(job_number(request.name))
        return job_service_pb2.ResumeJobResponse(job=job_message(job))

    @told
    async def CancelJob(
        self, request: job_service_pb2.CancelJobRequest, context: Context
    ) -> job_service_pb2.CancelJobResponse:
        """Have it end."""
        await self._own(request.name, context)
        job = await self._queue.cancel(job_number(request.name))
        return job_service_pb2.CancelJobResponse(job=job_message(job))

    @told
    async def RetryTasks(
        self, request: job_service_pb2.RetryTasksRequest, context: Context
    ) -> job_service_pb2.RetryTasksResponse:
        """Another round."""
        job = await self._own(request.job, context)
        selection = await self._submissions.select(request.selection, job.number)
        job, changed = await self._submissions.retry(job.number, selection, caller(context))
        return job_service_pb2.RetryTasksResponse(job=job_message(job), changed=changed)

    @told
    async def SkipTasks(
        self, request: job_service_pb2.SkipTasksRequest, context: Context
    ) -> job_service_pb2.SkipTasksResponse:
        """Give up on them."""
        job = await self._own(request.job, context)
        selection = await self._submissions.select(request.selection, job.number)
        if selection == Selection():
            raise _invalid("selection", "has to choose something; to give up on all of a job, cancel it")
        job, changed = await self._queue.skip(job.number, selection)
        return job_service_pb2.SkipTasksResponse(job=job_message(job), changed=changed)

    @told
    async def PruneJobs(
        self, request: job_service_pb2.PruneJobsRequest, context: Context
    ) -> job_service_pb2.PruneJobsResponse:
        """Forget them, then remove their files: a job that nobody knows any more is not opened again meanwhile."""
        numbers = await self._prunable(request, context)
        freed = 0
        if not request.dry_run and numbers:
            pruning = asyncio.create_task(self._farm.prune(numbers))
            self._pruning.add(pruning)
            pruning.add_done_callback(self._pruning.discard)
            # Nobody else would remove the files, so it goes on if the client gives up.
            freed = await asyncio.shield(pruning)
        return job_service_pb2.PruneJobsResponse(jobs=[job_name(number) for number in numbers], freed_bytes=freed)

    # --- streams ---

    @told
    async def WatchJob(self, request: job_service_pb2.WatchJobRequest, context: Context) -> None:
        """What happens to it, until it has ended."""
        number = job_number(request.name)
        if request.after > _LATEST_EVENT:
            raise _invalid("after", f"{request.after}: not an event of this server")
        await self._queue.job(number)
        with self._feeds.watching(number) as feed:
            await _while_read(
                JobWatch(number, self._views, context).run(feed, request.after, only_new=request.only_new)
            )

    @told
    async def ReadLog(self, request: job_service_pb2.ReadLogRequest, context: Context) -> None:
        """What an attempt wrote."""
        await _while_read(read_log(request, self._views, context))

    @told
    async def GetFrame(self, request: job_service_pb2.GetFrameRequest, context: Context) -> None:
        """An image file in pieces."""
        await _while_read(send_frame(request, self._views, context))

    # --- the farm ---

    @told
    async def SetLimit(
        self, request: job_service_pb2.SetLimitRequest, context: Context
    ) -> job_service_pb2.SetLimitResponse:
        """Make or change one."""
        limit, violations = request.limit, []
        if not NAME.fullmatch(limit.name):
            violations.append(
                FieldViolation("limit.name", f"{limit.name[:80]!r}: does not match [A-Za-z0-9_.-]{{1,64}}")
            )
        if limit.most > _MOST_RUNNING:
            violations.append(FieldViolation("limit.most", f"{limit.most}: allowed are 0 to {_MOST_RUNNING}"))
        if limit.unit not in LIMIT_UNITS:
            violations.append(FieldViolation("limit.unit", f"{limit.unit}: allowed are TASK and HOST"))
        if violations:
            raise InvalidFieldsError(violations)
        made = await self._queue.set_limit(Limit(limit.name, limit.most, LIMIT_UNITS[limit.unit]))
        return job_service_pb2.SetLimitResponse(limit=limit_message(made))

    @told
    async def ListLimits(
        self, request: job_service_pb2.ListLimitsRequest, context: Context
    ) -> job_service_pb2.ListLimitsResponse:
        """All of them."""
        return job_service_pb2.ListLimitsResponse(limits=[limit_message(limit) for limit in await self._queue.limits()])

    @told
    async def ListWorkers(
        self, request: job_service_pb2.ListWorkersRequest, context: Context
    ) -> job_service_pb2.ListWorkersResponse:
        """Those that are there, and what they do."""
        tasks = {run.attempt.worker: task_name(run.attempt.job, run.attempt.task) for run in self._farm.running()}
        response = job_service_pb2.ListWorkersResponse()
        for lane in self._farm.lanes():
            blocked = await self._queue.blocked_jobs(lane)
            response.workers.add(
                name=lane.name,
                host=lane.host,
                task=tasks.get(lane.name, ""),
                blocked_jobs=[job_name(number) for number in blocked],
            )
        return response

    # --- what they share ---

    async def _own(self, name: str, context: Context) -> Job:
        """The job, if the caller may steer it. Raises NotYoursError."""
        job = await self._queue.job(job_number(name))
        check_owner(caller(context), job.user, name)
        return job

    async def _prunable(self, request: job_service_pb2.PruneJobsRequest, context: Context) -> list[int]:
        if len(request.names) > _MOST_PRUNED:
            raise _invalid("names", f"{len(request.names)} jobs: at most {_MOST_PRUNED} are allowed")
        if not request.names:
            age = request.older_than.seconds + request.older_than.nanos / 1e9
            if age < 0:
                raise _invalid("older_than", f"{age:g} s: has to be 0 or more")
            who = caller(context)
            return await self._queue.prunable(age, None if who.is_admin else who.user)
        jobs = [await self._own(name, context) for name in dict.fromkeys(request.names)]
        for job in jobs:
            if not job.state.ended:
                raise JobNotEndedError(f"{job_name(job.number)} is {job.state}; cancel it first")
        return [job.number for job in jobs]


async def _while_read(stream: Awaitable[None]) -> None:
    """Serve a stream until it is done, or nobody is there any more."""
    try:
        await stream
    except ClientGoneError:
        return


def _invalid(field: str, description: str) -> InvalidFieldsError:
    return InvalidFieldsError([FieldViolation(field, description)])


def _page_size(asked: int, usual: int) -> int:
    if asked > _LARGEST_PAGE:
        raise _invalid("page_size", f"{asked}: at most {_LARGEST_PAGE} are allowed")
    return asked or usual


def _token(text: str) -> int:
    """The number in a page token."""
    if not _NUMBER.fullmatch(text):
        raise _invalid("page_token", "not a token of this server")
    return int(text)


def _chosen(values: Sequence[int], known: Mapping[int, S], kind: str) -> list[S]:
    """States by their values in the protocol."""
    for value in values:
        if value not in known:
            raise _invalid("states", f"{value}: not a {kind} of this server")
    return [known[value] for value in values]


def _fitting(messages: Sequence[M]) -> Sequence[M]:
    """As many from the front as make a page, one at least if there is one."""
    size = 0
    for index, message in enumerate(messages):
        size += message.ByteSize()
        if size > _PAGE_BYTES and index:
            return messages[:index]
    return messages
