"""What it costs that many watch a job, two of whom never read: render time, delay of events, memory of the server.

As a program it is the watchers: python tests/bench/watchers.py ADDRESS JOB COUNT SILENT
"""

import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import grpc

from footlight.v1 import job_pb2, job_service_pb2, job_service_pb2_grpc, render_pb2

# A client that takes no more than one message ahead: who never reads stops the stream as early as can be.
_NARROW = (("grpc.http2.bdp_probe", 0), ("grpc.http2.lookahead_bytes", 1024))
# [frames] That are rendered, and that are skipped on the way: a burst of large events, for the silent.
_FRAMES = 6
_SKIPPED, _CHUNK = 60_000, 400
# [s] For everything.
_PATIENCE = 300.0


@dataclass(frozen=True, slots=True)
class Seen:
    """What those who read have seen: how many to the end, [messages] each, [s] from the event to its arrival."""

    ended: int
    messages: list[int]
    delays: list[float]


@dataclass(frozen=True, slots=True)
class Run:
    """One job: [s] of rendering its frames, what the watchers saw, [bytes] that the server grew by."""

    render_seconds: float
    seen: Seen | None
    grown: int


class FarmProcess:
    """A server process with one lane, and a stub."""

    def __init__(self, address: str, pid: int) -> None:
        self.address = address
        self.pid = pid
        self.jobs = job_service_pb2_grpc.JobServiceStub(grpc.insecure_channel(address))

    def run(self, stage: Path, watchers: int, silent: int) -> Run:
        """Render some frames, watched by so many."""
        render = render_pb2.RenderSpec(stage_path=str(stage), camera_path="/World/Camera", width=256, height=256, spp=8)
        needs = [job_pb2.LayerDependency(layer="main")]
        layers = [
            job_pb2.LayerSpec(name="main", render=render, frames=f"1-{_FRAMES}"),
            job_pb2.LayerSpec(name="skipped", render=render, frames=f"1-{_SKIPPED}", chunk=_CHUNK, depends=needs),
        ]
        spec = job_pb2.JobSpec(layers=layers, paused=True)
        name = self.jobs.CreateJob(job_service_pb2.CreateJobRequest(spec=spec), timeout=30).job.name
        before = resident(self.pid)
        swarm = start_swarm(self.address, name, watchers, silent) if watchers else None
        self.jobs.ResumeJob(job_service_pb2.ResumeJobRequest(name=name), timeout=30)
        skipped = False
        while (job := self._get(name)).state not in (job_pb2.JOB_STATE_SUCCEEDED, job_pb2.JOB_STATE_FAILED):
            if not skipped and job.frames_done >= _FRAMES // 2:
                choice = job_service_pb2.TaskSelection(layer="skipped")
                self.jobs.SkipTasks(job_service_pb2.SkipTasksRequest(job=name, selection=choice), timeout=30)
                skipped = True
            time.sleep(0.2)
        if job.state != job_pb2.JOB_STATE_SUCCEEDED:
            raise RuntimeError(f"the job ended as {job_pb2.JobState.Name(job.state)}")
        seen = Seen(**json.loads(swarm.communicate(timeout=_PATIENCE)[0])) if swarm is not None else None
        return Run(self._render_seconds(name), seen, resident(self.pid) - before)

    def _get(self, name: str) -> job_pb2.Job:
        response: job_service_pb2.GetJobResponse = self.jobs.GetJob(
            job_service_pb2.GetJobRequest(name=name), timeout=30
        )
        return response.job

    def _render_seconds(self, name: str) -> float:
        frames = self.jobs.ListFrames(job_service_pb2.ListFramesRequest(job=name), timeout=30).frames
        return float(sum(frame.stats.seconds.render for frame in frames))


@contextmanager
def farm_process() -> Iterator[FarmProcess]:
    """A server with a queue and one lane."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "footlight_server", "--listen", "127.0.0.1:0", "--data", f"{folder}/data"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert process.stdout is not None
        try:
            yield FarmProcess(process.stdout.readline().split()[-1], process.pid)
        finally:
            process.terminate()
            process.wait(30)


@dataclass(frozen=True, slots=True)
class Round:
    """The same job: watched by nobody, by some who read, and by two more who never do."""

    alone: Run
    readers: Run
    silent: Run


def rounds(stage: Path, count: int, readers: int, silent: int) -> Iterator[Round]:
    """In turns; the first job, unwatched, is not counted."""
    with farm_process() as farm:
        farm.run(stage, 0, 0)
        for _ in range(count):
            yield Round(farm.run(stage, 0, 0), farm.run(stage, readers, 0), farm.run(stage, readers + silent, silent))


def start_swarm(address: str, job: str, watchers: int, silent: int) -> "subprocess.Popen[str]":
    """The watchers, each with a connection of its own, once all of them watch.

    They are niced, because they stand for other machines.
    """
    command = ["nice", "-n", "19", sys.executable, __file__, address, job, str(watchers), str(silent)]
    swarm = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert swarm.stdout is not None
    if swarm.stdout.readline().strip() != "watching":
        raise RuntimeError("the watchers did not start")
    return swarm


def resident(pid: int) -> int:
    """[bytes] Of memory a process holds."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


async def watch(address: str, job: str, watchers: int, silent: int) -> Seen:
    """Watch, and tell what came."""
    calls, channels = [], []
    for number in range(watchers):
        channel = grpc.aio.insecure_channel(address, options=(*_NARROW, ("grpc.use_local_subchannel_pool", 1)))
        request = job_service_pb2.WatchJobRequest(name=job)
        call = job_service_pb2_grpc.JobServiceStub(channel).WatchJob(request, timeout=_PATIENCE)
        await call.read()
        channels.append(channel)
        calls.append((number >= silent, call))
    print("watching", flush=True)
    read = await asyncio.gather(*(_read(call) for reads, call in calls if reads))
    for _, call in calls:
        call.cancel()
    for channel in channels:
        await channel.close()
    delays = [delay for _, _, some in read for delay in some]
    return Seen(sum(ended for ended, _, _ in read), [messages for _, messages, _ in read], delays)


async def _read(call: grpc.aio.UnaryStreamCall) -> tuple[bool, int, list[float]]:
    """Whether the job was seen to end, [messages], and [s] that each recorded event was on the way."""
    messages, delays, ended = 1, [], False
    while (response := await call.read()) is not grpc.aio.EOF:
        messages += 1
        event = response.event
        if event.id:
            delays.append(time.time() - event.time.ToNanoseconds() / 1e9)
        ended = event.changed.state == job_pb2.JOB_STATE_SUCCEEDED
    return ended, messages, delays


def percentile(values: list[float], share: float) -> float:
    """That share of the values is not above it."""
    return statistics.quantiles(values, n=1000)[round(share * 1000) - 1]


if __name__ == "__main__":
    print(json.dumps(asdict(asyncio.run(watch(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))))))
