"""The farm queue of a server: submit jobs, find them again, limits, workers. Once with threads, once with asyncio."""

import uuid
from collections.abc import Iterable

import grpc

from footlight import job_calls as calls
from footlight.errors import rpc_errors
from footlight.jobs import AsyncJob, Job
from footlight.names import job_name
from footlight.v1 import job_pb2, job_service_pb2, job_service_pb2_grpc

# [s] For a submission, which may hold many tasks, and for pruning, which deletes files.
LONG_TIMEOUT = 60.0


class Farm:
    """What `Client.farm` is. Every method raises FootlightError, ServerUnavailableError if no server answers."""

    def __init__(self, channel: grpc.Channel, address: str, timeout: float) -> None:
        self._channel = channel
        self._address = address
        self._timeout = timeout
        self._stub = job_service_pb2_grpc.JobServiceStub(channel)

    def submit(self, spec: job_pb2.JobSpec, *, request_id: str = "") -> Job:
        """Put a job into the queue; `job_spec` makes the spec.

        A second submission with the same `request_id` and spec is the first one's job; by default each is a new one.
        Raises InvalidRequestError naming each field at fault, StageNotFoundError, OutsideRootsError, QuotaError.
        """
        return self.job(self.create(spec, request_id=request_id).job.name)

    def create(
        self, spec: job_pb2.JobSpec, *, request_id: str = "", dry_run: bool = False
    ) -> job_service_pb2.CreateJobResponse:
        """As `submit`, with the server's notes; with `dry_run` everything is checked and nothing is made."""
        with rpc_errors(self._address):
            request = _create(spec, request_id, dry_run=dry_run)
            response: job_service_pb2.CreateJobResponse = self._stub.CreateJob(request, timeout=LONG_TIMEOUT)
        return response

    def job(self, name: str | int) -> Job:
        """The job `jobs/12`, `12` or 12, submitted here or elsewhere. Raises ValueError for what is no name."""
        return Job(job_name(name), self._channel, self._address, self._timeout)

    def jobs(
        self,
        count: int = 50,
        *,
        states: Iterable[str] = (),
        user: str = "",
        show: str = "",
        shot: str = "",
        tag: str = "",
    ) -> list[job_pb2.Job]:
        """At most `count` jobs, newest first; `states` are words as `running`. Raises ValueError for an unknown one."""
        request = _list(count, states, user=user, show=show, shot=shot, tag=tag)
        found: list[job_pb2.Job] = []
        with rpc_errors(self._address):
            for page in calls.pages(self._stub.ListJobs, request, self._timeout):
                found.extend(page.jobs)
                if len(found) >= count:
                    break
        return found[:count]

    def prune(
        self, names: Iterable[str] = (), *, older_than: float = 0.0, dry_run: bool = False
    ) -> job_service_pb2.PruneJobsResponse:
        """Forget these jobs, or all that have ended longer than `older_than` [s] ago. Raises JobNotEndedError."""
        with rpc_errors(self._address):
            request = _prune(names, older_than, dry_run=dry_run)
            response: job_service_pb2.PruneJobsResponse = self._stub.PruneJobs(request, timeout=LONG_TIMEOUT)
        return response

    def limits(self) -> list[job_pb2.Limit]:
        """All named limits."""
        with rpc_errors(self._address):
            return list(self._stub.ListLimits(job_service_pb2.ListLimitsRequest(), timeout=self._timeout).limits)

    def set_limit(self, name: str, most: int, *, hosts: bool = False) -> job_pb2.Limit:
        """Make or change a limit: at most so many running tasks, or hosts that run any."""
        with rpc_errors(self._address):
            limit: job_pb2.Limit = self._stub.SetLimit(_limit(name, most, hosts=hosts), timeout=self._timeout).limit
        return limit

    def workers(self) -> list[job_service_pb2.Worker]:
        """The places where tasks can run, as they are now."""
        with rpc_errors(self._address):
            return list(self._stub.ListWorkers(job_service_pb2.ListWorkersRequest(), timeout=self._timeout).workers)


