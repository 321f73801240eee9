"""What Prometheus reads: the numbers are those of what was done, no more and no less."""

import json
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import grpc
import pytest
from prometheus_client.parser import text_string_to_metric_families

from footlight.v1 import (
    blob_service_pb2,
    blob_service_pb2_grpc,
    job_pb2,
    job_service_pb2,
    job_service_pb2_grpc,
    render_pb2,
)
from footlight_server.blobs.digest import digest_of
from tests.server.api.service import STAGE, Server, start

WIDTH, HEIGHT, SPP, FRAMES = 32, 24, 4, 3


def scrape(url: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """Value by name and labels."""
    with urllib.request.urlopen(url, timeout=10) as response:
        families = text_string_to_metric_families(response.read().decode())
        return {
            (sample.name, tuple(sorted(sample.labels.items()))): sample.value
            for family in families
            for sample in family.samples
        }


class Numbers:
    """Those of a server."""

    def __init__(self, url: str) -> None:
        self.url = url

    def __call__(self, name: str, **labels: str) -> float:
        return scrape(self.url).get((f"footlight_{name}", tuple(sorted(labels.items()))), 0.0)

    def until(self, holds: Callable[[], bool], within: float = 15.0) -> None:
        """The gauges are looked at every five seconds."""
        deadline = time.monotonic() + within
        while not holds():
            assert time.monotonic() < deadline, scrape(self.url)
            time.sleep(0.2)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Server, Numbers]]:
    log = tmp_path_factory.mktemp("metrics") / "log"
    with start("--metrics", "127.0.0.1:0", "--farm-workers", 2, stderr=log) as server:
        found = re.search(r"metrics at (http://127.0.0.1:\d+/metrics)", log.read_text())
        assert found is not None
        yield server, Numbers(found[1])


def render_job(address: str, stage: Path, **layer: object) -> None:
    """Submit, and wait for the end."""
    stage.write_text(STAGE)
    spec = render_pb2.RenderSpec(stage_path=str(stage), width=WIDTH, height=HEIGHT, spp=SPP)
    job = job_pb2.JobSpec(layers=[job_pb2.LayerSpec(render=spec, **layer)])
    with grpc.insecure_channel(address) as channel:
        jobs = job_service_pb2_grpc.JobServiceStub(channel)
        name = jobs.CreateJob(job_service_pb2.CreateJobRequest(spec=job), timeout=10).job.name
        for _ in jobs.WatchJob(job_service_pb2.WatchJobRequest(name=name), timeout=60):
            pass
        assert (
            jobs.GetJob(job_service_pb2.GetJobRequest(name=name), timeout=10).job.state == job_pb2.JOB_STATE_SUCCEEDED
        )


def test_a_job_is_counted_once(watched: tuple[Server, Numbers], tmp_path: Path) -> None:
    server, numbers = watched
    render_job(server.address, tmp_path / "stage.usda", frames=f"1-{FRAMES}")
    assert numbers("frames_total") == FRAMES
    assert numbers("attempts_total", exit_class="succeeded") == FRAMES
    assert numbers("attempt_seconds_count") == FRAMES
    assert numbers("samples_total") == FRAMES * WIDTH * HEIGHT * SPP
    assert numbers("rays_total", kind="closest") >= numbers("samples_total")
    assert numbers("calls_total", method="/footlight.v1.JobService/CreateJob", code="OK") == 1
    assert numbers("call_seconds_count", method="/footlight.v1.JobService/WatchJob") == 1

    # Cut into ranges of samples, it is the same samples and the same images.
    render_job(server.address, tmp_path / "stage.usda", frames="1", split=2)
    assert numbers("frames_total") == FRAMES + 1
    assert numbers("samples_total") == (FRAMES + 1) * WIDTH * HEIGHT * SPP
    assert numbers("attempts_total", exit_class="succeeded") == FRAMES + 3

    numbers.until(lambda: numbers("tasks", state="succeeded") == FRAMES + 3)
    assert numbers("tasks", state="ready") == 0
    assert numbers("lanes") == 2
    numbers.until(lambda: numbers("lanes_busy") == 0)


