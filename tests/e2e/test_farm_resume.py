"""Whoever watches goes on when the line breaks, and when the server is killed and comes back."""

import asyncio
import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from footlight import AsyncClient, Client, LiveImage, TileBatch, job_spec, layer_spec, render_spec
from footlight.cli.exits import Exit
from footlight.errors import JobCancelledError, JobFailedError, RenderNotFoundError, ServerUnavailableError
from footlight.resume import Patience
from footlight.v1 import job_pb2, render_pb2
from tests.e2e.conftest import FOOTLIGHT
from tests.e2e.farm_server import FarmServer, Wire, farm_server


@pytest.fixture(scope="module")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FarmServer]:
    with farm_server(tmp_path_factory.mktemp("farm"), "--farm-workers", 1, "--drain-seconds", 0, tcp=True) as server:
        yield server


@pytest.fixture(autouse=True)
def idle(farm: FarmServer) -> Iterator[None]:
    """A test that fails leaves nothing running that the next would wait for."""
    yield
    if not farm.running:
        farm.start()
    with Client(farm.address) as client:
        for job in client.farm.jobs(states=["queued", "running"]):
            client.farm.job(job.name).cancel()


@pytest.fixture
def wire(farm: FarmServer) -> Iterator[Wire]:
    wire = Wire(farm.tcp)
    yield wire
    wire.close()


def spec(room: Path, frames: str = "1-4", spp: int = 300, camera: str = "", *, paused: bool = False) -> job_pb2.JobSpec:
    render = render_spec(room, size=(48, 48), spp=spp, threads=1, camera=camera)
    return job_spec(layer_spec(render, frames=frames), paused=paused)


def test_watch_goes_on_after_the_server_was_killed(farm: FarmServer, room: Path, tmp_path: Path) -> None:
    with Client(farm.address) as client:
        job = client.farm.submit(spec(room)).name
    output = tmp_path / "events"
    with (
        output.open("w") as stdout,
        subprocess.Popen(
            [FOOTLIGHT, "watch", job, "--server", farm.address, "--json"],
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
        ) as watching,
    ):
        try:
            deadline = time.monotonic() + 60
            while '"frame": {"layer"' not in output.read_text():  # one is done, three are not
                assert time.monotonic() < deadline
                time.sleep(0.02)
            farm.kill()
            time.sleep(0.5)
            farm.start()
            _, said = watching.communicate(timeout=60)
        finally:
            watching.kill()
    assert watching.returncode == Exit.OK, said
    assert "trying again" in said
    events = [json.loads(line) for line in output.read_text().splitlines()]
    ids = [event["id"] for event in events if event["id"]]
    assert ids == sorted(set(ids))  # none twice
    frames = [event["frame"]["frame"] for event in events if event["frame"]]
    assert sorted(frames) == [1, 2, 3, 4]
    assert events[-1]["changed"]["state"] == "JOB_STATE_SUCCEEDED"
    tasks = [event["task"]["state"] for event in events if event["task"]]
    assert tasks.count("TASK_STATE_SUCCEEDED") == 4


def test_a_cut_line_costs_a_render_nothing(wire: Wire, room: Path) -> None:
    live, cuts, states = LiveImage(), 0, []
    with Client(wire.address) as client:
        session = client.submit(render_spec(room, size=(96, 96), spp=400, threads=1))
        for event in session.events(exact=True):
            if isinstance(event, TileBatch):
                live.add(event)
                if cuts < 3:
                    cuts += 1
                    wire.cut()
            elif isinstance(event, render_pb2.Render):
                states.append(event.state)
        assert states[-1] == render_pb2.RENDER_STATE_SUCCEEDED
        fresh = LiveImage()
        for event in session.events(exact=True):
            if isinstance(event, TileBatch):
                fresh.add(event)
    assert cuts == 3
    assert wire.connections >= 4
    assert live.pixels["color"].tobytes() == fresh.pixels["color"].tobytes()


async def test_the_same_with_asyncio(wire: Wire, room: Path) -> None:
    cuts, ended = 0, None
    async with asyncio.timeout(60), AsyncClient(wire.address) as client:
        session = await client.submit(render_spec(room, size=(96, 96), spp=400, threads=1))
        async for event in session.events():
            if isinstance(event, TileBatch) and cuts < 3:
                cuts += 1
                wire.cut()
            elif isinstance(event, render_pb2.Render):
                ended = event.state
    assert cuts == 3
    assert ended == render_pb2.RENDER_STATE_SUCCEEDED


def test_a_render_ends_with_its_server(farm: FarmServer, room: Path) -> None:
    with Client(farm.address) as client:
        session = client.submit(render_spec(room, size=(96, 96), spp=1 << 20, threads=1))
        events = session.events(())
        next(events)
        farm.kill()
        farm.start()
        with pytest.raises(RenderNotFoundError):
            list(events)


