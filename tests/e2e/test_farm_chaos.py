"""Parts of a farm are killed, filled up and locked while it works: every job ends well and no frame is made twice."""

import contextlib
import hashlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from footlight import Client, job_spec, layer_spec, render_spec
from footlight.v1 import job_pb2
from tests.e2e.conftest import alive, descendants
from tests.e2e.farm_server import FarmServer, farm_server

# [s] For any job here to end, on a machine that has much else to do.
PATIENCE = 120.0
KILLS = 5


def submit(server: FarmServer, spec: job_pb2.JobSpec) -> str:
    with Client(server.address) as client:
        return client.farm.submit(spec).name


def ended(server: FarmServer, name: str) -> job_pb2.Job:
    """The job once it has ended."""
    deadline = time.monotonic() + PATIENCE
    while True:
        with Client(server.address) as client:
            job = client.farm.job(name).get()
        if job.HasField("end_time"):
            return job
        assert time.monotonic() < deadline, server.said()[-3000:]
        time.sleep(0.2)


def has_ended(server: FarmServer, name: str) -> bool:
    with Client(server.address) as client:
        return bool(client.farm.job(name).get().HasField("end_time"))


def frames(server: FarmServer, name: str) -> dict[tuple[str, int], job_pb2.Frame]:
    with Client(server.address) as client:
        return {(frame.layer, frame.frame): frame for frame in client.farm.job(name).frames()}


def attempts(server: FarmServer, name: str) -> list[job_pb2.Attempt]:
    """Of all tasks."""
    with Client(server.address) as client:
        job = client.farm.job(name)
        return [attempt for task in job.tasks() for attempt in job.attempts(task.name)]


def failed_tasks(server: FarmServer, name: str) -> list[job_pb2.Task]:
    """That wait to be tried again."""
    with Client(server.address) as client:
        return [task for task in client.farm.job(name).tasks() if task.failures and task.HasField("not_before")]


def classes(server: FarmServer, name: str) -> set[str]:
    """How attempts ended, without the prefix."""
    found = {job_pb2.ExitClass.Name(attempt.exit_class) for attempt in attempts(server, name)}
    return {word.removeprefix("EXIT_CLASS_") for word in found}


def wait_for(holds: Callable[[], object], within: float = 60.0) -> None:
    deadline = time.monotonic() + within
    while not holds():
        assert time.monotonic() < deadline, "it did not come about"
        time.sleep(0.05)


def all_gone(processes: list[int]) -> bool:
    return not any(alive(process) for process in processes)


def marks(made: dict[tuple[str, int], job_pb2.Frame]) -> dict[str, tuple[int, int, str]]:
    """By path: what would change if the file were made again, and its digest."""
    found = {}
    for frame in made.values():
        path = Path(frame.path)
        found[frame.path] = path.stat().st_ino, path.stat().st_mtime_ns, frame.sha256
    return found


def check_images(made: dict[tuple[str, int], job_pb2.Frame]) -> None:
    for frame in made.values():
        assert hashlib.sha256(Path(frame.path).read_bytes()).hexdigest() == frame.sha256


def hidden(*folders: Path) -> list[Path]:
    """What half-finished work would leave."""
    return [path for folder in folders for path in folder.rglob(".*") if path.name.startswith(".footlight")]


def chaos_job(room: Path, out: Path) -> job_pb2.JobSpec:
    """Chunks, single frames and a split frame, some seconds of work."""
    small = render_spec(room, size=(64, 48), spp=96, threads=1)
    chunks = layer_spec(small, name="chunks", frames="1-6", chunk=3, output=out / "chunks.####.exr")
    single = layer_spec(small, name="single", frames="1-3", output=out / "single.$F4.exr")
    split = layer_spec(small, name="split", frames="1", split=3, output=out / "split.<frame>.exr")
    return job_spec(chunks, single, split, retries=100)