def test_calls_that_fail_are_counted_by_their_code(watched: tuple[Server, Numbers]) -> None:
    server, numbers = watched
    method = "/footlight.v1.JobService/GetJob"
    with grpc.insecure_channel(server.address) as channel:
        jobs = job_service_pb2_grpc.JobServiceStub(channel)
        for name in ("jobs/999999", "jobs/999998"):
            with pytest.raises(grpc.RpcError):
                jobs.GetJob(job_service_pb2.GetJobRequest(name=name), timeout=10)
    numbers.until(lambda: numbers("calls_total", method=method, code="NOT_FOUND") == 2)


def test_calls_that_are_given_up_are_counted_as_cancelled(watched: tuple[Server, Numbers], tmp_path: Path) -> None:
    server, numbers = watched
    method = "/footlight.v1.JobService/WatchJob"
    stage = tmp_path / "stage.usda"
    stage.write_text(STAGE)
    layer = job_pb2.LayerSpec(render=render_pb2.RenderSpec(stage_path=str(stage)))
    with grpc.insecure_channel(server.address) as channel:
        jobs = job_service_pb2_grpc.JobServiceStub(channel)
        spec = job_pb2.JobSpec(layers=[layer], paused=True)
        name = jobs.CreateJob(job_service_pb2.CreateJobRequest(spec=spec), timeout=10).job.name
        stream = jobs.WatchJob(job_service_pb2.WatchJobRequest(name=name), timeout=60)
        next(stream)
        stream.cancel()
        numbers.until(lambda: numbers("calls_total", method=method, code="CANCELLED") == 1)
        jobs.CancelJob(job_service_pb2.CancelJobRequest(name=name), timeout=10)


def test_workers_uploads_and_the_loop_are_looked_at(watched: tuple[Server, Numbers]) -> None:
    server, numbers = watched
    data = b"x" * 10_000
    digest = digest_of(data)
    blob = blob_service_pb2.UploadedBlob(
        digest=blob_service_pb2.Digest(sha256=digest.sha256, size_bytes=digest.size), data=data
    )
    with grpc.insecure_channel(server.address) as channel:
        uploads = blob_service_pb2_grpc.BlobServiceStub(channel)
        uploads.UploadBlobs(blob_service_pb2.UploadBlobsRequest(blobs=[blob]), timeout=10)
    numbers.until(lambda: 10_000 <= numbers("blob_bytes") < 20_000)
    # One is kept warm at least, with USD loaded.
    numbers.until(lambda: numbers("worker_processes") >= 1 and numbers("worker_memory_bytes") > 20e6)
    numbers.until(lambda: numbers("loop_lag_seconds_count") > 5)
    assert numbers("loop_lag_seconds_sum") / numbers("loop_lag_seconds_count") < 0.5


def test_only_this_machine_is_told(watched: tuple[Server, Numbers]) -> None:
    _, numbers = watched
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(numbers.url.replace("127.0.0.1", "127.0.0.2"), timeout=5)


def test_a_log_as_json_is_an_object_per_line_with_what_it_is_about(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with start("--log-format", "json", "--verbose", stderr=log) as server:
        render_job(server.address, tmp_path / "stage.usda")
    records = [json.loads(line) for line in log.read_text().splitlines()]
    assert {"time", "level", "logger", "message"} <= set.intersection(*(set(record) for record in records))
    assert [record["level"] for record in records if record["message"] == "stopping"] == ["INFO"]
    (ended,) = [record for record in records if "exit_class" in record]
    assert (ended["job"], ended["task"], ended["attempt"], ended["exit_class"]) == (1, 1, 1, "succeeded")
    assert ended["lane"].endswith("/1")
    assert ended["seconds"] > 0
    calls = {record["method"]: record["code"] for record in records if "code" in record}
    assert calls["/footlight.v1.JobService/CreateJob"] == "OK"


def test_an_address_that_is_taken_is_named(watched: tuple[Server, Numbers], tmp_path: Path) -> None:
    _, numbers = watched
    address = numbers.url.removeprefix("http://").removesuffix("/metrics")
    command = [sys.executable, "-m", "footlight_server", "--metrics", address, "--data", f"{tmp_path}/data"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert result.returncode == 2
    assert f"--metrics {address}: Address already in use" in result.stderr