class AsyncFarm:
    """`Farm` for asyncio: the same methods, awaited."""

    def __init__(self, channel: grpc.aio.Channel, address: str, timeout: float) -> None:
        self._channel = channel
        self._address = address
        self._timeout = timeout
        self._stub = job_service_pb2_grpc.JobServiceStub(channel)

    async def submit(self, spec: job_pb2.JobSpec, *, request_id: str = "") -> AsyncJob:
        """As `Farm.submit`."""
        return self.job((await self.create(spec, request_id=request_id)).job.name)

    async def create(
        self, spec: job_pb2.JobSpec, *, request_id: str = "", dry_run: bool = False
    ) -> job_service_pb2.CreateJobResponse:
        """As `Farm.create`."""
        with rpc_errors(self._address):
            request = _create(spec, request_id, dry_run=dry_run)
            response: job_service_pb2.CreateJobResponse = await self._stub.CreateJob(request, timeout=LONG_TIMEOUT)
        return response

    def job(self, name: str | int) -> AsyncJob:
        """As `Farm.job`."""
        return AsyncJob(job_name(name), self._channel, self._address, self._timeout)

    async def jobs(
        self,
        count: int = 50,
        *,
        states: Iterable[str] = (),
        user: str = "",
        show: str = "",
        shot: str = "",
        tag: str = "",
    ) -> list[job_pb2.Job]:
        """As `Farm.jobs`."""
        request = _list(count, states, user=user, show=show, shot=shot, tag=tag)
        found: list[job_pb2.Job] = []
        with rpc_errors(self._address):
            async for page in calls.pages_async(self._stub.ListJobs, request, self._timeout):
                found.extend(page.jobs)
                if len(found) >= count:
                    break
        return found[:count]

    async def prune(
        self, names: Iterable[str] = (), *, older_than: float = 0.0, dry_run: bool = False
    ) -> job_service_pb2.PruneJobsResponse:
        """As `Farm.prune`."""
        with rpc_errors(self._address):
            request = _prune(names, older_than, dry_run=dry_run)
            response: job_service_pb2.PruneJobsResponse = await self._stub.PruneJobs(request, timeout=LONG_TIMEOUT)
        return response

    async def limits(self) -> list[job_pb2.Limit]:
        """As `Farm.limits`."""
        with rpc_errors(self._address):
            answer = await self._stub.ListLimits(job_service_pb2.ListLimitsRequest(), timeout=self._timeout)
            return list(answer.limits)

    async def set_limit(self, name: str, most: int, *, hosts: bool = False) -> job_pb2.Limit:
        """As `Farm.set_limit`."""
        with rpc_errors(self._address):
            answer = await self._stub.SetLimit(_limit(name, most, hosts=hosts), timeout=self._timeout)
            limit: job_pb2.Limit = answer.limit
        return limit

    async def workers(self) -> list[job_service_pb2.Worker]:
        """As `Farm.workers`."""
        with rpc_errors(self._address):
            answer = await self._stub.ListWorkers(job_service_pb2.ListWorkersRequest(), timeout=self._timeout)
            return list(answer.workers)


def _create(spec: job_pb2.JobSpec, request_id: str, *, dry_run: bool) -> job_service_pb2.CreateJobRequest:
    return job_service_pb2.CreateJobRequest(spec=spec, request_id=request_id or str(uuid.uuid4()), dry_run=dry_run)


def _list(count: int, states: Iterable[str], **equals: str) -> job_service_pb2.ListJobsRequest:
    return job_service_pb2.ListJobsRequest(
        page_size=min(max(count, 1), calls.PAGE), states=[calls.job_state(word) for word in states], **equals
    )


def _prune(names: Iterable[str], older_than: float, *, dry_run: bool) -> job_service_pb2.PruneJobsRequest:
    request = job_service_pb2.PruneJobsRequest(names=names, dry_run=dry_run)
    request.older_than.FromNanoseconds(round(older_than * 1e9))
    return request


def _limit(name: str, most: int, *, hosts: bool) -> job_service_pb2.SetLimitRequest:
    unit = job_pb2.LIMIT_UNIT_HOST if hosts else job_pb2.LIMIT_UNIT_TASK
    return job_service_pb2.SetLimitRequest(limit=job_pb2.Limit(name=name, most=most, unit=unit))
