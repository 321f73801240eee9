"""How a server stops: in which order, what becomes of what runs, and that the next server goes on with it."""

import asyncio
import contextlib
import signal
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from footlight.v1 import job_pb2, job_service_pb2, job_service_pb2_grpc, render_pb2
from footlight_server.farm.model import Attempt, ExitClass, Task, TaskState
from footlight_server.farm.queue import Queue
from tests.server.api.secured import reason_of
from tests.server.api.service import LONG, STAGE, Server, start

NOT_SERVING = health_pb2.HealthCheckResponse.NOT_SERVING


@dataclass
class Draining:
    """A server with one lane and a job, whose first task runs."""

    server: Server
    channel: grpc.aio.Channel
    jobs: job_service_pb2_grpc.JobServiceStub
    name: str

    async def health(self) -> int:
        request = health_pb2.HealthCheckRequest(service="footlight.v1.JobService")
        response = await health_pb2_grpc.HealthStub(self.channel).Check(request, timeout=5)
        return int(response.status)

    def signal(self) -> None:
        self.server.process.send_signal(signal.SIGTERM)

    async def exit_code(self, within: float) -> int:
        return await asyncio.to_thread(self.server.process.wait, within)


@contextlib.asynccontextmanager
async def running(folder: Path, spp: int, frames: str, *options: object) -> AsyncIterator[Draining]:
    """Data is kept in `folder`/data."""
    stage = folder / "stage.usda"
    stage.write_text(STAGE)
    render = render_pb2.RenderSpec(stage_path=str(stage), width=64, height=64, spp=spp, threads=1)
    spec = job_pb2.JobSpec(layers=[job_pb2.LayerSpec(render=render, frames=frames)])
    with start("--data", folder / "data", *options) as server:
        async with grpc.aio.insecure_channel(server.address) as channel:
            jobs = job_service_pb2_grpc.JobServiceStub(channel)
            name = (await jobs.CreateJob(job_service_pb2.CreateJobRequest(spec=spec), timeout=10)).job.name
            async for response in jobs.WatchJob(job_service_pb2.WatchJobRequest(name=name), timeout=30):
                if response.event.progress.progress.samples_done:
                    break
            yield Draining(server, channel, jobs, name)


async def left(folder: Path) -> tuple[Sequence[Task], list[list[Attempt]]]:
    """What the server that has ended has left in the queue: tasks, and attempts at each."""
    queue = await Queue.open(f"sqlite:///{folder}/data/queue.db")
    try:
        tasks = await queue.tasks(1, 100)
        return tasks, [await queue.attempts(1, task.number) for task in tasks]
    finally:
        await queue.close()


async def test_what_runs_may_end_and_nothing_else_is_begun(tmp_path: Path) -> None:
    async with running(tmp_path, 12_000, "1-3", "--drain-seconds", 60) as draining:
        draining.signal()
        while await draining.health() != NOT_SERVING:
            await asyncio.sleep(0.02)
        # It says so while the attempt still runs.
        task = (await draining.jobs.ListTasks(job_service_pb2.ListTasksRequest(job=draining.name), timeout=5)).tasks[0]
        assert task.state == job_pb2.TASK_STATE_RUNNING
        assert await draining.exit_code(60) == 0
    tasks, attempts = await left(tmp_path)
    assert [task.state for task in tasks] == [TaskState.SUCCEEDED, TaskState.READY, TaskState.READY]
    assert [[attempt.exit_class for attempt in of_task] for of_task in attempts] == [[ExitClass.SUCCEEDED], [], []]


async def test_what_does_not_end_in_time_is_preempted_and_goes_on_with_the_next_server(tmp_path: Path) -> None:
    async with running(tmp_path, LONG, "1", "--drain-seconds", 0.5) as draining:
        before = time.monotonic()
        draining.signal()
        assert await draining.exit_code(20) == 0
        assert 0.5 <= time.monotonic() - before < 8
    tasks, attempts = await left(tmp_path)
    assert (tasks[0].state, tasks[0].failures) == (TaskState.READY, 0)
    assert [attempt.exit_class for attempt in attempts[0]] == [ExitClass.PREEMPTED]
    with start("--data", tmp_path / "data") as server:
        async with grpc.aio.insecure_channel(server.address) as channel:
            jobs = job_service_pb2_grpc.JobServiceStub(channel)
            async for response in jobs.WatchJob(
                job_service_pb2.WatchJobRequest(name="jobs/1", only_new=True), timeout=30
            ):
                if response.event.progress.progress.samples_done:
                    break
            listed = await jobs.ListAttempts(job_service_pb2.ListAttemptsRequest(task="jobs/1/tasks/1"), timeout=5)
            assert [attempt.exit_class for attempt in listed.attempts] == [job_pb2.EXIT_CLASS_PREEMPTED, 0]
            await jobs.CancelJob(job_service_pb2.CancelJobRequest(name="jobs/1"), timeout=5)


