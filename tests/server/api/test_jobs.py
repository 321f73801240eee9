"""Jobs over a socket: accepted once, listed whole, steered by whom they belong to, and every refusal by its code."""

import asyncio
import contextlib
import re
import sqlite3
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from google.protobuf.duration_pb2 import Duration
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from footlight.v1 import job_pb2, job_service_pb2, render_pb2
from footlight_server.api.errors import DOMAIN, TABLE
from footlight_server.farm.model import ExitClass, Lane
from footlight_server.farm.tokens import Scope
from footlight_server.sessions import errors
from footlight_server.settings import Quota
from tests.server.api.farm_service import LANE, FarmServer, as_user, farm_server

SERVICE = job_service_pb2
# A state that no version knows.
UNKNOWN: Any = 99


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[FarmServer]:
    async with farm_server(tmp_path) as running:
        yield running


async def refused(call: object, reason: str) -> grpc.aio.AioRpcError:
    """The error that the call ends in: of this reason, with the code that the table gives it."""
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await call  # type: ignore[misc]
    status = rpc_status.from_call(caught.value)
    assert status is not None, caught.value
    info = error_details_pb2.ErrorInfo()
    assert status.details[0].Unpack(info)
    assert (info.domain, info.reason) == (DOMAIN, reason)
    assert caught.value.code() == {name: code for code, name in TABLE.values()}[reason]
    return caught.value


def fields(error: grpc.aio.AioRpcError) -> list[str]:
    """That are at fault."""
    request = error_details_pb2.BadRequest()
    status = rpc_status.from_call(error)
    assert status is not None
    assert any(detail.Unpack(request) for detail in status.details)
    return [violation.field for violation in request.field_violations]


# --- submitting ---


async def test_a_job_is_accepted_with_its_defaults_and_its_tasks(server: FarmServer) -> None:
    request = SERVICE.CreateJobRequest(spec=job_pb2.JobSpec(layers=[server.layer("1001-1010x2", chunk=2)]))
    response = await server.jobs.CreateJob(request, timeout=10)
    job = response.job
    assert job.name == "jobs/1"
    assert (job.spec.title, job.spec.priority, job.state) == ("stage.usda", 50, job_pb2.JOB_STATE_QUEUED)
    assert (job.tasks.ready, job.frames_total) == (3, 5)
    assert job.user
    assert list(response.notes) == ["tasks: 3", "frames: 1001-1010x2 (5)", "the server keeps the images"]
    tasks = await server.tasks(job.name)
    assert [list(task.frames) for task in tasks] == [[1001, 1003], [1005, 1007], [1009]]
    assert [task.name for task in tasks] == [f"jobs/1/tasks/{number}" for number in (1, 2, 3)]
    assert await server.get(job.name) == job


async def test_a_request_that_is_sent_again_makes_no_second_job(server: FarmServer) -> None:
    first, again = await asyncio.gather(server.submit(request_id="a"), server.submit(request_id="a"))
    assert first.name == again.name
    assert (await server.submit(request_id="b")).name != first.name
    other = SERVICE.CreateJobRequest(spec=job_pb2.JobSpec(title="x", layers=[server.layer()]), request_id="a")
    await refused(server.jobs.CreateJob(other, timeout=10), "REQUEST_ID_REUSED")
    async with as_user(server, "bob") as bob:
        response = await bob.CreateJob(other, timeout=10)
        assert response.job.user == "bob"
        assert response.job.name != first.name


async def test_a_dry_run_checks_everything_and_makes_nothing(server: FarmServer, tmp_path: Path) -> None:
    layer = server.layer("1-100:4", split=2, output=f"{tmp_path}/b.####.exr")
    request = SERVICE.CreateJobRequest(spec=job_pb2.JobSpec(layers=[layer]), dry_run=True, request_id="a")
    response = await server.jobs.CreateJob(request, timeout=10)
    assert response.job.name == ""
    assert (response.job.tasks.ready, response.job.tasks.blocked, response.job.frames_total) == (200, 100, 100)
    assert response.notes[0] == "tasks: 300, 100 of them merge sample ranges"
    assert "is interleaved" in response.notes[2]
    assert response.notes[3] == f"first output: {tmp_path}/b.0001.exr"
    assert not (await server.jobs.ListJobs(SERVICE.ListJobsRequest(), timeout=10)).jobs
    request.spec.layers[0].render.stage_path = "/not/there.usd"
    await refused(server.jobs.CreateJob(request, timeout=10), "STAGE_NOT_FOUND")
    request.dry_run = False
    request.spec.layers[0].render.stage_path = str(server.stage)
    made = await server.jobs.CreateJob(request, timeout=10)
    assert (made.job.tasks, made.job.frames_total) == (response.job.tasks, 100)