def check_all(server: FarmServer, name: str, out: Path) -> None:
    """The job has succeeded with all its images, and nothing else is left."""
    assert ended(server, name).state == job_pb2.JOB_STATE_SUCCEEDED, classes(server, name)
    made = frames(server, name)
    assert len(made) == 10
    check_images(made)
    digests = {(layer, number): frame.sha256 for (layer, number), frame in made.items()}
    assert digests["single", 1] == digests["chunks", 1] == digests["split", 1], "one image, however it was made"
    assert sorted(path.name for path in out.iterdir()) == sorted(Path(frame.path).name for frame in made.values())
    assert hidden(out, server.data) == []


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_killing_the_server_again_and_again(tmp_path: Path, room: Path, out: Path) -> None:
    chance = random.Random(1)
    with farm_server(tmp_path, "--farm-workers", 2) as server:
        name = submit(server, chaos_job(room, out))
        for _ in range(KILLS):
            time.sleep(chance.uniform(0.5, 3.0))
            below = descendants(server.pid)
            done = marks(frames(server, name))
            server.kill()
            wait_for(partial(all_gone, below), 10)
            server.start()
            again = marks(frames(server, name))
            assert {path: again[path] for path in done} == done, "a finished frame was made again"
        done = marks(frames(server, name))
        check_all(server, name, out)
        after = marks(frames(server, name))
        assert {path: after[path] for path in done} == done
        assert classes(server, name) <= {"SUCCEEDED", "PREEMPTED"}


def test_killing_workers_again_and_again(tmp_path: Path, room: Path, out: Path) -> None:
    chance = random.Random(2)
    with farm_server(tmp_path, "--farm-workers", 2) as server:
        name = submit(server, chaos_job(room, out))
        killed = 0
        done: dict[str, tuple[int, int, str]] = {}
        while killed < KILLS and not has_ended(server, name):
            time.sleep(chance.uniform(0.3, 1.0))
            now = marks(frames(server, name))
            assert {path: now[path] for path in done} == done
            done = now
            workers = descendants(server.pid)
            if workers:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(chance.choice(workers), signal.SIGKILL)
                    killed += 1
        check_all(server, name, out)
        assert classes(server, name) <= {"SUCCEEDED", "CRASH", "LOST"}


@contextlib.contextmanager
def disk(place: Path, size: str) -> Iterator[Path]:
    """A file system of its own, of that size."""
    place.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size},mode=700", "footlight-test", place], check=True)
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", place], check=True)


def fill(place: Path) -> Path:
    """A file that takes all the room there is."""
    filler = place / "filler"
    with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(1 << 12))
    return filler


pytestmark = pytest.mark.slow
needs_mount = pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a small disk")


@needs_mount
def test_a_full_disk_of_the_images_is_waited_for(tmp_path: Path, room: Path) -> None:
    with disk(tmp_path / "small", "2m") as small, farm_server(tmp_path, "--farm-workers", 1) as server:
        filler = fill(small)
        layer = layer_spec(render_spec(room, size=(64, 48), spp=2), frames="1-3", output=small / "a.####.exr")
        name = submit(server, job_spec(layer, retries=100))
        wait_for(lambda: "OUTPUT" in classes(server, name))
        said = next(attempt.message for attempt in attempts(server, name) if attempt.message)
        assert "no space left" in said.lower()
        filler.unlink()
        assert ended(server, name).state == job_pb2.JOB_STATE_SUCCEEDED
        check_images(frames(server, name))
        assert sorted(path.name for path in small.iterdir()) == ["a.0001.exr", "a.0002.exr", "a.0003.exr"]


@needs_mount
def test_a_full_disk_of_the_queue_is_waited_for(tmp_path: Path, room: Path, out: Path) -> None:
    with disk(tmp_path / "data", "8m") as data, farm_server(tmp_path, "--farm-workers", 1) as server:
        layer = layer_spec(render_spec(room, size=(64, 48), spp=64, threads=1), frames="1-3", output=out / "a.####.exr")
        name = submit(server, job_spec(layer, retries=100))
        wait_for(lambda: len(frames(server, name)) >= 1)
        done = marks(frames(server, name))
        filler = fill(data)
        time.sleep(4)
        filler.unlink()
        assert ended(server, name).state == job_pb2.JOB_STATE_SUCCEEDED
        made = frames(server, name)
        check_images(made)
        assert {path: marks(made)[path] for path in done} == done
        assert hidden(out) == []


