"""What a token of scope `read` or `submit` cannot do to everybody else, nor beyond its quota."""

import tracemalloc
from pathlib import Path

import grpc
import pytest
from google.protobuf import duration_pb2

from footlight.v1 import job_pb2, job_service_pb2, render_pb2, render_service_pb2, render_service_pb2_grpc
from footlight_server.api.job_spec import complete_job
from footlight_server.farm.tokens import Scope
from footlight_server.settings import Quota
from tests.server.api.farm_service import as_user, farm_server
from tests.server.api.secured import reason_of

EXHAUSTED = (grpc.StatusCode.RESOURCE_EXHAUSTED, "QUOTA")


async def refusal(call: grpc.aio.Call) -> tuple[grpc.StatusCode, str]:
    """Code and reason of a call that has to fail."""
    return await call.code(), await reason_of(call)


async def test_a_job_that_is_opened_again_counts_as_a_new_one(tmp_path: Path) -> None:
    async with farm_server(tmp_path, quota=Quota(jobs=1, tasks=6)) as server, as_user(server, "ann") as ann:

        async def submit() -> str:
            spec = job_pb2.JobSpec(layers=[server.layer()])
            return str((await ann.CreateJob(job_service_pb2.CreateJobRequest(spec=spec), timeout=10)).job.name)

        def retry(name: str, *tasks: str) -> grpc.aio.UnaryUnaryCall:
            chosen = job_service_pb2.TaskSelection(tasks=tasks)
            return ann.RetryTasks(job_service_pb2.RetryTasksRequest(job=name, selection=chosen), timeout=10)

        first = await submit()
        await ann.CancelJob(job_service_pb2.CancelJobRequest(name=first), timeout=10)
        second = await submit()
        assert await refusal(retry(first)) == EXHAUSTED
        skip = job_service_pb2.TaskSelection(frames="1-3")
        await ann.SkipTasks(job_service_pb2.SkipTasksRequest(job=second, selection=skip), timeout=10)
        assert (await retry(second)).changed == 3
        await ann.CancelJob(job_service_pb2.CancelJobRequest(name=second), timeout=10)
        assert (await retry(first, f"{first}/tasks/1")).changed == 1
        async with as_user(server, "root", Scope.ADMIN) as admin:
            await admin.RetryTasks(job_service_pb2.RetryTasksRequest(job=second), timeout=10)


async def test_renders_are_counted_too(tmp_path: Path) -> None:
    stub = render_service_pb2_grpc.RenderServiceStub
    async with farm_server(tmp_path, quota=Quota(jobs=1)) as server, as_user(server, "ann", stub=stub) as ann:

        def create(spp: int, request_id: str = "") -> grpc.aio.UnaryUnaryCall:
            spec = render_pb2.RenderSpec(stage_path=str(server.stage), width=32, height=32, spp=spp)
            request = render_service_pb2.CreateRenderRequest(spec=spec, request_id=request_id)
            return ann.CreateRender(request, timeout=10)

        first = await create(1 << 20, "mine")
        assert (await create(1 << 20, "mine")).render.name == first.render.name
        assert await refusal(create(1)) == EXHAUSTED
        async with as_user(server, "bob", stub=stub) as bob:
            spec = render_pb2.RenderSpec(stage_path=str(server.stage), width=32, height=32, spp=1)
            await bob.CreateRender(render_service_pb2.CreateRenderRequest(spec=spec), timeout=10)


async def test_one_token_does_not_take_all_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("footlight_server.api.token_gate._MOST_CALLS", 3)
    async with farm_server(tmp_path) as server, as_user(server, "ann") as ann, as_user(server, "bob") as bob:
        name = (await server.submit()).name
        watch = job_service_pb2.WatchJobRequest(name=name)
        streams = [ann.WatchJob(watch, timeout=20) for _ in range(3)]
        for stream in streams:
            await stream.read()
        get = job_service_pb2.GetJobRequest(name=name)
        assert await refusal(ann.GetJob(get, timeout=10)) == EXHAUSTED
        assert (await bob.GetJob(get, timeout=10)).job.name == name
        streams[0].cancel()
        await streams[0].code()
        for _ in range(100):  # until the server has noticed that it is gone
            if await ann.GetJob(get, timeout=10).code() == grpc.StatusCode.OK:
                return
        raise AssertionError("it stays refused")


