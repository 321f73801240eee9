"""From a request to a job in the queue: everything is checked first, the files too, and a dry run stops there."""

import asyncio
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from footlight.v1 import job_pb2, job_service_pb2
from footlight_server.api.auth import Caller
from footlight_server.api.job_messages import job_message
from footlight_server.api.job_spec import CheckedJob, complete_job
from footlight_server.api.names import job_number
from footlight_server.api.selection import parse_selection
from footlight_server.api.spec import check_stage
from footlight_server.api.streams import patiently
from footlight_server.farm.frames import explain_frames
from footlight_server.farm.model import Job, JobPlan, JobState, Selection, TaskCounts, TaskKind
from footlight_server.farm.outputs import is_below, parse_output
from footlight_server.farm.plan import OWN_TIME, Submission, plan_job
from footlight_server.farm.queue import Queue
from footlight_server.farm.quota import check_quota
from footlight_server.sessions.errors import (
    FieldViolation,
    InvalidFieldsError,
    JobNotFoundError,
    OutsideRootsError,
)
from footlight_server.settings import Settings

LONGEST_REQUEST_ID = 128
# [s] To check and cut the largest job that is allowed.
_PATIENCE = 60.0


class Bundles(Protocol):
    """Uploaded stages."""

    async def keep(self, name: str, stage_path: str = "", where: str = "spec") -> None:
        """The bundle is whole and holds the stage, and stays for a while; or raises what is wrong."""
        ...


@dataclass(frozen=True, slots=True)
class Submitted:
    """A job in the queue, or after a dry run one without a name, and what it comes to for people."""

    job: job_pb2.Job
    notes: list[str]


