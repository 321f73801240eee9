"""Watching, logs, images: nothing is missed across a break, streams end by themselves, who does not read is cut off."""

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator
from pathlib import Path

import grpc
import pytest

from footlight.v1 import job_pb2, job_service_pb2
from footlight_server.api import job_feed, streams
from footlight_server.farm.model import ExitClass
from tests.server.api.farm_service import FarmServer, farm_server, until
from tests.server.api.test_jobs import refused

SERVICE = job_service_pb2
ENDS = (job_pb2.JOB_STATE_SUCCEEDED, job_pb2.JOB_STATE_FAILED, job_pb2.JOB_STATE_CANCELLED)


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[FarmServer]:
    async with farm_server(tmp_path) as running:
        yield running


class Mirror:
    """What a client knows of a job from nothing but events, across any number of streams."""

    def __init__(self, server: FarmServer, name: str) -> None:
        self.server = server
        self.name = name
        self.job = job_pb2.Job()
        self.tasks: dict[str, job_pb2.Task] = {}
        self.frames: dict[tuple[str, int], job_pb2.Frame] = {}
        self.ids: list[int] = []
        self.after = 0

    def take(self, event: job_pb2.JobEvent) -> None:
        match event.WhichOneof("event"):
            case "changed":
                self.job = event.changed
            case "task":
                self.tasks[event.task.name] = event.task
            case "frame":
                self.frames[event.frame.layer, event.frame.frame] = event.frame
            case "progress":
                assert event.id == 0
        if event.id:
            self.ids.append(event.id)
            self.after = event.id

    async def watch(self, most: int = 1 << 30, within: float = 30.0) -> bool:
        """Take up to so many events; whether the stream ended by itself."""
        request = SERVICE.WatchJobRequest(name=self.name, after=self.after)
        call = self.server.jobs.WatchJob(request, timeout=within)
        try:
            async for response in call:
                self.take(response.event)
                most -= 1
                if most <= 0:
                    return False
            return True
        finally:
            call.cancel()


async def check(mirror: Mirror) -> None:
    """The mirror is what the server has."""
    server = mirror.server
    job = await server.get(mirror.name)
    assert job.state in ENDS
    assert mirror.job == job
    assert mirror.tasks
    assert mirror.tasks == {task.name: task for task in await server.tasks(mirror.name)}
    request = SERVICE.ListFramesRequest(job=mirror.name, page_size=1000)
    frames = (await server.jobs.ListFrames(request, timeout=10)).frames
    assert mirror.frames == {(frame.layer, frame.frame): frame for frame in frames}
    assert mirror.ids == sorted(set(mirror.ids))


async def test_a_watcher_that_breaks_off_at_any_event_misses_nothing(server: FarmServer) -> None:
    job = await server.submit(server.layer("1-12"))
    chance = random.Random(5)

    async def work() -> None:
        while await server.work_off(chance.randrange(1, 5)):
            await asyncio.sleep(chance.random() * 0.1)

    async def watch(most: int) -> Mirror:
        mirror = Mirror(server, job.name)
        while not await mirror.watch(chance.randrange(1, most)):
            await asyncio.sleep(chance.random() * 0.2)
        return mirror

    *mirrors, _ = await asyncio.gather(watch(3), watch(8), watch(40), work())
    for mirror in mirrors:
        await check(mirror)
    late = Mirror(server, job.name)
    assert await late.watch()
    await check(late)