def test_a_locked_database_delays_and_loses_nothing(tmp_path: Path, room: Path, out: Path) -> None:
    with farm_server(tmp_path, "--farm-workers", 1) as server:
        layer = layer_spec(render_spec(room, size=(64, 48), spp=64, threads=1), frames="1-3", output=out / "a.####.exr")
        name = submit(server, job_spec(layer))
        wait_for(lambda: len(frames(server, name)) >= 1)
        with contextlib.closing(sqlite3.connect(server.data / "queue.db", isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            time.sleep(7)
            assert not has_ended(server, name), "and reading goes on"
            other.execute("ROLLBACK")
        assert ended(server, name).state == job_pb2.JOB_STATE_SUCCEEDED
        assert classes(server, name) == {"SUCCEEDED"}
        check_images(frames(server, name))


# The server with a clock that somebody sets: its offset [s] stands in a file.
SET_CLOCK = """
import sys, time
from pathlib import Path
offset, real = Path(sys.argv.pop(1)), time.time
time.time = lambda: real() + float(offset.read_text())
from footlight_server.__main__ import main
main()
"""


def test_a_clock_that_is_set_neither_loses_tasks_nor_starts_a_storm(tmp_path: Path, room: Path, out: Path) -> None:
    offset = tmp_path / "offset"
    offset.write_text("0")
    with farm_server(tmp_path, "--farm-workers", 1, program=(sys.executable, "-c", SET_CLOCK, offset)) as server:
        layer = layer_spec(render_spec(room, size=(64, 48), spp=64, threads=1), frames="1-4", output=out / "a.####.exr")
        name = submit(server, job_spec(layer, retries=100))
        wait_for(lambda: frames(server, name))
        # A failure, which is tried again after a pause, and meanwhile it becomes another day.
        for jump in (-86400, 86400):
            out.rename(tmp_path / "away")
            wait_for(lambda: failed_tasks(server, name))
            offset.write_text(str(jump))
            (tmp_path / "away").rename(out)
        assert ended(server, name).state == job_pb2.JOB_STATE_SUCCEEDED
        check_images(frames(server, name))
        assert len(attempts(server, name)) < 20, "a storm"


def test_a_second_server_on_the_same_database_is_refused(tmp_path: Path, room: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    with farm_server(tmp_path / "one", "--farm-workers", 1) as server:
        database = f"sqlite:///{server.data / 'queue.db'}"
        name = submit(server, job_spec(layer_spec(render_spec(room, size=(32, 32), spp=4), frames="1-2")))
        for options in ([], ["--database", database]):
            second = FarmServer(tmp_path / ("two" if options else "one"), "--farm-workers", 1, *options)
            with pytest.raises(AssertionError):
                second.start()
            second.close()
            assert any(word in second.said() for word in ("in use", "owns", "another server")), second.said()[-500:]
        assert ended(server, name).state == job_pb2.JOB_STATE_SUCCEEDED


def test_a_client_that_goes_away_takes_nothing_with_it(tmp_path: Path, room: Path, out: Path) -> None:
    program = """
import os, sys
from footlight import Client, job_spec, layer_spec, render_spec
client = Client(sys.argv[1])
layer = layer_spec(render_spec(sys.argv[2], size=(64, 48), spp=200), frames="1-2", output=sys.argv[3])
job = client.farm.submit(job_spec(layer))
print(job.name, flush=True)
for event in job.events():
    if event.HasField("task") and event.task.state == 3:
        os.kill(os.getpid(), 9)
"""
    with farm_server(tmp_path, "--farm-workers", 1) as server:
        command = [sys.executable, "-c", program, server.address, str(room), str(out / "a.####.exr")]
        gone = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert gone.returncode == -signal.SIGKILL, gone.stderr
        name = gone.stdout.strip()
        assert ended(server, name).state == job_pb2.JOB_STATE_SUCCEEDED
        check_images(frames(server, name))
