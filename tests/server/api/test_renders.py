"""A render over the wire: from the request to the file, idempotent, listed, cancelled."""

import time
import uuid
from pathlib import Path

import grpc
import numpy as np
import pytest

from footlight.v1 import render_pb2, render_service_pb2
from tests.server.api.service import Stubs, pixels_of


async def test_a_stage_becomes_an_exr(client: Stubs, stage: Path, tmp_path: Path) -> None:
    name = await client.create(stage, spp=6, seed=3, aovs=["depth"], png=render_pb2.Png())
    render = await client.end(name)
    assert render.state == render_pb2.RENDER_STATE_SUCCEEDED
    data = await client.result(name)
    channels, image = pixels_of(data, tmp_path)
    assert channels == ("R", "G", "B", "A", "depth.Z")
    assert image.shape == (96, 128, 5)
    assert (await client.result(name, format=render_service_pb2.RESULT_FORMAT_PNG)).startswith(b"\x89PNG")
    assert await client.result(name, offset=1000) == data[1000:]


async def test_statistics_say_what_it_cost(client: Stubs, stage: Path) -> None:
    stats = (await client.end(await client.create(stage, spp=4, seed=9, threads=1))).stats
    parts = stats.seconds
    steps = [parts.open, parts.translate, parts.commit, parts.render, parts.write]
    assert min(steps) >= 0
    assert sum(steps) <= parts.total * 1.001
    assert stats.samples == 128 * 96 * 4
    assert (stats.spp, stats.seed, stats.threads) == (4, 9, 1)
    assert set(stats.cpu_seconds) <= set(stats.pipeline) | {"film"}
    assert {"closest", "shadow"} <= set(stats.rays)
    assert stats.peak_memory_bytes > 1 << 20
    assert {"footlight", "footlight_core", "usd", "embree", "python", "instruction_set"} <= set(stats.versions)
    assert any(effect.active and effect.prim_paths for effect in stats.effects)


async def test_the_same_request_is_one_render(client: Stubs, stage: Path) -> None:
    spec = render_pb2.RenderSpec(stage_path=str(stage), width=8, height=8, spp=1)
    request = render_service_pb2.CreateRenderRequest(spec=spec, request_id=str(uuid.uuid4()))
    first = await client.renders.CreateRender(request, timeout=10)
    again = await client.renders.CreateRender(request, timeout=10)
    assert first.render.name == again.render.name
    request.spec.spp = 2
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await client.renders.CreateRender(request, timeout=10)
    assert caught.value.code() == grpc.StatusCode.ALREADY_EXISTS


async def test_the_seed_decides_and_the_threads_do_not(client: Stubs, stage: Path, tmp_path: Path) -> None:
    async def pixels(**options: object) -> np.ndarray:
        name = await client.create(stage, spp=3, **options)
        await client.end(name)
        return pixels_of(await client.result(name), tmp_path)[1]

    one = await pixels(seed=1, threads=1)
    np.testing.assert_array_equal(await pixels(seed=1, threads=2), one)
    assert (await pixels(seed=2, threads=2) != one).any()


async def test_pages_hold_every_render_once_newest_first(client: Stubs, stage: Path) -> None:
    made = [await client.create(stage, spp=1, width=8, height=8) for _ in range(5)]
    for name in made:
        await client.end(name)
    listed: list[str] = []
    token = ""
    while True:
        request = render_service_pb2.ListRendersRequest(page_size=2, page_token=token)
        page = await client.renders.ListRenders(request, timeout=10)
        assert len(page.renders) <= 2
        listed += [render.name for render in page.renders]
        token = page.next_page_token
        if not token:
            break
    assert len(listed) == len(set(listed))
    assert listed[:5] == made[::-1]


async def test_cancel_ends_it_within_two_seconds(client: Stubs, stage: Path) -> None:
    name = await client.create(stage)
    await client.wait(name, render_pb2.RENDER_STATE_RENDERING)
    before = time.monotonic()
    await client.cancel(name)
    render = await client.end(name)
    assert time.monotonic() - before < 2
    assert render.state == render_pb2.RENDER_STATE_CANCELLED
    assert not render.has_result
    await client.cancel(name)  # again: no error


async def test_cancel_keeps_what_has_converged(client: Stubs, stage: Path) -> None:
    name = await client.create(stage)
    async for event in client.watch(name):
        if event.progress.samples_done >= 2:
            break
    await client.cancel(name, keep=True)
    render = await client.end(name)
    assert render.state == render_pb2.RENDER_STATE_CANCELLED
    assert render.has_result
    assert render.stats.spp >= 2
    assert len(await client.result(name)) > 1000


async def test_a_time_limit_succeeds_with_what_is_there(client: Stubs, stage: Path) -> None:
    render = await client.end(await client.create(stage, time_limit_seconds=0.5))
    assert render.state == render_pb2.RENDER_STATE_SUCCEEDED
    assert 0 < render.stats.spp < 1 << 20
    assert render.stats.seconds.render < 5


async def test_an_error_limit_stops_when_it_is_reached(client: Stubs, stage: Path) -> None:
    render = await client.end(await client.create(stage, error_limit=0.2), within=60)
    assert render.state == render_pb2.RENDER_STATE_SUCCEEDED
    assert render.stats.error_mean <= 0.2


async def test_without_a_size_the_stage_decides(client: Stubs, stage: Path) -> None:
    stage.write_text(
        stage.read_text() + '\ndef RenderSettings "settings" {\n    uniform int2 resolution = (80, 60)\n}\n'
    )
    layer = '#usda 1.0\n(\n    upAxis = "Y"\n    renderSettingsPrimPath = "/settings"\n'
    stage.write_text(stage.read_text().replace('#usda 1.0\n(\n    upAxis = "Y"\n', layer))
    render = await client.end(await client.create(stage, width=0, height=0, spp=1))
    assert (render.spec.width, render.spec.height) == (80, 60)
    assert render.spec.camera_path == "/World/camera"


async def test_a_result_that_is_not_there_is_refused(client: Stubs, stage: Path) -> None:
    name = await client.create(stage)
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await client.result(name)
    assert caught.value.code() == grpc.StatusCode.FAILED_PRECONDITION
    await client.cancel(name)
    await client.end(name)