async def test_a_watcher_far_behind_gets_the_record_in_pages(
    server: FarmServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a feed that keeps two messages, everybody falls behind it; a feed that skips then would fail here."""
    monkeypatch.setattr(job_feed, "_KEPT", 2)
    monkeypatch.setattr("footlight_server.api.job_streams.PAGE", 7)
    monkeypatch.setattr(job_feed, "PAGE", 5)
    job = await server.submit(server.layer("1-40"))
    mirrors = [Mirror(server, job.name) for _ in range(3)]
    watching = asyncio.gather(*(mirror.watch() for mirror in mirrors))
    while await server.work_off(3):
        await asyncio.sleep(0.05)
    assert await watching == [True] * 3
    for mirror in mirrors:
        await check(mirror)


async def test_the_first_message_is_the_job_as_it_is_and_only_new_leaves_out_the_past(server: FarmServer) -> None:
    job = await server.submit()
    await server.work_off(2)
    request = SERVICE.WatchJobRequest(name=job.name, only_new=True)
    events: list[job_pb2.JobEvent] = []

    async def watch() -> None:
        events.extend([response.event async for response in server.jobs.WatchJob(request, timeout=20)])

    watching = asyncio.create_task(watch())
    await until(lambda: bool(events) or len(server.queue.changed._rung._waiters) > 0)
    await asyncio.sleep(0.3)
    await server.work_off()
    await watching
    assert events[0].id == 0
    assert events[0].changed.tasks.succeeded == 2
    named = {event.task.name for event in events if event.HasField("task")}
    assert named == {f"{job.name}/tasks/3", f"{job.name}/tasks/4"}
    assert events[-1].changed.state == job_pb2.JOB_STATE_SUCCEEDED


async def test_a_job_that_has_ended_is_shown_and_the_stream_ends(server: FarmServer) -> None:
    job = await server.submit()
    await server.work_off()
    request = SERVICE.WatchJobRequest(name=job.name, only_new=True)
    events = [response.event async for response in server.jobs.WatchJob(request, timeout=10)]
    assert [event.changed.state for event in events] == [job_pb2.JOB_STATE_SUCCEEDED]


async def test_a_job_that_is_opened_again_is_watched_to_its_new_end(
    server: FarmServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The feed, slower here and kept by somebody else, still believes that the job has ended when the watcher comes."""
    monkeypatch.setattr(job_feed, "_PACE", 0.4)
    job = await server.submit(server.layer("1"), retries=0)
    mirror = Mirror(server, job.name)
    with server.service._feeds.watching(1) as feed:
        for _ in range(3):
            watched = asyncio.create_task(mirror.watch())
            await asyncio.sleep(0.2)
            claim = await server.claim()
            assert claim is not None
            await server.finish(claim.attempt, ExitClass.SCENE, "no camera")
            assert await watched
            assert mirror.job.state == job_pb2.JOB_STATE_FAILED
            await check(mirror)
            assert feed.ended
            await server.jobs.RetryTasks(SERVICE.RetryTasksRequest(job=job.name), timeout=10)


async def test_counts_come_once_a_second_however_many_tasks_end(server: FarmServer) -> None:
    job = await server.submit(server.layer("1-2000", chunk=20))
    counts = 0
    loop = asyncio.get_running_loop()
    begun = loop.time()

    async def work() -> None:
        while (claim := await server.claim()) is not None:
            await server.finish(claim.attempt)
            await asyncio.sleep(0.02)

    working = asyncio.create_task(work())
    async for response in server.jobs.WatchJob(SERVICE.WatchJobRequest(name=job.name), timeout=60):
        counts += response.event.HasField("changed")
    await working
    # The job as it is, QUEUED, RUNNING, SUCCEEDED; and the counts, the first at once.
    assert counts <= 5 + (loop.time() - begun)
    assert counts >= 4


async def test_a_watcher_that_never_reads_is_cut_off_and_nobody_else_notices(
    server: FarmServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streams.send, "__defaults__", (2.0,))
    job = await server.submit(server.layer("1-400000", chunk=1000))
    options = (("grpc.http2.bdp_probe", 0), ("grpc.http2.lookahead_bytes", 1024))
    async with grpc.aio.insecure_channel(server.address, options=options) as channel:
        stub = type(server.jobs)(channel)
        silent = stub.WatchJob(SERVICE.WatchJobRequest(name=job.name), timeout=60)
        await silent.read()
        mirror = Mirror(server, job.name)
        reading = asyncio.create_task(mirror.watch(within=60))
        while (claim := await server.claim()) is not None:
            await server.finish(claim.attempt)
        assert await reading
        await check(mirror)
        await asyncio.sleep(2.5)
        # Whatever the pipe took is still there; then the end, which was long before we read.
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await _read_all(silent)
        assert caught.value.code() == grpc.StatusCode.DEADLINE_EXCEEDED
        assert "nothing was read" in caught.value.details()


async def test_feeds_end_with_their_last_watcher(server: FarmServer) -> None:
    job = await server.submit()

    def feeds() -> int:
        return sum(task.get_name().startswith("feed of") for task in asyncio.all_tasks())

    for _ in range(3):
        calls = [server.jobs.WatchJob(SERVICE.WatchJobRequest(name=job.name), timeout=20) for _ in range(5)]
        for call in calls:
            await call.read()
        assert feeds() == 1
        for call in calls:
            call.cancel()
        await until(lambda: feeds() == 0)


async def test_a_watched_job_that_is_pruned_is_not_found(server: FarmServer) -> None:
    await refused(_drain(server.jobs.WatchJob(SERVICE.WatchJobRequest(name="jobs/7"), timeout=10)), "JOB_NOT_FOUND")
    too_late = SERVICE.WatchJobRequest(name="jobs/1", after=1 << 63)
    await refused(_drain(server.jobs.WatchJob(too_late, timeout=10)), "INVALID_FIELD")


async def _drain(call: AsyncIterator[object]) -> list[object]:
    return [response async for response in call]


async def _read_all(call: grpc.aio.UnaryStreamCall) -> None:
    while await call.read() is not grpc.aio.EOF:
        pass


# --- logs ---


async def log_of(server: FarmServer, name: str, **options: object) -> bytes:
    """All of it, which comes without holes."""
    data = b""
    begin = None
    request = SERVICE.ReadLogRequest(name=name, **options)
    async for piece in server.jobs.ReadLog(request, timeout=20):
        begin = piece.offset if begin is None else begin
        assert piece.offset == begin + len(data)
        assert len(piece.data) <= 256 << 10
        data += piece.data
    return data


async def test_a_log_is_followed_until_its_attempt_has_ended(server: FarmServer) -> None:
    job = await server.submit(server.layer("1"), retries=3)
    claim = await server.claim()
    assert claim is not None
    path = server.farm.log_path(1, 1, 1)
    following = asyncio.create_task(log_of(server, f"{job.name}/tasks/1", follow=True))
    await asyncio.sleep(0.2)
    path.parent.mkdir(parents=True)
    expected = b""
    for number in range(5):
        line = f"line {number} ".encode() + b"x" * 100_000 + b"\n"
        expected += line
        with path.open("ab") as file:
            file.write(line)
        await asyncio.sleep(0.1)
        assert not following.done()
    assert await log_of(server, f"{job.name}/tasks/1/attempts/1") == expected
    with path.open("ab") as file:
        file.write(b"the last words\n")
    await server.finish(claim.attempt, ExitClass.PREEMPTED)
    assert await following == expected + b"the last words\n"
    assert await log_of(server, f"{job.name}/tasks/1/attempts/1", offset=len(expected)) == b"the last words\n"
    # Another attempt does not keep those waiting who read the first one's log.
    assert await server.claim() is not None
    assert await log_of(server, f"{job.name}/tasks/1/attempts/1", follow=True) == expected + b"the last words\n"
    assert await log_of(server, f"{job.name}/tasks/1") == b""


async def test_a_log_that_cannot_be_is_not_found(server: FarmServer) -> None:
    await server.submit()
    for name in ("jobs/1/tasks/1", "jobs/1/tasks/1/attempts/1", "jobs/1/tasks/9", "jobs/1", "../../etc/passwd"):
        await refused(log_of(server, name), "TASK_NOT_FOUND")
    await refused(log_of(server, "jobs/9/tasks/1"), "JOB_NOT_FOUND")


# --- images ---


async def image(server: FarmServer, **options: object) -> bytes:
    data = b""
    async for piece in server.jobs.GetFrame(SERVICE.GetFrameRequest(**options), timeout=20):
        assert len(piece.data) <= 256 << 10
        data += piece.data
        assert piece.total_bytes
    return data


async def test_an_image_comes_whole_or_from_where_it_broke_off(server: FarmServer) -> None:
    job = await server.submit(server.layer("1-2"))
    await server.work_off(1)
    expected = server.farm.places.image(1, "main", 1).read_bytes()
    assert await image(server, job=job.name, frame=1) == expected
    assert await image(server, job=job.name, frame=1, layer="main", offset=1000) == expected[1000:]
    await refused(image(server, job=job.name, frame=1, offset=len(expected) + 1), "INVALID_FIELD")


async def test_an_image_that_is_not_there_is_not_found(server: FarmServer, tmp_path: Path) -> None:
    job = await server.submit(server.layer("1-2", name="a"), server.layer("1-2", name="b"))
    await server.work_off(1)
    await refused(image(server, job=job.name, frame=1), "INVALID_FIELD")
    png = SERVICE.FRAME_FORMAT_PNG
    for options in (
        {"layer": "a", "frame": 2},
        {"layer": "a", "frame": 99},
        {"layer": "c", "frame": 1},
        {"layer": "a", "frame": 1, "format": png},
        {"layer": "b", "frame": 1, "format": SERVICE.FRAME_FORMAT_THUMBNAIL},
        {"layer": "b", "frame": 1, "format": SERVICE.FRAME_FORMAT_CONTACT_SHEET},
    ):
        await refused(image(server, job=job.name, **options), "FRAME_NOT_FOUND")
    await refused(image(server, job="jobs/9", layer="a", frame=1), "JOB_NOT_FOUND")
    # Somebody has put a link where the image was: it is not followed.
    secret = tmp_path / "secret"
    secret.write_text("of the server's machine")
    path = server.farm.places.image(1, "a", 1)
    path.unlink()
    path.symlink_to(secret)
    await refused(image(server, job=job.name, layer="a", frame=1), "FRAME_NOT_FOUND")
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
    await refused(image(server, job=job.name, layer="a", frame=1), "FRAME_NOT_FOUND")