async def test_a_call_whose_request_never_comes_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The library would wait for it without end, and a thousand of them would shut everybody else out."""
    monkeypatch.setattr("footlight_server.api.token_gate._MESSAGE", 0.3)
    async with farm_server(tmp_path) as server:
        _, secret = await server.book.create("ann", Scope.READ, "", None)
        async with grpc.aio.insecure_channel(server.guarded) as channel:
            for method in ("GetJob", "WatchJob"):
                call = channel.stream_stream(f"/footlight.v1.JobService/{method}")(
                    metadata=(("authorization", f"Bearer {secret}"),), timeout=20
                )
                assert await call.code() == grpc.StatusCode.DEADLINE_EXCEEDED
                assert "no request" in await call.details()


async def test_numbers_from_the_edge_of_their_types_are_no_faults(tmp_path: Path) -> None:
    async with farm_server(tmp_path) as server:
        name = (await server.submit()).name
        claim = await server.claim()
        assert claim is not None
        log = job_service_pb2.ReadLogRequest(name=f"{name}/tasks/1", offset=2**64 - 1, follow=True)
        stream = server.jobs.ReadLog(log, timeout=10)
        assert await stream.code() == grpc.StatusCode.INVALID_ARGUMENT
        page = render_service_pb2.ListRendersRequest(page_token="9" * 10_000)
        assert await server.renders.ListRenders(page, timeout=10).code() == grpc.StatusCode.INVALID_ARGUMENT
        age = duration_pb2.Duration(seconds=2**62)
        assert (await server.jobs.PruneJobs(job_service_pb2.PruneJobsRequest(older_than=age), timeout=10)).jobs == []


@pytest.mark.parametrize(
    "fields",
    [
        {"camera_path": "/" + "c" * 5000},
        {"stage_path": "/" + "s" * 5000},
        {"aovs": ["depth"] * 65},
        {"force_effects": ["x" * 65]},
        {"png": render_pb2.Png(view="v" * 5000)},
    ],
)
async def test_texts_are_bounded(tmp_path: Path, fields: dict[str, object]) -> None:
    """They are kept, and sent to whoever lists: a megabyte each would be a gigabyte a page."""
    async with farm_server(tmp_path) as server:
        spec = render_pb2.RenderSpec(**({"stage_path": str(server.stage)} | fields))
        job = job_pb2.JobSpec(layers=[job_pb2.LayerSpec(render=spec)])
        for call in (
            server.renders.CreateRender(render_service_pb2.CreateRenderRequest(spec=spec), timeout=10),
            server.jobs.CreateJob(job_service_pb2.CreateJobRequest(spec=job, dry_run=True), timeout=10),
        ):
            code, details = await call.code(), await call.details()
            assert code == grpc.StatusCode.INVALID_ARGUMENT
            assert next(iter(fields)) in details
            assert len(details) < 300


def test_looking_for_outputs_that_meet_takes_little_memory() -> None:
    """A million frames, each with a path of four thousand characters, would be four gigabytes."""
    layers = [
        job_pb2.LayerSpec(
            name=name,
            render=render_pb2.RenderSpec(stage_path="/s/a.usd"),
            frames="1-20000",
            chunk=10_000,
            output=f"/{name}{'/x' * 1900}.####.exr",
        )
        for name in ("a", "b")
    ]
    tracemalloc.start()
    try:
        complete_job(job_pb2.JobSpec(layers=layers), (), ())
        assert tracemalloc.get_traced_memory()[1] < 40 << 20
    finally:
        tracemalloc.stop()


async def test_no_image_goes_into_the_folder_of_the_server(tmp_path: Path) -> None:
    """Where it would replace another job's."""
    async with farm_server(tmp_path) as server:
        await server.submit()
        await server.work_off()
        (tmp_path / "link").symlink_to(server.data / "jobs")
        for folder in (server.data / "jobs", tmp_path / "link"):
            job = job_pb2.JobSpec(layers=[server.layer(output=f"{folder}/1/frames/main.#.exr")])
            call = server.jobs.CreateJob(job_service_pb2.CreateJobRequest(spec=job), timeout=10)
            assert await refusal(call) == (grpc.StatusCode.PERMISSION_DENIED, "OUTSIDE_ROOTS")