def test_patience_has_an_end(farm: FarmServer, room: Path) -> None:
    told: list[str] = []
    with Client(farm.address) as client:
        job = client.farm.submit(spec(room, spp=1 << 20))
        events = job.events(patience=Patience(1.0, lambda error: told.append(str(error))))
        next(events)
        farm.kill()
        started = time.monotonic()
        with pytest.raises(ServerUnavailableError, match="no Footlight server answers"):
            list(events)
        assert 1 <= time.monotonic() - started < 10
        assert len(told) == 1
        farm.start()
        assert job.cancel().state in (job_pb2.JOB_STATE_CANCELLING, job_pb2.JOB_STATE_CANCELLED)


def test_cut_lines_lose_no_event_no_log_and_no_byte(wire: Wire, farm: FarmServer, room: Path) -> None:
    with Client(wire.address) as client, Client(farm.address) as straight:
        job = client.farm.submit(spec(room, frames="1-3", spp=100))
        seen: list[job_pb2.JobEvent] = []
        for event in job.events():
            seen.append(event)
            if event.HasField("frame"):
                wire.cut()
        assert [event.frame.frame for event in seen if event.HasField("frame")] == [1, 2, 3]
        assert job.wait().state == job_pb2.JOB_STATE_SUCCEEDED
        assert wire.connections >= 4
        task = next(job.tasks()).name
        log, image = [], []
        for piece in job.log(task):
            log.append(piece)
            wire.cut()
        for piece in job.pieces(2):
            image.append(piece)
            wire.cut()
        same = straight.farm.job(job.name)
        assert b"".join(log) == b"".join(same.log(task))
        assert b"".join(image) == same.image(2)


async def test_a_job_with_asyncio(farm: FarmServer, room: Path, tmp_path: Path) -> None:
    async with asyncio.timeout(120), AsyncClient(farm.address) as client:
        job = await client.farm.submit(spec(room, frames="1-2", spp=4))
        assert (await job.wait()).frames_done == 2
        assert (await job.get()).name in [known.name for known in await client.farm.jobs()]
        assert [task.frames[0] async for task in job.tasks()] == [1, 2]
        assert [frame.frame async for frame in job.frames()] == [1, 2]
        assert (await job.attempts(f"{job.name}/tasks/1"))[0].exit_class == job_pb2.EXIT_CLASS_SUCCEEDED
        assert b"".join([piece async for piece in job.log(f"{job.name}/tasks/1")]).endswith(b"ended: succeeded\n")
        await job.save(tmp_path / "a.exr", 1)
        assert (tmp_path / "a.exr").read_bytes() == await job.image(1)
        assert (await job.image(1, image_format="thumbnail")).startswith(b"\x89PNG")
        assert await job.why() == []

        failing = await client.farm.submit(spec(room, camera="/World/Nobody"))
        with pytest.raises(JobFailedError, match=r"4 tasks failed.*/World/Nobody") as failed:
            await failing.wait()
        assert len(failed.value.tasks) == 3
        assert await failing.retry(frames="1") == 1
        assert await failing.skip(layer="main") > 0

        waiting = await client.farm.submit(spec(room, spp=1 << 20, paused=True))
        assert (await waiting.pause()).paused
        assert await waiting.why()
        assert not (await waiting.resume()).paused
        await waiting.cancel()
        with pytest.raises(JobCancelledError):
            await waiting.wait()
        pruned = await client.farm.prune([waiting.name])
        assert list(pruned.jobs) == [waiting.name]
        assert (await client.farm.set_limit("a", 2)).most == 2
        assert [limit.name for limit in await client.farm.limits()] == ["a"]
        assert len(await client.farm.workers()) == 1
        made = await client.tokens.create("anna", "read")
        assert (await client.tokens.revoke(made.token.name)).HasField("revoke_time")
        assert len(await client.tokens.list()) == 1


def test_a_submission_that_is_repeated_is_one_job(farm: FarmServer, room: Path) -> None:
    with Client(farm.address) as client:
        first, second = (client.farm.submit(spec(room), request_id="the same") for _ in range(2))
        assert first.name == second.name
        with contextlib.suppress(JobCancelledError):
            first.cancel()


def test_the_example_of_the_readme_runs(farm: FarmServer, room: Path, tmp_path: Path) -> None:
    readme = Path(__file__).parents[2] / "client" / "README.md"
    program = readme.read_text().split("```python\n")[2].partition("```")[0]
    program = (
        program.replace("127.0.0.1:50051", farm.address).replace("shot.usda", str(room)).replace("spp=256", "spp=2")
    )
    program = program.replace("1001-1100x2", "1001-1003x2").replace("render_spec(", "render_spec(size=(32, 32), stage=")
    (tmp_path / "out").mkdir()
    run = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["shot.1001.exr", "shot.1003.exr"]
    assert str(tmp_path / "out" / "shot.1003.exr") in run.stdout
