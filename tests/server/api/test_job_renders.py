"""Jobs that are rendered: from the call to the files, with real workers."""

import asyncio
import hashlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from footlight.v1 import (
    job_pb2,
    job_service_pb2,
    render_pb2,
    render_service_pb2,
    render_service_pb2_grpc,
    stage_service_pb2,
)
from footlight_server.farm.tokens import Scope
from tests.server.api.farm_service import FarmServer, as_user, farm_server, upload
from tests.server.api.service import STAGE, pixels_of
from tests.server.api.test_job_streams import image, log_of
from tests.server.api.test_jobs import fields, refused

SERVICE = job_service_pb2


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[FarmServer]:
    async with farm_server(tmp_path, lanes=2) as running:
        yield running


async def test_frames_are_rendered_and_fetched_in_every_format(server: FarmServer, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with_png = render_pb2.RenderSpec(stage_path=str(server.stage), width=64, height=48, spp=2, png=render_pb2.Png())
    job = await server.submit(
        server.layer("1-3", name="kept", render=with_png), server.layer("7-8", name="out", output=f"{out}/o.$F4.exr")
    )
    ended = await server.ended(job.name)
    assert ended.state == job_pb2.JOB_STATE_SUCCEEDED, await server.tasks(job.name)
    assert (ended.frames_done, ended.tasks.succeeded) == (5, 5)
    frames = (await server.jobs.ListFrames(SERVICE.ListFramesRequest(job=job.name), timeout=10)).frames
    for frame in frames:
        data = await image(server, job=job.name, layer=frame.layer, frame=frame.frame)
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (frame.sha256, frame.size_bytes)
        assert frame.stats.spp == 2
    assert sorted(path.name for path in out.iterdir()) == ["o.0007.exr", "o.0008.exr"]
    channels, pixels = pixels_of(await image(server, job=job.name, layer="kept", frame=2), tmp_path)
    assert channels[:3] == ("R", "G", "B")
    assert pixels.shape[:2] == (48, 64)
    assert pixels.max() > 0
    for layer, format_ in (
        ("kept", SERVICE.FRAME_FORMAT_PNG),
        ("kept", SERVICE.FRAME_FORMAT_THUMBNAIL),
        ("out", SERVICE.FRAME_FORMAT_THUMBNAIL),
        ("out", SERVICE.FRAME_FORMAT_CONTACT_SHEET),
    ):
        frame = 2 if layer == "kept" else 7
        data = await image(server, job=job.name, layer=layer, frame=frame, format=format_)
        assert data.startswith(b"\x89PNG")
    png = SERVICE.FRAME_FORMAT_PNG
    await refused(image(server, job=job.name, layer="out", frame=7, format=png), "FRAME_NOT_FOUND")
    assert b"SUCCEEDED" in (await log_of(server, f"{job.name}/tasks/1")).upper()
    pruned = await server.jobs.PruneJobs(SERVICE.PruneJobsRequest(names=[job.name]), timeout=10)
    assert pruned.freed_bytes > 0
    assert len(list(out.iterdir())) == 2


async def test_progress_of_what_runs_is_seen_by_watchers_and_lists(server: FarmServer) -> None:
    render = render_pb2.RenderSpec(stage_path=str(server.stage), width=256, height=256, spp=1 << 20)
    job = await server.submit(server.layer("1-2", render=render, chunk=2))
    task = job_pb2.Task()
    async for response in server.jobs.WatchJob(SERVICE.WatchJobRequest(name=job.name), timeout=60):
        if response.event.HasField("progress"):
            assert response.event.id == 0
            task = response.event.progress
            if task.progress.samples_done > 0:
                break
    assert task.state == job_pb2.TASK_STATE_RUNNING
    assert task.last_attempt.render.startswith("renders/")
    (listed,) = await server.tasks(job.name)
    assert listed.progress.samples_done >= task.progress.samples_done
    workers = (await server.jobs.ListWorkers(SERVICE.ListWorkersRequest(), timeout=10)).workers
    assert sorted(worker.task for worker in workers) == ["", f"{job.name}/tasks/1"]
    why = await server.jobs.ExplainWait(SERVICE.ExplainWaitRequest(name=job.name), timeout=10)
    assert list(why.reasons) == []
    await server.jobs.CancelJob(SERVICE.CancelJobRequest(name=job.name), timeout=10)
    ended = await server.ended(job.name, within=20)
    assert (ended.state, ended.tasks.cancelled) == (job_pb2.JOB_STATE_CANCELLED, 1)


async def test_a_job_of_an_uploaded_stage_is_rendered_as_the_file_is(server: FarmServer, tmp_path: Path) -> None:
    name = await upload(server, "shot/a.usda", STAGE.encode(), whole=False)
    uploaded = render_pb2.RenderSpec(stage_path="shot/a.usda", bundle=name, width=32, height=32, spp=2)
    await refused(server.submit(server.layer("1", render=uploaded)), "BLOBS_MISSING")
    await upload(server, "shot/a.usda", STAGE.encode())
    elsewhere = render_pb2.RenderSpec(stage_path="shot/b.usda", bundle=name)
    error = await refused(server.submit(server.layer("1", render=elsewhere)), "INVALID_FIELD")
    assert fields(error) == ["spec.layers[0].render.stage_path"]
    jobs = [await server.submit(server.layer("1", render=uploaded)), await server.submit(server.layer("1"))]
    await asyncio.gather(*(server.ended(job.name) for job in jobs))
    pixels = [pixels_of(await image(server, job=job.name, frame=1), tmp_path)[1] for job in jobs]
    assert (pixels[0] == pixels[1]).all()
    assert await server.queue.bundles_in_use() == {name}


async def test_a_render_of_an_uploaded_stage_is_the_one_of_the_file(server: FarmServer, tmp_path: Path) -> None:
    name = await upload(server, "shot/a.usda", STAGE.encode())
    pixels = []
    for source in ({"stage_path": str(server.stage)}, {"stage_path": "shot/a.usda", "bundle": name}):
        spec = render_pb2.RenderSpec(width=32, height=32, spp=2, **source)
        explained = await server.stages.ExplainStage(stage_service_pb2.ExplainStageRequest(spec=spec), timeout=30)
        assert explained.spec.camera_path == "/World/camera"
        request = render_service_pb2.CreateRenderRequest(spec=spec)
        render = (await server.renders.CreateRender(request, timeout=30)).render
        while not render.has_result:
            assert render.state != render_pb2.RENDER_STATE_FAILED, render.failure
            await asyncio.sleep(0.05)
            get = render_service_pb2.GetRenderRequest(name=render.name)
            render = (await server.renders.GetRender(get, timeout=10)).render
        result = render_service_pb2.GetResultRequest(name=render.name)
        data = b"".join([piece.data async for piece in server.renders.GetResult(result, timeout=30)])
        pixels.append(pixels_of(data, tmp_path)[1])
    assert (pixels[0] == pixels[1]).all()
    spec = render_pb2.RenderSpec(stage_path="shot/b.usda", bundle=name)
    request = render_service_pb2.CreateRenderRequest(spec=spec)
    error = await refused(server.renders.CreateRender(request, timeout=10), "INVALID_FIELD")
    assert fields(error) == ["spec.stage_path"]
    request.spec.bundle = f"{'0' * 64}/12"
    await refused(server.renders.CreateRender(request, timeout=10), "BLOBS_MISSING")


async def test_a_render_is_its_users_and_so_is_the_name_of_a_request(server: FarmServer) -> None:
    stub = render_service_pb2_grpc.RenderServiceStub
    spec = render_pb2.RenderSpec(stage_path=str(server.stage), width=32, height=32, spp=1 << 20)
    request = render_service_pb2.CreateRenderRequest(spec=spec, request_id="a")
    async with (
        as_user(server, "ann", stub=stub) as ann,
        as_user(server, "bob", stub=stub) as bob,
        as_user(server, "root", Scope.ADMIN, stub) as root,
    ):
        hers = (await ann.CreateRender(request, timeout=10)).render.name
        his = (await bob.CreateRender(request, timeout=10)).render.name
        assert hers != his
        assert (await ann.CreateRender(request, timeout=10)).render.name == hers
        cancel = render_service_pb2.CancelRenderRequest(name=hers)
        await refused(bob.CancelRender(cancel, timeout=10), "NOT_YOURS")
        await bob.GetRender(render_service_pb2.GetRenderRequest(name=hers), timeout=10)
        await ann.CancelRender(cancel, timeout=10)
        await root.CancelRender(render_service_pb2.CancelRenderRequest(name=his), timeout=10)
