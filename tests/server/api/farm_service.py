"""JobService over a real socket, on a real queue; tasks are done by hand, or by a farm with real workers."""

import asyncio
import contextlib
import functools
import hashlib
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc

from footlight.v1 import (
    blob_service_pb2,
    job_pb2,
    job_service_pb2,
    job_service_pb2_grpc,
    render_pb2,
    render_service_pb2_grpc,
    stage_service_pb2_grpc,
    stats_pb2,
)
from footlight_server.api.auth import LocalGate
from footlight_server.api.job_service import JobService
from footlight_server.api.render_service import RenderService
from footlight_server.api.stage_service import StageService
from footlight_server.api.token_gate import TokenGate
from footlight_server.blobs.bundle import BundleStore
from footlight_server.blobs.digest import digest_of
from footlight_server.blobs.store import BlobStore
from footlight_server.farm.dispatcher import Farm
from footlight_server.farm.local import LocalExecutor
from footlight_server.farm.model import Attempt, Claim, Ending, ExitClass, Frame, Lane
from footlight_server.farm.queue import Queue
from footlight_server.farm.token_book import TokenBook
from footlight_server.farm.tokens import Scope
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from tests.server.api.service import STAGE

LANE = Lane("hand/1", "hand")


@dataclass
class FarmServer:
    """What a test reaches of the server: its stub over the socket, and the parts behind it."""

    jobs: job_service_pb2_grpc.JobServiceStub
    renders: render_service_pb2_grpc.RenderServiceStub
    stages: stage_service_pb2_grpc.StageServiceStub
    service: JobService
    queue: Queue
    farm: Farm
    book: TokenBook
    blobs: BlobStore
    data: Path
    address: str
    # The same services, but with tokens.
    guarded: str
    stage: Path

    # --- calls ---

    def layer(self, frames: str = "1-4", **fields: object) -> job_pb2.LayerSpec:
        """A layer of the small stage, 32x32 at 2 samples."""
        render = render_pb2.RenderSpec(stage_path=str(self.stage), width=32, height=32, spp=2)
        return job_pb2.LayerSpec(**({"name": "main", "render": render, "frames": frames} | fields))

    async def submit(self, *layers: job_pb2.LayerSpec, request_id: str = "", **fields: object) -> job_pb2.Job:
        """A new job; of the small stage's frames 1 to 4 unless layers are given."""
        spec = job_pb2.JobSpec(layers=layers or [self.layer()], **fields)
        request = job_service_pb2.CreateJobRequest(spec=spec, request_id=request_id)
        response: job_service_pb2.CreateJobResponse = await self.jobs.CreateJob(request, timeout=30)
        return response.job

    async def get(self, name: str) -> job_pb2.Job:
        response: job_service_pb2.GetJobResponse = await self.jobs.GetJob(
            job_service_pb2.GetJobRequest(name=name), timeout=10
        )
        return response.job

    async def tasks(self, name: str) -> list[job_pb2.Task]:
        """All of them, by pages."""
        request, found = job_service_pb2.ListTasksRequest(job=name, page_size=1000), []
        while True:
            response = await self.jobs.ListTasks(request, timeout=10)
            found += response.tasks
            if not response.next_page_token:
                return found
            request.page_token = response.next_page_token

    async def ended(self, name: str, within: float = 60.0) -> job_pb2.Job:
        """The job once it has ended."""
        request = job_service_pb2.WatchJobRequest(name=name, only_new=True)
        async for _ in self.jobs.WatchJob(request, timeout=within):
            pass
        return await self.get(name)

    # --- tasks by hand ---

    async def claim(self, lane: Lane = LANE) -> Claim | None:
        return await self.queue.claim(lane, [lane])

    async def finish(self, attempt: Attempt, how: ExitClass = ExitClass.SUCCEEDED, message: str = "") -> None:
        await self.queue.finish(attempt, Ending(how, message))

    async def deliver(self, claim: Claim) -> None:
        """An image for each frame of the task: a few bytes, recorded as a worker's are."""
        for number in claim.task.frames:
            path = self.farm.places.image(claim.task.job, claim.task.layer, number)
            path.parent.mkdir(parents=True, exist_ok=True)
            data = f"image of frame {number}\n".encode() * 1000
            path.write_bytes(data)
            frame = Frame(
                job=claim.task.job,
                layer=claim.task.layer,
                frame=number,
                path=str(path),
                sha256=hashlib.sha256(data).hexdigest(),
                size_bytes=len(data),
                task=claim.task.number,
                attempt=claim.attempt.number,
                stats=stats_pb2.RenderStats(spp=2).SerializeToString(),
            )
            assert await self.queue.stage_frame(claim.attempt, frame, f"{path}.temporary")
            assert await self.queue.commit_frame(claim.attempt, frame)

    async def work_off(self, most: int = 1 << 30) -> int:
        """Do tasks until there is none left; how many were done."""
        done = 0
        while done < most and (claim := await self.claim()) is not None:
            await self.deliver(claim)
            await self.finish(claim.attempt)
            done += 1
        return done