async def test_what_a_dry_run_foretells_is_what_is_made(server: FarmServer) -> None:
    first = await server.submit()
    layers = [
        server.layer("1-3", name="a"),
        server.layer("1-3", name="b", depends=[job_pb2.LayerDependency(layer="a")]),
        server.layer("2-5", name="c", depends=[job_pb2.LayerDependency(layer="a", frame_by_frame=True)]),
    ]
    for depends in ([], [first.name]):
        spec = job_pb2.JobSpec(layers=layers, depends=depends, paused=True)
        told = await server.jobs.CreateJob(SERVICE.CreateJobRequest(spec=spec, dry_run=True), timeout=10)
        made = await server.jobs.CreateJob(SERVICE.CreateJobRequest(spec=spec), timeout=10)
        for job in (told.job, made.job):
            job.ClearField("name")
            job.ClearField("create_time")
        assert told == made


async def test_files_are_looked_at_before_a_job_is_accepted(tmp_path: Path) -> None:
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    (inside / "link").symlink_to(outside)
    async with farm_server(tmp_path, output_roots=(inside.resolve(),)) as server:
        await server.submit(server.layer(output=f"{inside}/a.####.exr"))
        for folder in (outside, inside / "link"):
            request = server.submit(server.layer(output=f"{folder}/a.####.exr"))
            await refused(request, "OUTSIDE_ROOTS")
        for path in ("not_there/a.####.exr", "not_there/<frame>/a.exr"):
            error = await refused(server.submit(server.layer(output=f"{inside}/{path}")), "INVALID_FIELD")
            assert fields(error) == ["spec.layers[0].output"]
        render = render_pb2.RenderSpec(stage_path="/not/there.usd")
        await refused(server.submit(server.layer(render=render)), "STAGE_NOT_FOUND")
        error = await refused(server.submit(server.layer(), depends=["jobs/99"]), "INVALID_FIELD")
        assert fields(error) == ["spec.depends[0]"]
        missing = f"{'0' * 64}/12"
        render = render_pb2.RenderSpec(stage_path="a.usd", bundle=missing)
        error = await refused(server.submit(server.layer(render=render)), "BLOBS_MISSING")
        status = rpc_status.from_call(error)
        assert status is not None
        precondition = error_details_pb2.PreconditionFailure()
        assert any(detail.Unpack(precondition) for detail in status.details)
        assert [violation.subject for violation in precondition.violations] == [missing]


async def test_more_faults_than_headers_can_carry_still_arrive_as_a_bad_request(server: FarmServer) -> None:
    layers = [server.layer("x" * 1000, name="ä" * 500, output="ß" * 500) for _ in range(64)]
    error = await refused(server.submit(*layers), "INVALID_FIELD")
    assert len(fields(error)) > 3
    name = "jobs/" + "ü" * 100_000
    await refused(server.get(name), "JOB_NOT_FOUND")


async def test_a_user_has_a_quota_and_a_repeated_request_does_not_count(tmp_path: Path) -> None:
    async with (
        farm_server(tmp_path, quota=Quota(jobs=2, tasks=9)) as server,
        as_user(server, "ann") as ann,
        as_user(server, "bob") as bob,
    ):

        def asked(request_id: str, frames: str = "1-4", **options: object) -> SERVICE.CreateJobRequest:
            spec = job_pb2.JobSpec(layers=[server.layer(frames)])
            return SERVICE.CreateJobRequest(spec=spec, request_id=request_id, **options)

        await refused(ann.CreateJob(asked("z", "1-10"), timeout=10), "QUOTA")
        await refused(ann.CreateJob(asked("z", "1-10", dry_run=True), timeout=10), "QUOTA")
        answers = await asyncio.gather(
            *(ann.CreateJob(asked(f"{n}"), timeout=10) for n in range(6)), return_exceptions=True
        )
        made = [answer for answer in answers if not isinstance(answer, BaseException)]
        assert len(made) == 2
        known = next(str(n) for n, answer in enumerate(answers) if not isinstance(answer, BaseException))
        await ann.CreateJob(asked(known), timeout=10)
        await refused(ann.CreateJob(asked("new"), timeout=10), "QUOTA")
        await bob.CreateJob(asked("0"), timeout=10)
        await server.work_off()
        await ann.CreateJob(asked("new"), timeout=10)