async def test_a_second_signal_hurries(tmp_path: Path) -> None:
    async with running(tmp_path, LONG, "1", "--drain-seconds", 600) as draining:
        draining.signal()
        await asyncio.sleep(1.0)
        assert await draining.health() == NOT_SERVING
        assert draining.server.process.poll() is None
        before = time.monotonic()
        draining.signal()
        assert await draining.exit_code(20) == 0
        assert time.monotonic() - before < 8
    _, attempts = await left(tmp_path)
    assert [attempt.exit_class for attempt in attempts[0]] == [ExitClass.PREEMPTED]


async def test_who_watches_is_told_that_the_server_stops_when_it_does(tmp_path: Path) -> None:
    """Not when it begins to drain: there is something to see until the end."""
    async with running(tmp_path, LONG, "1", "--drain-seconds", 1.5) as draining:
        watch = draining.jobs.WatchJob(job_service_pb2.WatchJobRequest(name=draining.name), timeout=30)
        signalled = seen = 0.0
        with contextlib.suppress(grpc.aio.AioRpcError):
            async for response in watch:
                if not signalled:
                    draining.signal()
                    signalled = time.monotonic()
                elif response.event.HasField("progress"):
                    seen = time.monotonic() - signalled
        assert await watch.code() == grpc.StatusCode.UNAVAILABLE
        assert await reason_of(watch) == "SHUTTING_DOWN"
        assert 0.5 < seen < 5
        assert await draining.exit_code(20) == 0


async def test_a_server_without_work_stops_at_once(tmp_path: Path) -> None:
    with start("--data", tmp_path / "data", "--drain-seconds", 600) as server:
        before = time.monotonic()
        server.process.send_signal(signal.SIGTERM)
        assert await asyncio.to_thread(server.process.wait, 20) == 0
        assert time.monotonic() - before < 4


async def test_renders_that_come_while_it_drains_are_refused(tmp_path: Path) -> None:
    from footlight.v1 import render_service_pb2, render_service_pb2_grpc

    async with running(tmp_path, LONG, "1", "--drain-seconds", 600) as draining:
        draining.signal()
        while await draining.health() != NOT_SERVING:
            await asyncio.sleep(0.02)
        spec = render_pb2.RenderSpec(stage_path=str(tmp_path / "stage.usda"), width=16, height=16, spp=1)
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await render_service_pb2_grpc.RenderServiceStub(draining.channel).CreateRender(
                render_service_pb2.CreateRenderRequest(spec=spec), timeout=10
            )
        assert caught.value.code() == grpc.StatusCode.UNAVAILABLE
        draining.signal()
        assert await draining.exit_code(20) == 0


def test_a_file_system_that_hangs_does_not_keep_the_server_from_ending(tmp_path: Path) -> None:
    """Python would wait for the thread without end."""
    import subprocess
    import sys

    program = f"""
import asyncio, threading
from footlight_server import __main__ as server
server._LEAVING = 0.5
async def hang(launch):
    asyncio.get_running_loop().run_in_executor(None, threading.Event().wait)
    await asyncio.sleep(0.1)
server.serve = hang
server.main(["--listen", "127.0.0.1:0", "--data", "{tmp_path}/data"])
"""
    assert subprocess.run([sys.executable, "-c", program], timeout=20, check=False).returncode == 1


def test_two_servers_on_one_data_folder_are_refused(tmp_path: Path) -> None:
    import subprocess
    import sys

    with start("--data", tmp_path / "data") as server:
        command = [sys.executable, "-m", "footlight_server", "--listen", "127.0.0.1:0", "--data", f"{tmp_path}/data"]
        second = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        assert second.returncode == 2
        assert "Traceback" not in second.stderr
        refusal = second.stderr.splitlines()[-1]
        assert refusal.startswith("footlight-server: ")
        assert str(server.process.pid) in refusal
        assert server.process.poll() is None
