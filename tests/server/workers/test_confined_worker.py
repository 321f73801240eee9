"""A confined worker renders as a trusted one does, to the bit, and is watched, read and ended as one."""

import asyncio
import hashlib
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from pxr import Sdf

from footlight.v1 import render_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.workers import pool as pools
from footlight_server.workers.film import Film
from footlight_server.workers.pool import WorkerPool
from footlight_server.workers.process import WorkerGoneError, WorkerProcess
from footlight_server.workers.sandbox import Sandbox, SandboxName
from tests.means import MEANS, require
from tests.server.api.service import STAGE

MEGABYTE = 1 << 20


@pytest.fixture
async def pool() -> AsyncIterator[WorkerPool]:
    pool = WorkerPool(0, spare=False)
    yield pool
    await pool.close()


@pytest.fixture(params=MEANS)
def means(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> SandboxName:
    """Stands in for what the machine would choose."""
    require(request.param)
    monkeypatch.setattr(pools, "choose_sandbox", lambda: Sandbox(request.param))
    chosen: SandboxName = request.param
    return chosen


def task_for(place: Path, text: str, *, confined: bool = True) -> worker_pb2.Task:
    """A render of a stage with this text, in folders of its own below `place`."""
    files, out = place / "files", place / "out"
    for folder in (files, out):
        folder.mkdir(parents=True, exist_ok=True)
    (files / "stage.usda").write_text(text)
    spec = render_pb2.RenderSpec(stage_path=str(files / "stage.usda"), width=96, height=80, spp=2, max_depth=3)
    spec.pixel_filter = render_pb2.PIXEL_FILTER_BOX
    spec.filter_width = 1.0
    spec.strategy = render_pb2.STRATEGY_MIS
    task = worker_pb2.Task(spec=spec, exr_path=str(out / "image.exr"), roots=[str(files)])
    if confined:
        task.confinement.read_paths.append(str(files))
        task.confinement.write_paths.append(str(out))
    return task


async def run(worker: WorkerProcess, task: worker_pb2.Task) -> tuple[worker_pb2.WorkerEvent, Film | None]:
    """The last thing the worker says, and the film it shows."""
    await worker.send(worker_pb2.WorkerRequest(task=task))
    film = None
    while True:
        event = await asyncio.wait_for(worker.receive(), 60)
        if event.HasField("film"):
            film = worker.open_film(event.film)
        if event.WhichOneof("event") in {"done", "failed"}:
            return event, film


async def take_and_run(pool: WorkerPool, task: worker_pb2.Task) -> worker_pb2.WorkerEvent:
    worker = await pool.take(task)
    try:
        return (await run(worker, task))[0]
    finally:
        await worker.close()


async def test_its_image_is_that_of_a_trusted_one(pool: WorkerPool, means: SandboxName, tmp_path: Path) -> None:
    digests, films = [], []
    for confined in (False, True):
        # In one place, since the image names its stage.
        task = task_for(tmp_path, STAGE, confined=confined)
        worker = await pool.take(task)
        try:
            assert task.confinement.outside is (confined and means is SandboxName.BUBBLEWRAP)
            event, film = await run(worker, task)
            assert event.HasField("done"), event.failed
            assert film is not None
            digests.append(hashlib.sha256(Path(task.exr_path).read_bytes()).hexdigest())
            films.append(film.planes["color"].tobytes())
            # Of the worker itself, and not of what it runs in.
            assert worker.peak_memory > 50 * MEGABYTE
        finally:
            await worker.close()
    assert digests[0] == digests[1]
    assert films[0] == films[1]
    assert any(films[1])


@pytest.mark.usefixtures("means")
async def test_its_crash_is_read_as_one(pool: WorkerPool, tmp_path: Path) -> None:
    """A text layer that only a crate file names is not looked at without a budget, and the parser dies of it."""
    task = task_for(tmp_path, '#usda 1.0\ndef "a" { float[] x = ' + "[" * 2_000_000)
    path = tmp_path / "files" / "top.usdc"
    layer = Sdf.Layer.CreateNew(str(path))
    Sdf.PrimSpec(layer, "a", Sdf.SpecifierDef).referenceList.Prepend(Sdf.Reference("./stage.usda"))
    layer.Save()
    task.spec.stage_path = str(path)
    with pytest.raises(WorkerGoneError, match="SIGSEGV"):
        await take_and_run(pool, task)


@pytest.mark.usefixtures("means")
async def test_its_memory_is_watched(tmp_path: Path) -> None:
    """From outside: the limit that it sets on itself would not be one for code that has taken it over."""
    pool = WorkerPool(50 * MEGABYTE, spare=False)  # less than it has when it is warm
    try:
        with pytest.raises(WorkerGoneError, match="passed its limit of memory"):
            await take_and_run(pool, task_for(tmp_path, STAGE))
    finally:
        await pool.close()


@pytest.mark.usefixtures("means")
async def test_nothing_of_it_outlives_its_end(pool: WorkerPool, tmp_path: Path) -> None:
    task = task_for(tmp_path, STAGE)
    worker = await pool.take(task)
    members = group_of(worker.pid)
    assert len(members) >= 1
    await worker.close()
    async with asyncio.timeout(5):
        while group_of(worker.pid):
            await asyncio.sleep(0.02)


def group_of(leader: int) -> list[int]:
    """Processes of a process group that run."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                state, _, group = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
            except OSError:
                continue  # it ended while we looked
            if int(group) == leader and state != "Z":
                found.append(int(entry.name))
    return found


HOLDER = """
import asyncio, sys
from footlight.worker.v1 import worker_pb2
from footlight_server.workers import pool as pools
from footlight_server.workers.sandbox import Sandbox, SandboxName
pools.choose_sandbox = lambda: Sandbox(SandboxName(sys.argv[1]))
async def main():
    task = worker_pb2.Task(confinement=worker_pb2.Confinement(write_paths=[sys.argv[2]]))
    worker = await pools.WorkerPool(0, spare=False).take(task)
    print(worker.pid, flush=True)
    await asyncio.sleep(60)
asyncio.run(main())
"""


@pytest.mark.parametrize("means", MEANS)
def test_it_dies_with_a_server_that_is_killed(means: SandboxName, tmp_path: Path) -> None:
    require(means)
    command = [sys.executable, "-c", HOLDER, means, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        leader = int(holder.stdout.readline())
        assert group_of(leader)
        holder.send_signal(signal.SIGKILL)
        holder.wait(10)
    for _ in range(250):
        if not group_of(leader):
            return
        time.sleep(0.02)
    raise AssertionError(f"{group_of(leader)} live on")


async def test_where_nothing_confines_it_is_refused(
    pool: WorkerPool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pools, "choose_sandbox", lambda: Sandbox(SandboxName.NONE, "no means"))
    task = task_for(tmp_path, STAGE)
    # Whoever made the task cannot say that it was done already.
    task.confinement.outside = True
    with pytest.raises(WorkerGoneError, match="no means"):
        await pool.take(task)
    trusted = task_for(tmp_path, STAGE, confined=False)
    worker = await pool.take(trusted)
    await worker.close()


async def test_what_a_task_says_of_its_sandbox_is_not_believed(
    pool: WorkerPool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pools, "choose_sandbox", lambda: Sandbox(SandboxName.LANDLOCK))
    task = task_for(tmp_path, STAGE)
    task.confinement.outside = True
    worker = await pool.take(task)
    await worker.close()
    assert not task.confinement.outside