class Submissions:
    """Takes jobs in, one after the other where quotas are counted."""

    def __init__(self, queue: Queue, bundles: Bundles, settings: Settings) -> None:
        self._queue = queue
        self._bundles = bundles
        self._settings = settings
        # From counting what a user has to adding to it.
        self._counting = asyncio.Lock()
        # Jobs that are checked at the same time: each may take seconds of the processor, and hundreds of megabytes.
        self._checking = asyncio.Semaphore(2)

    async def submit(self, request: job_service_pb2.CreateJobRequest, caller: Caller) -> Submitted:
        """Check, cut, and unless it is a dry run put it into the queue."""
        if len(request.request_id) > LONGEST_REQUEST_ID or not request.request_id.isprintable():
            raise InvalidFieldsError(
                [FieldViolation("request_id", f"at most {LONGEST_REQUEST_ID} characters that can be printed")]
            )
        limits = {limit.name for limit in await self._queue.limits()}
        allowed = self._settings.allowed_environment
        async with self._checking:
            checked = await patiently(asyncio.to_thread(complete_job, request.spec, allowed, limits), _PATIENCE)
        await self._check_depends(checked.spec)
        async with self._checking:
            await self._check_files(checked.spec)
        submission = Submission(checked.spec, checked.frames, caller.user, request.request_id)
        async with self._checking:
            plan = await patiently(asyncio.to_thread(plan_job, submission), _PATIENCE)
        notes = list(_notes(checked, plan))
        async with self._counting:
            if request.dry_run:
                await self._check_quota(plan)
                return Submitted(job_message(_imagined(plan, checked)), notes)
            if not (request.request_id and await self._queue.job_of_request(caller.user, request.request_id)):
                await self._check_quota(plan)
            job = await self._queue.create_job(plan)
        return Submitted(job_message(job), notes)

    async def select(self, asked: job_service_pb2.TaskSelection, job: int) -> Selection:
        """As `parse_selection`, which may take a second."""
        async with self._checking:
            return await patiently(asyncio.to_thread(parse_selection, asked, job), _PATIENCE)

    async def retry(self, number: int, selection: Selection, caller: Caller) -> tuple[Job, int]:
        """As Queue.retry, but a job that is opened again counts as one more. Raises QuotaError, never for an admin."""
        async with self._counting:
            if not caller.is_admin:
                job = await self._queue.job(number)
                usage = await self._queue.usage(job.user)
                more = job.counts.failed + job.counts.skipped + job.counts.cancelled
                if selection.tasks:
                    more = min(more, len(selection.tasks))
                others = usage.jobs_open - (not job.state.ended)
                check_quota(self._settings.quota, job.user, others, usage.tasks_open, more)
            return await self._queue.retry(number, selection)

    async def _check_quota(self, plan: JobPlan) -> None:
        usage = await self._queue.usage(plan.user)
        check_quota(self._settings.quota, plan.user, usage.jobs_open, usage.tasks_open, len(plan.tasks))

    async def _check_depends(self, spec: job_pb2.JobSpec) -> None:
        violations = []
        for index, name in enumerate(spec.depends):
            try:
                await self._queue.job(job_number(name))
            except JobNotFoundError as error:
                violations.append(FieldViolation(f"spec.depends[{index}]", str(error)))
        if violations:
            raise InvalidFieldsError(violations)

    async def _check_files(self, spec: job_pb2.JobSpec) -> None:
        """Stages are there, and images go where they may."""
        seen: set[tuple[str, str]] = set()
        for index, layer in enumerate(spec.layers):
            where = f"spec.layers[{index}].render"
            stage = (layer.render.bundle, layer.render.stage_path)
            if stage in seen:
                continue
            seen.add(stage)
            if layer.render.bundle:
                await self._bundles.keep(layer.render.bundle, layer.render.stage_path, where)
            else:
                roots = self._settings.roots
                await patiently(asyncio.to_thread(check_stage, layer.render.stage_path, roots, where))
        await patiently(asyncio.to_thread(self._check_outputs, spec))

    def _check_outputs(self, spec: job_pb2.JobSpec) -> None:
        """Blocks."""
        roots = self._settings.output_roots
        violations = []
        for index, layer in enumerate(spec.layers):
            if not layer.output:
                continue
            pattern = parse_output(layer.output)
            if is_below(pattern.path(0), (self._settings.data.resolve(),)):
                raise OutsideRootsError(f"{layer.output}: that folder is the server's own")
            if not is_below(pattern.path(0), roots):
                listed = ", ".join(str(root) for root in roots)
                raise OutsideRootsError(f"{layer.output}: not below a directory images may go to ({listed})")
            if not pattern.base.is_dir():
                violations.append(
                    FieldViolation(f"spec.layers[{index}].output", f"{pattern.base}: no such directory on the server")
                )
        if violations:
            raise InvalidFieldsError(violations)


def _notes(checked: CheckedJob, plan: JobPlan) -> Iterator[str]:
    merges = sum(task.kind is TaskKind.MERGE for task in plan.tasks)
    yield f"tasks: {len(plan.tasks)}" + (f", {merges} of them merge sample ranges" if merges else "")
    for layer in checked.spec.layers:
        prefix = f"{layer.name}: " if len(checked.spec.layers) > 1 else ""
        frames = checked.frames[layer.name]
        yield from (prefix + note for note in explain_frames(layer.frames, frames))
        if layer.output:
            yield f"{prefix}first output: {parse_output(layer.output).path((frames or OWN_TIME)[0])}"
        else:
            yield f"{prefix}the server keeps the images"


def _imagined(plan: JobPlan, checked: CheckedJob) -> Job:
    """The job as it would be."""
    waiting = {layer.name for layer in plan.layers if layer.depends or plan.depends}
    blocked = sum(bool(task.needs) or task.layer in waiting for task in plan.tasks)
    return Job(
        number=0,
        title=plan.title,
        user=plan.user,
        spec=plan.spec,
        state=JobState.QUEUED,
        paused=plan.paused,
        priority=plan.priority,
        retries=plan.retries,
        show=plan.show,
        shot=plan.shot,
        tags=plan.tags,
        created=time.time(),
        started=None,
        ended=None,
        counts=TaskCounts(blocked=blocked, ready=len(plan.tasks) - blocked),
        frames_done=0,
        frames_total=sum(len(frames) or 1 for frames in checked.frames.values()),
        render_seconds=0.0,
    )
