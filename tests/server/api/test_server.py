"""The server process: where it listens, how it starts, how it ends, what it leaves behind."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from footlight.v1 import render_pb2
from footlight_server.api.address import AddressError, check_address
from tests.server.api.service import StartServer, Stubs, connect


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def wait_until_gone(pids: list[int], seconds: float = 2.0) -> None:
    deadline = time.monotonic() + seconds
    while not all(gone(pid) for pid in pids):
        assert time.monotonic() < deadline, pids
        time.sleep(0.02)


@pytest.mark.parametrize(
    "address", ["127.0.0.1:0", "127.8.8.8:1", "[::1]:50051", "localhost:65535", "unix:/tmp/socket"]
)
def test_loopback_may_be_listened_on(address: str) -> None:
    assert check_address(address) == address


@pytest.mark.parametrize(
    "address",
    ["0.0.0.0:1", "[::]:1", "192.168.1.2:1", "example.org:1", "127.0.0.1", "127.0.0.1:99999", ":1", "unix:", ""],
)
def test_anything_else_is_refused(address: str) -> None:
    with pytest.raises(AddressError):
        check_address(address)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--listen", "0.0.0.0:0"], "TLS"),
        (["--workers", "0"], "--workers 0"),
        (["--root", "/nowhere/at/all"], "/nowhere/at/all"),
        (["--open-seconds", "-1"], "--open-seconds -1"),
        (["--scratch", "/nowhere/at/all"], "/nowhere/at/all"),
    ],
)
def test_a_server_that_cannot_start_says_why(options: list[str], word: str) -> None:
    command = [sys.executable, "-m", "footlight_server", "--listen", "127.0.0.1:0", *options]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert result.returncode == 2
    assert word in result.stderr
    assert "Traceback" not in result.stderr


def test_a_port_that_is_taken_is_refused(start_server: StartServer) -> None:
    with start_server() as server:
        command = [sys.executable, "-m", "footlight_server", "--listen", server.address]
        result = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        assert result.returncode == 2


async def test_health_and_reflection_answer(client: Stubs) -> None:
    health = health_pb2_grpc.HealthStub(client.channel)
    for service in ("", "footlight.v1.RenderService", "footlight.v1.StageService"):
        answer = await health.Check(health_pb2.HealthCheckRequest(service=service), timeout=10)
        assert answer.status == health_pb2.HealthCheckResponse.SERVING
    reflection = reflection_pb2_grpc.ServerReflectionStub(client.channel)
    call = reflection.ServerReflectionInfo(timeout=10)
    await call.write(reflection_pb2.ServerReflectionRequest(list_services=""))
    listed = {service.name for service in (await call.read()).list_services_response.service}
    assert {"footlight.v1.RenderService", "footlight.v1.StageService", "grpc.health.v1.Health"} <= listed
    call.cancel()


async def test_sigterm_ends_renders_workers_and_files(start_server: StartServer, stage: Path, tmp_path: Path) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    with start_server("--scratch", scratch) as server:
        async with connect(server) as client:
            name = await client.create(stage)
            waiting = await client.create(stage)
            await client.wait(name, render_pb2.RENDER_STATE_RENDERING)
            workers = server.workers()
            assert len(workers) >= 1
            ends = asyncio.gather(client.end(name), client.end(waiting))
            await asyncio.sleep(0.2)
            before = time.monotonic()
            server.process.send_signal(signal.SIGTERM)
            assert [render.state for render in await ends] == [render_pb2.RENDER_STATE_CANCELLED] * 2
            assert await asyncio.to_thread(server.process.wait, 15) == 0
            assert time.monotonic() - before < 6
            wait_until_gone(workers)
            assert list(scratch.iterdir()) == []


async def test_workers_do_not_outlive_a_killed_server(start_server: StartServer, stage: Path, tmp_path: Path) -> None:
    with start_server("--scratch", tmp_path) as server:
        async with connect(server) as client:
            await client.wait(await client.create(stage), render_pb2.RENDER_STATE_RENDERING)
            workers = server.workers()
            os.kill(server.process.pid, signal.SIGKILL)
            wait_until_gone(workers)


async def test_a_private_server_ends_with_its_client(start_server: StartServer, stage: Path, tmp_path: Path) -> None:
    address = f"unix:{tmp_path}/socket"
    with start_server("--private", "--listen", address) as server:
        assert server.address == address
        async with connect(server) as client:
            await client.wait(await client.create(stage), render_pb2.RENDER_STATE_RENDERING)
            assert server.process.stdin is not None
            server.process.stdin.close()
            assert await asyncio.to_thread(server.process.wait, 10) == 0
        assert (tmp_path / "socket").exists() is False


async def test_a_unix_socket_is_for_its_owner_only(start_server: StartServer, tmp_path: Path) -> None:
    with start_server("--listen", f"unix:{tmp_path}/socket"):
        assert (tmp_path / "socket").stat().st_mode & 0o077 == 0


async def test_the_server_forgets_old_renders_but_not_running_ones(start_server: StartServer, stage: Path) -> None:
    from footlight_server.sessions.sessions import REMEMBERED

    with start_server() as server:
        async with connect(server) as client:
            running = await client.create(stage)
            await client.wait(running, render_pb2.RENDER_STATE_RENDERING)
            names = [await client.create(stage) for _ in range(REMEMBERED + 1)]
            for name in names:
                await client.cancel(name)
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await client.get(names[0])
            assert caught.value.code() == grpc.StatusCode.NOT_FOUND
            assert (await client.get(names[1])).state == render_pb2.RENDER_STATE_CANCELLED
            assert (await client.get(running)).state == render_pb2.RENDER_STATE_RENDERING
