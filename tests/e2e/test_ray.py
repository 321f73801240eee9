"""A farm on a real Ray cluster of three nodes: the same bytes as locally, whatever part of it is killed."""

import contextlib
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from footlight import Client, render_spec
from footlight.jobs import Job
from footlight.submission import job_spec, layer_spec
from footlight.v1 import job_pb2
from tests.e2e.ray_cluster import Cluster, kill_node, lane_actors, own_address, three_nodes

pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(not own_address(), reason="this machine has no address but loopback, so no cluster of nodes"),
]

FRAMES = "1-5"


@pytest.fixture
def folder() -> Iterator[Path]:
    """A short path: sockets have to fit."""
    with tempfile.TemporaryDirectory(prefix="footlight-test-") as directory:
        yield Path(directory)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with tempfile.TemporaryDirectory(prefix="footlight-test-") as directory, three_nodes(Path(directory)) as cluster:
        yield cluster


@contextlib.contextmanager
def server(data: Path, *options: str) -> Iterator[tuple[Client, subprocess.Popen[str]]]:
    """A server with this data folder, and a client of it."""
    command = [sys.executable, "-m", "footlight_server", "--listen", f"unix:{data}.socket", "--data", str(data)]
    process = subprocess.Popen([*command, "--drain-seconds", "0", *options], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert select.select([process.stdout], [], [], 90)[0], "the server did not start"
        found = re.fullmatch(r"listening on (\S+)\n", process.stdout.readline())
        assert found is not None
        with Client(found[1]) as client:
            yield client, process
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()


def ray_options(cluster: Cluster) -> list[str]:
    """What `serve` needs to use the cluster."""
    named = zip(cluster.options[::2], cluster.options[1::2], strict=True)
    options = [part for name, value in named for part in (f"--ray-{name.removeprefix('--')}", value)]
    return ["--executor", "ray", "--ray-address", cluster.address, *options]


def shot(room: Path, spp: int, split: int = 1) -> job_pb2.JobSpec:
    """Five frames of a stage."""
    render = render_spec(room, size=(64, 48), spp=spp, seed=5, threads=1)
    return job_spec(layer_spec(render, frames=FRAMES, split=split))


def until(condition: Callable[[], bool], what: str, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


def digests(job: Job) -> dict[int, str]:
    return {frame.frame: frame.sha256 for frame in job.frames()}


@pytest.fixture(scope="module")
def locally(room: Path) -> dict[int, dict[int, str]]:
    """SHA-256 of each frame as this machine's own workers render them, at 64 samples per pixel and at 1500."""
    found = {}
    directory = tempfile.TemporaryDirectory(prefix="footlight-test-")
    with directory, server(Path(directory.name) / "data") as (client, _):
        for spp in (64, 1500):
            job = client.farm.submit(shot(room, spp))
            job.wait()
            found[spp] = digests(job)
    return found


def test_a_job_on_three_nodes_is_the_same_bytes_as_locally(
    folder: Path, cluster: Cluster, room: Path, locally: dict[int, dict[int, str]]
) -> None:
    with server(folder / "data", *ray_options(cluster)) as (client, _):
        assert {worker.name for worker in client.farm.workers()} == {"n1/1", "n2/1", "n3/1"}
        for split in (1, 3):
            job = client.farm.submit(shot(room, 64, split))
            job.wait()
            assert digests(job) == locally[64]
            workers = {attempt.worker for task in job.tasks() for attempt in job.attempts(task.name)}
            assert len(workers) >= 2


def test_a_running_frame_is_watched_through_the_cluster(folder: Path, cluster: Cluster, room: Path) -> None:
    with server(folder / "data", *ray_options(cluster)) as (client, _):
        job = client.farm.submit(shot(room, 1500))
        until(lambda: any(task.last_attempt.render for task in job.tasks(states=["running"])), "nothing runs")
        render = next(task.last_attempt.render for task in job.tasks(states=["running"]) if task.last_attempt.render)
        tiles = [tile for batch in client.session(render).events() if hasattr(batch, "tiles") for tile in batch.tiles]
        assert tiles
        assert max(tile.samples for tile in tiles) > 1
        assert all(tile.pixels.max() > 0 for tile in tiles if tile.samples)


def test_killed_workers_nodes_and_drivers_cost_time_and_nothing_else(
    folder: Path, cluster: Cluster, room: Path, locally: dict[int, dict[int, str]]
) -> None:
    data = folder / "data"
    with server(data, *ray_options(cluster)) as (client, process):
        first = client.farm.submit(shot(room, 1500))
        until(lambda: len(list(first.tasks(states=["running"]))) == 3, "three lanes do not run")
        until(lambda: len(lane_actors()) == 3, "three lanes are not held")
        os.kill(lane_actors()[0], signal.SIGKILL)
        until(lambda: "lost" in endings(first), "a killed Ray worker is not noticed", 15)
        kill_node(cluster.nodes["n3"])
        until(lambda: endings(first).count("lost") >= 2, "a killed node is not noticed", 15)
        second = client.farm.submit(shot(room, 1500))
        until(lambda: any(second.tasks(states=["running"])), "nothing runs")
        process.kill()
        process.wait()
    with server(data, *ray_options(cluster)) as (client, _):
        for name in (first.name, second.name):
            job = client.farm.job(name)
            job.wait()
            assert digests(job) == locally[1500]
            made = [event.frame.frame for event in job.events() if event.HasField("frame")]
            assert sorted(made) == [1, 2, 3, 4, 5], "a frame was lost, or recorded twice"
        assert "preempted" in endings(client.farm.job(second.name))


def endings(job: Job) -> list[str]:
    """How the attempts at its tasks have ended."""
    attempts = [attempt for task in job.tasks() for attempt in job.attempts(task.name)]
    classes = [job_pb2.ExitClass.Name(attempt.exit_class) for attempt in attempts if attempt.exit_class]
    return [name.removeprefix("EXIT_CLASS_").lower() for name in classes]
