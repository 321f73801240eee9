"""What goes wrong in a worker stays there: the render fails with its cause, the others and the service go on."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import grpc
import pytest

from footlight.v1 import render_pb2, stage_service_pb2
from tests.server.api.service import Server, StartServer, Stubs, connect

# [s] Within which a fault has to show.
SOON = 2.0


async def watched_end(client: Stubs, name: str) -> tuple[render_pb2.Render, float]:
    """The render once it has ended, and [s] how long that took from now."""
    before = time.monotonic()
    render = await client.end(name)
    return render, time.monotonic() - before


@pytest.mark.parametrize(("number", "word"), [(signal.SIGKILL, "SIGKILL"), (signal.SIGSEGV, "SIGSEGV")])
async def test_a_dead_worker_fails_its_render_and_no_other(
    start_server: StartServer, stage: Path, number: signal.Signals, word: str
) -> None:
    with start_server("--workers", 2) as server:
        async with connect(server) as client:
            first = await client.create(stage)
            await client.wait(first, render_pb2.RENDER_STATE_RENDERING)
            victim = server.workers()[0]
            second = await client.create(stage)
            await client.wait(second, render_pb2.RENDER_STATE_RENDERING)
            os.kill(victim, number)
            render, seconds = await watched_end(client, first)
            assert render.state == render_pb2.RENDER_STATE_FAILED
            assert render.failure.reason == render_pb2.FAILURE_REASON_CRASHED
            assert word in render.failure.message
            assert seconds < SOON
            before = (await client.get(second)).progress.samples_done
            await asyncio.sleep(0.7)
            after = await client.get(second)
            assert after.state == render_pb2.RENDER_STATE_RENDERING
            assert after.progress.samples_done > before


async def test_a_worker_that_dies_while_it_waits_is_replaced(start_server: StartServer, stage: Path) -> None:
    with start_server() as server:
        async with connect(server) as client:
            assert (await client.end(await client.create(stage, spp=1))).state == render_pb2.RENDER_STATE_SUCCEEDED
            while not server.workers():
                await asyncio.sleep(0.05)
            server.kill_workers()
            await asyncio.sleep(0.2)
            assert (await client.end(await client.create(stage, spp=1))).state == render_pb2.RENDER_STATE_SUCCEEDED


async def test_a_stage_that_hangs_in_the_parser_is_given_up(
    start_server: StartServer, stage: Path, hanging_stage: Path
) -> None:
    with start_server("--workers", 2, "--open-seconds", 1.5) as server:
        async with connect(server) as client:
            hanging = await client.create(hanging_stage)
            good = await client.create(stage, spp=2)
            assert (await client.end(good)).state == render_pb2.RENDER_STATE_SUCCEEDED
            render, _ = await watched_end(client, hanging)
            assert render.failure.reason == render_pb2.FAILURE_REASON_TIMEOUT
            assert "1.5 s" in render.failure.message
            took = render.end_time.ToNanoseconds() - render.start_time.ToNanoseconds()
            assert took < (1.5 + SOON) * 1e9


async def test_an_explanation_that_nobody_waits_for_frees_its_worker(
    start_server: StartServer, stage: Path, hanging_stage: Path
) -> None:
    with start_server("--workers", 1) as server:
        async with connect(server) as client:
            spec = render_pb2.RenderSpec(stage_path=str(hanging_stage))
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await client.stages.ExplainStage(stage_service_pb2.ExplainStageRequest(spec=spec), timeout=3)
            assert caught.value.code() == grpc.StatusCode.DEADLINE_EXCEEDED
            render = await client.end(await client.create(stage, spp=1))
            assert render.state == render_pb2.RENDER_STATE_SUCCEEDED


async def test_a_stage_that_eats_memory_is_stopped(start_server: StartServer, stage: Path, bomb_stage: Path) -> None:
    with start_server("--worker-memory", 0.3) as server:
        async with connect(server) as client:
            render, _ = await watched_end(client, await client.create(bomb_stage))
            assert render.state == render_pb2.RENDER_STATE_FAILED
            assert render.failure.reason == render_pb2.FAILURE_REASON_OUT_OF_MEMORY
            assert "memory" in render.failure.message
            assert (await client.end(await client.create(stage, spp=1))).state == render_pb2.RENDER_STATE_SUCCEEDED


def small_disks_can_be_mounted() -> bool:
    """Whether this machine gives an unprivileged process a mount namespace; containers often refuse."""
    command = ["unshare", "--user", "--map-root-user", "--mount", "true"]
    return subprocess.run(command, check=False, capture_output=True).returncode == 0


@pytest.mark.skipif(not small_disks_can_be_mounted(), reason="no user namespaces here to mount a small disk in")
async def test_a_full_disk_is_named(stage: Path, tmp_path: Path) -> None:
    scratch = tmp_path / "full"
    scratch.mkdir()
    script = f'mount -t tmpfs -o size=32k none "{scratch}" && exec "$0" -m footlight_server "$@"'
    options = ["--listen", "127.0.0.1:0", "--scratch", str(scratch)]
    process = subprocess.Popen(
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, sys.executable, *options],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        address = process.stdout.readline().split()[-1]
        async with connect(Server(process, address)) as client:
            render, _ = await watched_end(client, await client.create(stage, spp=1, width=256, height=256))
            assert render.state == render_pb2.RENDER_STATE_FAILED
            assert render.failure.reason == render_pb2.FAILURE_REASON_OUTPUT
            assert "image.exr" in render.failure.message
            assert "space" in render.failure.message
            small = await client.end(await client.create(stage, spp=1, width=8, height=8))
            assert small.state == render_pb2.RENDER_STATE_SUCCEEDED
    finally:
        process.terminate()
        process.wait(15)
        process.stdout.close()


async def test_those_that_wait_go_on_when_one_fails(start_server: StartServer, stage: Path) -> None:
    with start_server("--workers", 1) as server:
        async with connect(server) as client:
            first = await client.create(stage)
            waiting = [await client.create(stage, spp=1) for _ in range(3)]
            await client.wait(first, render_pb2.RENDER_STATE_RENDERING)
            assert {(await client.get(name)).state for name in waiting} == {render_pb2.RENDER_STATE_QUEUED}
            await client.cancel(waiting[1])
            server.kill_workers()
            states = [(await client.end(name)).state for name in waiting]
            succeeded, cancelled = render_pb2.RENDER_STATE_SUCCEEDED, render_pb2.RENDER_STATE_CANCELLED
            assert states == [succeeded, cancelled, succeeded]
