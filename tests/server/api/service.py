"""A real server process, its workers by process id, and a stage that renders as long as one likes."""

import contextlib
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import grpc
import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
from numpy.typing import NDArray

from footlight.v1 import render_pb2, render_service_pb2, render_service_pb2_grpc, stage_service_pb2_grpc

# A box on the floor under a lamp.
STAGE = """#usda 1.0
(
    upAxis = "Y"
)
def Xform "World" {
    def Camera "camera" {
        double3 xformOp:translate = (0, 1, 8)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Cube "box" {
        double size = 2
    }
    def Plane "floor" {
        uniform token axis = "Y"
        double width = 20
        double length = 20
        double3 xformOp:translate = (0, -1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def RectLight "lamp" {
        float inputs:intensity = 20
        double3 xformOp:translate = (0, 6, 0)
        float xformOp:rotateX = -90
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }
}
"""

# More than any test waits for.
LONG = 1 << 20


@dataclass
class Server:
    """A server that a test started."""

    process: subprocess.Popen[str]
    address: str
    # All that it listens on; `address` is the first.
    addresses: tuple[str, ...] = ()

    def workers(self) -> list[int]:
        """Process ids, oldest first; a worker that has ended is none."""
        pids = []
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError, ValueError):
                pid = int(entry.name)
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                if int(fields[1]) == self.process.pid and fields[0] != "Z":
                    pids.append(pid)
        return sorted(pids)

    def kill_workers(self, which: slice = slice(None)) -> None:
        for pid in self.workers()[which]:
            os.kill(pid, signal.SIGKILL)


StartServer = Callable[..., AbstractContextManager[Server]]


@contextlib.contextmanager
def start(*options: object, listen: int = 1, stderr: Path | None = None) -> Iterator[Server]:
    """A server with these options; with a data folder of its own unless they say where.

    `listen`: addresses it has. `stderr`: where its log goes.
    """
    with tempfile.TemporaryDirectory(prefix="footlight-test-") as directory, contextlib.ExitStack() as files:
        log = files.enter_context(stderr.open("ab")) if stderr is not None else None
        command = [sys.executable, "-m", "footlight_server", *(str(option) for option in options)]
        if "--listen" not in options:
            command += ["--listen", "127.0.0.1:0"]
        if "--data" not in options:
            command += ["--data", f"{directory}/data"]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True)
        assert process.stdout is not None
        assert process.stdin is not None
        try:
            assert select.select([process.stdout], [], [], 30)[0], "the server did not start"
            lines = [process.stdout.readline() for _ in range(listen)]
            assert all(line.startswith("listening on ") for line in lines), lines
            addresses = [line.split()[-1] for line in lines]
            yield Server(process, addresses[0], tuple(addresses))
        finally:
            if process.poll() is None:
                process.terminate()
            process.wait(15)
            process.stdout.close()
            process.stdin.close()


@dataclass
class Stubs:
    """What a client of a server calls."""

    server: Server
    renders: render_service_pb2_grpc.RenderServiceStub
    stages: stage_service_pb2_grpc.StageServiceStub
    channel: grpc.aio.Channel

    async def create(self, stage: Path, **options: object) -> str:
        """The name of a new render of that stage; small and never-ending unless asked otherwise."""
        spec = render_pb2.RenderSpec(stage_path=str(stage), **({"width": 128, "height": 96, "spp": LONG} | options))
        request = render_service_pb2.CreateRenderRequest(spec=spec)
        return str((await self.renders.CreateRender(request, timeout=10)).render.name)

    async def get(self, name: str) -> render_pb2.Render:
        request = render_service_pb2.GetRenderRequest(name=name)
        response: render_service_pb2.GetRenderResponse = await self.renders.GetRender(request, timeout=10)
        return response.render

    async def wait(self, name: str, *states: int, within: float = 30.0) -> render_pb2.Render:
        """The render once it has one of these states."""
        deadline = time.monotonic() + within
        async for event in self.watch(name, timeout=within):
            if event.HasField("render") and event.render.state in states:
                return event.render
        render = await self.get(name)
        left = deadline - time.monotonic()
        raise AssertionError(f"it is {render_pb2.RenderState.Name(render.state)}, {left:.1f} s left: {render.failure}")

    async def end(self, name: str, within: float = 30.0) -> render_pb2.Render:
        """The render once it has ended."""
        ends = (
            render_pb2.RENDER_STATE_SUCCEEDED,
            render_pb2.RENDER_STATE_FAILED,
            render_pb2.RENDER_STATE_CANCELLED,
        )
        return await self.wait(name, *ends, within=within)

    async def watch(
        self, name: str, *, timeout: float = 30.0, **subscribe: object
    ) -> AsyncIterator[render_service_pb2.WatchRenderResponse]:
        """Events; a batch is granted for each that came."""
        call = self.renders.WatchRender(timeout=timeout)
        asked = render_service_pb2.Subscribe(name=name, **subscribe)
        await call.write(render_service_pb2.WatchRenderRequest(subscribe=asked))
        try:
            async for event in call:
                if event.HasField("tiles"):
                    grant = render_service_pb2.Grant(credits=1)
                    await call.write(render_service_pb2.WatchRenderRequest(grant=grant))
                yield event
        finally:
            call.cancel()

    async def cancel(self, name: str, *, keep: bool = False) -> None:
        request = render_service_pb2.CancelRenderRequest(name=name, keep_partial=keep)
        await self.renders.CancelRender(request, timeout=10)

    async def result(self, name: str, **options: object) -> bytes:
        request = render_service_pb2.GetResultRequest(name=name, **options)
        return b"".join([chunk.data async for chunk in self.renders.GetResult(request, timeout=30)])


def pixels_of(exr: bytes, directory: Path) -> tuple[tuple[str, ...], NDArray[np.float32]]:
    """Channel names, and (height, width, channels)."""
    path = directory / "image.exr"
    path.write_bytes(exr)
    image = oiio.ImageBuf(str(path))
    pixels = image.get_pixels(oiio.FLOAT)
    assert pixels is not None, image.geterror()
    return tuple(image.spec().channelnames), pixels


@contextlib.asynccontextmanager
async def connect(server: Server) -> AsyncIterator[Stubs]:
    """A client of that server."""
    async with grpc.aio.insecure_channel(server.address) as channel:
        renders = render_service_pb2_grpc.RenderServiceStub(channel)
        yield Stubs(server, renders, stage_service_pb2_grpc.StageServiceStub(channel), channel)