# --- listing ---


async def test_pages_hold_every_job_once_newest_first(server: FarmServer) -> None:
    names = [(await server.submit(show="a" if n % 2 else "b", tags=[f"t{n}"])).name for n in range(7)]
    request, found = SERVICE.ListJobsRequest(page_size=3), []
    while True:
        response = await server.jobs.ListJobs(request, timeout=10)
        assert len(response.jobs) <= 3
        found += [job.name for job in response.jobs]
        if not response.next_page_token:
            break
        request.page_token = response.next_page_token
    assert found == names[::-1]

    async def listed(**chosen: object) -> list[str]:
        response = await server.jobs.ListJobs(SERVICE.ListJobsRequest(**chosen), timeout=10)
        return [job.name for job in response.jobs]

    assert await listed(show="a") == names[1::2][::-1]
    assert await listed(tag="t3") == [names[3]]
    assert await listed(states=[job_pb2.JOB_STATE_SUCCEEDED]) == []
    assert len(await listed(states=[job_pb2.JOB_STATE_SUCCEEDED, job_pb2.JOB_STATE_QUEUED])) == 7
    assert await listed(user="nobody") == []


async def test_pages_hold_every_task_and_frame_once_even_if_they_are_large(server: FarmServer) -> None:
    """Ten thousand frames in a task are fifty kilobytes; a thousand such tasks are not sent in one message."""
    job = await server.submit(server.layer("1-900000", chunk=10_000, name="big"), server.layer("1-5", name="small"))
    request = SERVICE.ListTasksRequest(job=job.name, page_size=1000)
    response = await server.jobs.ListTasks(request, timeout=10)
    assert response.ByteSize() < 1 << 21
    assert response.next_page_token
    assert [task.name for task in await server.tasks(job.name)] == [f"{job.name}/tasks/{n}" for n in range(1, 96)]
    request = SERVICE.ListTasksRequest(job=job.name, layer="small", states=[job_pb2.TASK_STATE_READY])
    assert len((await server.jobs.ListTasks(request, timeout=10)).tasks) == 5


async def test_frames_are_listed_as_they_come(server: FarmServer) -> None:
    job = await server.submit(server.layer("-1-3", name="a"), server.layer("2-3", name="b"))
    await server.work_off(4)
    request, found = SERVICE.ListFramesRequest(job=job.name, page_size=2), []
    while True:
        response = await server.jobs.ListFrames(request, timeout=10)
        found += [(frame.layer, frame.frame, frame.attempt) for frame in response.frames]
        assert all(frame.size_bytes and len(frame.sha256) == 64 for frame in response.frames)
        if not response.next_page_token:
            break
        request.page_token = response.next_page_token
    assert found == [("a", n - 2, f"{job.name}/tasks/{n}/attempts/1") for n in range(1, 5)]


