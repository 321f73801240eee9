"""Laws of the stream: first event, order, credit, newest wins, and viewers that misbehave."""

import asyncio
import subprocess
import sys
import time
from pathlib import Path

import grpc
import numpy as np
import pytest
import zstandard

from footlight.v1 import render_pb2, render_service_pb2, tile_pb2
from tests.server.api.service import StartServer, Stubs, connect, pixels_of

RENDERING = render_pb2.RENDER_STATE_RENDERING
SUCCEEDED = render_pb2.RENDER_STATE_SUCCEEDED


def paste(image: np.ndarray, tile: tile_pb2.Tile) -> None:
    """A tile of encoding FLOAT into an image."""
    planes = np.frombuffer(tile.data, "<f4").reshape(tile.channels, -(-tile.height // tile.scale), -1)
    pixels = planes.repeat(tile.scale, 1).repeat(tile.scale, 2).transpose(1, 2, 0)
    image[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] = pixels[: tile.height, : tile.width]


async def test_the_stream_tells_the_whole_story_and_ends(client: Stubs, stage: Path) -> None:
    name = await client.create(stage, spp=40, width=300, height=200)
    events = [event async for event in client.watch(name, aovs=["color"], credits=2)]
    assert events[0].HasField("render")
    states = [event.render.state for event in events if event.HasField("render")]
    assert states == sorted(states)
    assert states[-1] == SUCCEEDED
    batches = [event.tiles for event in events if event.HasField("tiles")]
    assert [batch.sequence for batch in batches] == list(range(1, len(batches) + 1))
    assert {batch.epoch for batch in batches} == {batches[0].epoch}
    assert all(event.ByteSize() <= 256 << 10 for event in events)
    progress = [event.progress.samples_done for event in events if event.HasField("progress")]
    assert progress == sorted(progress)
    assert progress[-1] == 40


async def test_the_last_tiles_are_the_image(client: Stubs, stage: Path, tmp_path: Path) -> None:
    name = await client.create(stage, spp=20, width=200, height=150, aovs=["albedo"])
    shown = {"color": np.full((150, 200, 3), np.nan, np.float32), "albedo": np.full((150, 200, 3), np.nan, np.float32)}
    encoding = tile_pb2.TILE_ENCODING_FLOAT
    async for event in client.watch(name, aovs=list(shown), credits=2, encoding=encoding):
        for tile in event.tiles.tiles:
            paste(shown[tile.aov], tile)
    _, pixels = pixels_of(await client.result(name), tmp_path)
    np.testing.assert_array_equal(shown["color"], pixels[:, :, :3])
    np.testing.assert_array_equal(shown["albedo"], pixels[:, :, 4:7])


async def test_half_tiles_decode_to_the_size_they_say(client: Stubs, stage: Path) -> None:
    name = await client.create(stage, spp=2)
    async for event in client.watch(name, aovs=["color"], credits=2):
        for tile in event.tiles.tiles:
            assert tile.encoding == tile_pb2.TILE_ENCODING_HALF_SHUFFLE_ZSTD
            raw = zstandard.ZstdDecompressor().decompress(tile.data)
            assert len(raw) == 2 * tile.width * tile.height * tile.channels


async def test_a_large_image_is_there_at_once_and_coarse(client: Stubs, stage: Path) -> None:
    name = await client.create(stage, width=1600, height=1200)
    covered = np.zeros((1200, 1600), bool)
    first_scales = set()
    async for event in client.watch(name, aovs=["color"], credits=8):
        for tile in event.tiles.tiles:
            if not covered[tile.y, tile.x]:
                first_scales.add(tile.scale)
            covered[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] = True
        if covered.all():
            break
    await client.cancel(name)
    assert 8 in first_scales
    await client.end(name)


async def test_without_credit_there_are_events_but_no_tiles(client: Stubs, stage: Path) -> None:
    name = await client.create(stage, spp=30)
    events = [event async for event in client.watch(name, aovs=["color"], credits=0)]
    assert not any(event.HasField("tiles") for event in events)
    assert events[-1].render.state == SUCCEEDED or any(e.render.state == SUCCEEDED for e in events)


async def test_who_joins_late_gets_the_image_as_it_is(client: Stubs, stage: Path) -> None:
    name = await client.create(stage, spp=8)
    await client.end(name)
    covered = np.zeros((96, 128), int)
    async for event in client.watch(name, aovs=["color"], credits=2):
        for tile in event.tiles.tiles:
            assert tile.samples == 8
            covered[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] += 1
    assert (covered == 1).all()


async def test_a_slow_viewer_gets_new_tiles_not_all_tiles(client: Stubs, stage: Path) -> None:
    """Two batches and a long pause: what comes after the pause is newer than anything that was due before it."""
    name = await client.create(stage)
    call = client.renders.WatchRender(timeout=60)
    subscribe = render_service_pb2.Subscribe(name=name, aovs=["color"], credits=1)
    await call.write(render_service_pb2.WatchRenderRequest(subscribe=subscribe))
    before = await _next_tiles(call)
    await asyncio.sleep(1.5)
    now = (await client.get(name)).progress.samples_done
    await call.write(render_service_pb2.WatchRenderRequest(grant=render_service_pb2.Grant(credits=1)))
    after = await _next_tiles(call)
    assert len(after) <= 4  # the image has four tiles: no tile twice
    assert min(tile.samples for tile in after) >= now - 48
    assert max(tile.samples for tile in before) < now
    call.cancel()
    await client.cancel(name)


async def _next_tiles(call: grpc.aio.StreamStreamCall) -> list[tile_pb2.Tile]:
    async for event in call:
        if event.HasField("tiles"):
            return list(event.tiles.tiles)
    raise AssertionError("the stream ended")


async def test_a_viewer_that_never_reads_harms_nobody(start_server: StartServer, stage: Path) -> None:
    """It may cost a window of network buffers; the render, another viewer and the server's end do not wait for it."""
    with start_server() as server:
        async with connect(server) as client:
            name = await client.create(stage, width=640, height=480, spp=48)
            options = [("grpc.http2.lookahead_bytes", 1), ("grpc.http2.bdp_probe", 0)]
            async with grpc.aio.insecure_channel(server.address, options=options) as channel:
                call = channel.stream_stream(
                    "/footlight.v1.RenderService/WatchRender",
                    render_service_pb2.WatchRenderRequest.SerializeToString,
                    render_service_pb2.WatchRenderResponse.FromString,
                )(timeout=120)
                encoding = tile_pb2.TILE_ENCODING_FLOAT
                subscribe = render_service_pb2.Subscribe(name=name, aovs=["color"], credits=64, encoding=encoding)
                await call.write(render_service_pb2.WatchRenderRequest(subscribe=subscribe))
                tiles = 0
                async for event in client.watch(name, aovs=["color"], credits=2, timeout=120):
                    tiles += len(event.tiles.tiles)
                assert tiles >= 80
                assert (await client.get(name)).state == SUCCEEDED
                before = time.monotonic()
                server.process.terminate()
                assert await asyncio.to_thread(server.process.wait, 15) == 0
                assert time.monotonic() - before < 10
                call.cancel()


async def test_a_viewer_that_vanishes_harms_nobody(client: Stubs, stage: Path) -> None:
    name = await client.create(stage, width=640, height=480)
    program = (
        "import sys, time, grpc\n"
        "from footlight.v1 import render_service_pb2 as p, render_service_pb2_grpc as g\n"
        "stub = g.RenderServiceStub(grpc.insecure_channel(sys.argv[1]))\n"
        "ask = p.WatchRenderRequest(subscribe=p.Subscribe(name=sys.argv[2], aovs=['color'], credits=64))\n"
        "def asks():\n"
        "    yield ask\n"
        "    time.sleep(60)\n"
        "for event in stub.WatchRender(asks()):\n"
        "    if event.HasField('tiles'):\n"
        "        print('seen', flush=True)\n"
    )
    viewer = subprocess.Popen([sys.executable, "-c", program, client.server.address, name], stdout=subprocess.PIPE)
    assert viewer.stdout is not None
    await asyncio.to_thread(viewer.stdout.readline)
    viewer.kill()
    viewer.wait()
    viewer.stdout.close()
    before = (await client.get(name)).progress.samples_done
    await asyncio.sleep(1.0)
    after = await client.get(name)
    assert after.state == RENDERING
    assert after.progress.samples_done > before
    await client.cancel(name)
    await client.end(name)


@pytest.mark.parametrize(
    "request_", [render_service_pb2.WatchRenderRequest(), None], ids=["empty message", "no message"]
)
async def test_the_first_message_has_to_subscribe(
    client: Stubs, request_: render_service_pb2.WatchRenderRequest | None
) -> None:
    call = client.renders.WatchRender(timeout=10)
    if request_ is not None:
        await call.write(request_)
    await call.done_writing()
    assert await call.code() == grpc.StatusCode.INVALID_ARGUMENT


async def test_only_what_is_rendered_can_be_watched(client: Stubs, stage: Path) -> None:
    name = await client.create(stage, spp=1)
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        _ = [event async for event in client.watch(name, aovs=["depth"], credits=1)]
    assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert "depth" in (caught.value.details() or "")