@contextlib.asynccontextmanager
async def farm_server(folder: Path, lanes: int = 0, **changed: object) -> AsyncIterator[FarmServer]:
    """A server with its data below `folder`; with lanes it renders by itself, without them tests do the tasks."""
    data, scratch = folder / "data", folder / "scratch"
    data.mkdir(exist_ok=True)
    scratch.mkdir(exist_ok=True)
    stage = folder / "stage.usda"
    stage.write_text(STAGE)
    settings = Settings(
        **(
            {
                "workers": 1,
                "roots": (),
                "scratch": scratch,
                "worker_memory": 0,
                "patience": Patience(),
                "private": False,
                "data": data,
                "farm_workers": lanes,
            }
            | changed
        )
    )
    async with contextlib.AsyncExitStack() as stack:
        queue = await Queue.open(f"sqlite:///{data}/queue.db")
        stack.push_async_callback(queue.close)
        book = TokenBook(queue)
        await book.load()
        stack.push_async_callback(book.close)
        blobs = BlobStore(data / "blobs")
        stack.callback(blobs.close)
        bundles = BundleStore(blobs, data / "bundles")
        stack.push_async_callback(bundles.close)
        sessions = Sessions(settings)
        stack.push_async_callback(sessions.close)
        farm = Farm(settings, queue, sessions, LocalExecutor(lanes, 0), bundles)
        stack.push_async_callback(farm.close)
        if lanes:
            await farm.start()
        service = JobService(queue, farm, bundles, settings)
        stack.push_async_callback(service.close)
        renders, stages = RenderService(sessions, settings, bundles), StageService(sessions, settings, bundles)
        sockets = stack.enter_context(tempfile.TemporaryDirectory(prefix="footlight-"))
        addresses = [f"unix:{sockets}/local", f"unix:{sockets}/guarded"]
        for address, gate in zip(addresses, (LocalGate(), TokenGate(book)), strict=True):
            server = grpc.aio.server(interceptors=(gate,))
            job_service_pb2_grpc.add_JobServiceServicer_to_server(service, server)
            render_service_pb2_grpc.add_RenderServiceServicer_to_server(renders, server)
            stage_service_pb2_grpc.add_StageServiceServicer_to_server(stages, server)
            server.add_insecure_port(address)
            await server.start()
            stack.push_async_callback(server.stop, 0.0)
        channel = await stack.enter_async_context(grpc.aio.insecure_channel(addresses[0]))
        yield FarmServer(
            jobs=job_service_pb2_grpc.JobServiceStub(channel),
            renders=render_service_pb2_grpc.RenderServiceStub(channel),
            stages=stage_service_pb2_grpc.StageServiceStub(channel),
            service=service,
            queue=queue,
            farm=farm,
            book=book,
            blobs=blobs,
            data=data,
            address=addresses[0],
            guarded=addresses[1],
            stage=stage,
        )


class Bearer:
    """A stub whose calls carry a token; by hand, because grpc sends credentials over TLS only."""

    def __init__(self, stub: Any, secret: str) -> None:
        self._stub = stub
        self._metadata = (("authorization", f"Bearer {secret}"),)

    def __getattr__(self, method: str) -> Callable[..., Any]:
        return functools.partial(getattr(self._stub, method), metadata=self._metadata)


@contextlib.asynccontextmanager
async def as_user(
    server: FarmServer,
    user: str,
    scope: Scope = Scope.SUBMIT,
    stub: Callable[[grpc.aio.Channel], object] = job_service_pb2_grpc.JobServiceStub,
) -> AsyncIterator[Bearer]:
    """The same service, JobService or another, called with a token of that user."""
    _, secret = await server.book.create(user, scope, "", None)
    async with grpc.aio.insecure_channel(server.guarded) as channel:
        yield Bearer(stub(channel), secret)


async def upload(server: FarmServer, path: str, data: bytes, *, whole: bool = True) -> str:
    """A bundle of one file, for RenderSpec; if it is not to be whole, without the file."""
    file = digest_of(data)
    named = blob_service_pb2.Digest(sha256=file.sha256, size_bytes=file.size)
    bundle = blob_service_pb2.Bundle(files=[blob_service_pb2.BundleFile(path=path, digest=named)])
    manifest = bundle.SerializeToString(deterministic=True)
    await server.blobs.write("ann", (digest_of(manifest), manifest))
    if whole:
        await server.blobs.write("ann", (file, data))
    return str(digest_of(manifest))


async def until(holds: Callable[[], bool], within: float = 10.0) -> None:
    """Wait for something that nobody announces."""
    deadline = time.monotonic() + within
    while not holds():
        assert time.monotonic() < deadline, "it did not come about"
        await asyncio.sleep(0.02)