@pytest.mark.parametrize(
    ("method", "request_", "reason"),
    [
        ("GetJob", SERVICE.GetJobRequest(name="jobs/9"), "JOB_NOT_FOUND"),
        ("GetJob", SERVICE.GetJobRequest(name="jobs/09"), "JOB_NOT_FOUND"),
        ("GetJob", SERVICE.GetJobRequest(name="jobs/" + "9" * 30), "JOB_NOT_FOUND"),
        ("GetJob", SERVICE.GetJobRequest(name="jobs/1\n"), "JOB_NOT_FOUND"),
        ("GetJob", SERVICE.GetJobRequest(), "JOB_NOT_FOUND"),
        ("ListTasks", SERVICE.ListTasksRequest(job="jobs/9"), "JOB_NOT_FOUND"),
        ("ListTasks", SERVICE.ListTasksRequest(job="jobs/1", page_size=1001), "INVALID_FIELD"),
        ("ListTasks", SERVICE.ListTasksRequest(job="jobs/1", page_token="x"), "INVALID_FIELD"),
        ("ListTasks", SERVICE.ListTasksRequest(job="jobs/1", states=[UNKNOWN]), "INVALID_FIELD"),
        ("ListJobs", SERVICE.ListJobsRequest(states=[UNKNOWN]), "INVALID_FIELD"),
        ("ListFrames", SERVICE.ListFramesRequest(job="jobs/1", page_token="x y"), "INVALID_FIELD"),
        ("ListAttempts", SERVICE.ListAttemptsRequest(task="jobs/1/tasks/99"), "TASK_NOT_FOUND"),
        ("ListAttempts", SERVICE.ListAttemptsRequest(task="jobs/1"), "TASK_NOT_FOUND"),
        ("ExplainWait", SERVICE.ExplainWaitRequest(name="jobs/1/tasks/99"), "TASK_NOT_FOUND"),
        ("ExplainWait", SERVICE.ExplainWaitRequest(name="jobs/9"), "JOB_NOT_FOUND"),
        ("CancelJob", SERVICE.CancelJobRequest(name="jobs/9"), "JOB_NOT_FOUND"),
        ("SkipTasks", SERVICE.SkipTasksRequest(job="jobs/1"), "INVALID_FIELD"),
        (
            "SkipTasks",
            SERVICE.SkipTasksRequest(job="jobs/1", selection=SERVICE.TaskSelection(frames=" ")),
            "INVALID_FIELD",
        ),
        (
            "SkipTasks",
            SERVICE.SkipTasksRequest(job="jobs/1", selection=SERVICE.TaskSelection(tasks=["jobs/2/tasks/1"])),
            "TASK_NOT_FOUND",
        ),
        (
            "SkipTasks",
            SERVICE.SkipTasksRequest(job="jobs/1", selection=SERVICE.TaskSelection(tasks=["jobs/1/tasks/99"])),
            "TASK_NOT_FOUND",
        ),
        (
            "SkipTasks",
            SERVICE.SkipTasksRequest(job="jobs/1", selection=SERVICE.TaskSelection(layer="none")),
            "TASK_NOT_FOUND",
        ),
        (
            "RetryTasks",
            SERVICE.RetryTasksRequest(job="jobs/1", selection=SERVICE.TaskSelection(frames="1-x")),
            "INVALID_FIELD",
        ),
        ("PruneJobs", SERVICE.PruneJobsRequest(names=["jobs/1"]), "JOB_NOT_ENDED"),
        ("PruneJobs", SERVICE.PruneJobsRequest(names=["jobs/9"]), "JOB_NOT_FOUND"),
        ("PruneJobs", SERVICE.PruneJobsRequest(older_than=Duration(seconds=-5)), "INVALID_FIELD"),
        ("SetLimit", SERVICE.SetLimitRequest(limit=job_pb2.Limit(name="a b", most=1, unit=1)), "INVALID_FIELD"),
        ("SetLimit", SERVICE.SetLimitRequest(limit=job_pb2.Limit(name="a", most=1)), "INVALID_FIELD"),
    ],
)
async def test_what_is_not_there_or_not_allowed_has_its_code(
    server: FarmServer, method: str, request_: object, reason: str
) -> None:
    await server.submit()
    await refused(getattr(server.jobs, method)(request_, timeout=10), reason)


def test_every_error_has_its_place_in_the_table_and_the_manual() -> None:
    kinds = {kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.ServiceError)}
    assert set(TABLE) == kinds - {errors.ServiceError}
    proto = Path(__file__).parents[3] / "proto" / "footlight" / "v1"
    manual = "\n".join(path.read_text() for path in proto.glob("*_service.proto"))
    told = set(re.findall(r"^//   ([A-Z_]+) +([A-Z_]+)  ", manual, re.MULTILINE))
    assert told == {(code.name, reason) for code, reason in TABLE.values()} | {("INTERNAL", "INTERNAL")}


async def test_a_database_that_is_locked_is_said_and_nothing_has_happened(server: FarmServer) -> None:
    job = await server.submit()
    with contextlib.closing(sqlite3.connect(server.data / "queue.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        pause = SERVICE.PauseJobRequest(name=job.name)
        await refused(server.jobs.PauseJob(pause, timeout=30), "STORAGE")
        assert await server.get(job.name) == job
        other.execute("ROLLBACK")
    assert (await server.jobs.PauseJob(pause, timeout=10)).job.paused


async def test_ten_thousand_tasks_are_submitted_in_one_call(server: FarmServer) -> None:
    """The bench measures the time; here all of it counts, checks and cutting included, on a busy machine."""
    before = time.monotonic()
    job = await server.submit(server.layer("1-10000"))
    assert time.monotonic() - before < 5.0
    assert job.tasks.ready == 10_000
    assert len(await server.tasks(job.name)) == 10_000


# --- steering ---


async def test_a_paused_job_starts_nothing_new(server: FarmServer) -> None:
    job = await server.submit()
    claim = await server.claim()
    assert claim is not None
    response = await server.jobs.PauseJob(SERVICE.PauseJobRequest(name=job.name), timeout=10)
    assert response.job.paused
    assert await server.claim() is None
    await server.finish(claim.attempt)
    why = await server.jobs.ExplainWait(SERVICE.ExplainWaitRequest(name=job.name), timeout=10)
    assert why.reasons[0] == f"{job.name} is paused"
    response = await server.jobs.ResumeJob(SERVICE.ResumeJobRequest(name=job.name), timeout=10)
    assert not response.job.paused
    assert await server.work_off() == 3
    await refused(server.jobs.PauseJob(SERVICE.PauseJobRequest(name=job.name), timeout=10), "JOB_ENDED")
    await refused(server.jobs.ResumeJob(SERVICE.ResumeJobRequest(name=job.name), timeout=10), "JOB_ENDED")


async def test_cancel_skip_and_retry(server: FarmServer) -> None:
    job = await server.submit(server.layer("1-6"))
    await server.work_off(1)
    skip = SERVICE.SkipTasksRequest(job=job.name, selection=SERVICE.TaskSelection(frames="1-3"))
    response = await server.jobs.SkipTasks(skip, timeout=10)
    assert (response.changed, response.job.tasks.skipped, response.job.tasks.succeeded) == (2, 2, 1)
    cancelled = await server.jobs.CancelJob(SERVICE.CancelJobRequest(name=job.name), timeout=10)
    assert cancelled.job.state == job_pb2.JOB_STATE_CANCELLED
    assert cancelled.job.HasField("end_time")
    again = await server.jobs.CancelJob(SERVICE.CancelJobRequest(name=job.name), timeout=10)
    assert again == cancelled
    one = SERVICE.TaskSelection(tasks=[f"{job.name}/tasks/2"])
    response = await server.jobs.RetryTasks(SERVICE.RetryTasksRequest(job=job.name, selection=one), timeout=10)
    assert response.changed == 1
    assert not response.job.HasField("end_time")
    response = await server.jobs.RetryTasks(SERVICE.RetryTasksRequest(job=job.name), timeout=10)
    assert response.changed == 4
    assert await server.work_off() == 5
    assert (await server.get(job.name)).state == job_pb2.JOB_STATE_SUCCEEDED


async def test_attempts_say_how_each_try_ended(server: FarmServer) -> None:
    await server.submit(server.layer("1"), retries=1)
    for lane in ("one/1", "two/1"):
        claim = await server.claim(Lane(lane, lane[:3]))
        assert claim is not None
        log = server.farm.log_path(1, 1, claim.attempt.number)
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text("x" * (10 + claim.attempt.number))
        await server.finish(claim.attempt, ExitClass.OUT_OF_MEMORY, "it held 9 GB")
    attempts = (await server.jobs.ListAttempts(SERVICE.ListAttemptsRequest(task="jobs/1/tasks/1"), timeout=10)).attempts
    assert [(a.name, a.worker, a.exit_class, a.log_bytes) for a in attempts] == [
        (f"jobs/1/tasks/1/attempts/{n}", worker, job_pb2.EXIT_CLASS_OUT_OF_MEMORY, 10 + n)
        for n, worker in ((1, "one/1"), (2, "two/1"))
    ]
    (task,) = await server.tasks("jobs/1")
    assert (task.state, task.failures, task.attempts) == (job_pb2.TASK_STATE_FAILED, 2, 2)
    assert task.last_attempt == attempts[1]
    assert (await server.get("jobs/1")).state == job_pb2.JOB_STATE_FAILED


async def test_only_its_user_and_admins_steer_a_job_and_everybody_looks(server: FarmServer) -> None:
    async with (
        as_user(server, "ann") as ann,
        as_user(server, "bob") as bob,
        as_user(server, "eve", Scope.READ) as eve,
        as_user(server, "root", Scope.ADMIN) as root,
    ):
        spec = job_pb2.JobSpec(layers=[server.layer()])
        job = (await ann.CreateJob(SERVICE.CreateJobRequest(spec=spec), timeout=10)).job
        assert job.user == "ann"
        calls = {
            "PauseJob": SERVICE.PauseJobRequest(name=job.name),
            "ResumeJob": SERVICE.ResumeJobRequest(name=job.name),
            "RetryTasks": SERVICE.RetryTasksRequest(job=job.name),
            "SkipTasks": SERVICE.SkipTasksRequest(job=job.name, selection=SERVICE.TaskSelection(frames="1")),
            "CancelJob": SERVICE.CancelJobRequest(name=job.name),
            "PruneJobs": SERVICE.PruneJobsRequest(names=[job.name]),
        }
        for method, request in calls.items():
            error = await refused(getattr(bob, method)(request, timeout=10), "NOT_YOURS")
            assert "ann" in error.details()
            await refused(getattr(eve, method)(request, timeout=10), "SCOPE_REQUIRED")
        assert await server.get(job.name) == job
        for stub in (bob, eve):
            assert (await stub.GetJob(SERVICE.GetJobRequest(name=job.name), timeout=10)).job == job
        for number, (method, request) in enumerate(calls.items()):
            await getattr(root if number % 2 else ann, method)(request, timeout=10)


async def test_prune_forgets_jobs_and_their_files_but_not_where_they_were_asked_to_put_images(
    server: FarmServer, tmp_path: Path
) -> None:
    kept = tmp_path / "kept.exr"
    kept.write_text("an image that a job wrote where it was told to")
    async with as_user(server, "bob") as bob:
        mine = await server.submit()
        request = SERVICE.CreateJobRequest(spec=job_pb2.JobSpec(layers=[server.layer()]))
        his = (await bob.CreateJob(request, timeout=10)).job
        open_ = await server.submit(paused=True)
        await server.work_off()
        folder = server.farm.places.job(1)
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())

        async def prune(stub: object, **chosen: object) -> SERVICE.PruneJobsResponse:
            answer: SERVICE.PruneJobsResponse = await stub.PruneJobs(  # type: ignore[attr-defined]
                SERVICE.PruneJobsRequest(**chosen), timeout=10
            )
            return answer

        assert (await prune(server.jobs, older_than=Duration(seconds=3600))).jobs == []
        assert list((await prune(bob, dry_run=True)).jobs) == [his.name]
        told = await prune(server.jobs, dry_run=True)
        assert sorted(told.jobs) == [mine.name, his.name]
        assert folder.exists()
        pruned = await prune(server.jobs, names=[mine.name])
        assert list(pruned.jobs) == [mine.name]
        assert pruned.freed_bytes == size > 0
        assert not folder.exists()
        assert kept.exists()
        await refused(server.get(mine.name), "JOB_NOT_FOUND")
        assert list((await prune(server.jobs)).jobs) == [his.name]
        assert (await server.get(open_.name)).paused


# --- the farm ---


async def test_limits_are_made_changed_and_counted(server: FarmServer) -> None:
    error = await refused(server.submit(server.layer(limits=["licences"])), "INVALID_FIELD")
    assert fields(error) == ["spec.layers[0].limits[0]"]
    limit = job_pb2.Limit(name="licences", most=1, unit=job_pb2.LIMIT_UNIT_TASK)
    await server.jobs.SetLimit(SERVICE.SetLimitRequest(limit=limit), timeout=10)
    await server.submit(server.layer(limits=["licences"]))
    assert await server.claim() is not None
    other = Lane("other/1", "other")
    assert await server.queue.claim(other, [LANE, other]) is None
    (listed,) = (await server.jobs.ListLimits(SERVICE.ListLimitsRequest(), timeout=10)).limits
    assert (listed.name, listed.most, listed.running) == ("licences", 1, 1)
    why = await server.jobs.ExplainWait(SERVICE.ExplainWaitRequest(name="jobs/1/tasks/2"), timeout=10)
    assert why.reasons[0] == "limit licences: 1 of 1 tasks run"
    limit.most = 2
    await server.jobs.SetLimit(SERVICE.SetLimitRequest(limit=limit), timeout=10)
    assert await server.queue.claim(other, [LANE, other]) is not None


async def test_a_limit_is_the_admins(server: FarmServer) -> None:
    limit = job_pb2.Limit(name="licences", most=1, unit=job_pb2.LIMIT_UNIT_TASK)
    async with as_user(server, "ann") as ann:
        await refused(ann.SetLimit(SERVICE.SetLimitRequest(limit=limit), timeout=10), "SCOPE_REQUIRED")


async def test_workers_are_the_lanes_with_the_jobs_that_avoid_them(tmp_path: Path) -> None:
    async with farm_server(tmp_path, lanes=2) as server:
        workers = (await server.jobs.ListWorkers(SERVICE.ListWorkersRequest(), timeout=10)).workers
        lanes = server.farm.lanes()
        assert [(w.name, w.host, w.task) for w in workers] == [(lane.name, lane.host, "") for lane in lanes]
