"""The farm in one process, with real workers: what comes of jobs."""

import asyncio
from dataclasses import replace
from pathlib import Path

import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight.v1 import render_pb2, stats_pb2
from footlight_server.farm.model import ExitClass, JobState, TaskKind
from footlight_server.farm.places import Places
from footlight_server.sessions.errors import FrameNotFoundError
from tests.server.farm.farm import ENDLESS, Place, Running, digest, leftovers


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


async def test_a_job_leaves_its_images_thumbnails_logs_and_nothing_else(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.render(place.job(frames="1-5", chunk=2, png=render_pb2.Png()))
        frames = await farm.queue.frames(job, 100)
        assert [frame.frame for frame in frames] == [1, 2, 3, 4, 5]
        places = farm.farm.places
        for frame in frames:
            path = place.out / f"a.{frame.frame:04d}.exr"
            assert Path(frame.path) == path
            assert (frame.sha256, frame.size_bytes) == (digest(path), path.stat().st_size)
            assert path.stat().st_mode & 0o777 == 0o644
            assert stats_pb2.RenderStats.FromString(frame.stats).spp == 2
            for small in (places.thumbnail(job, "main", frame.frame), places.picture(job, "main", frame.frame)):
                assert oiio.ImageBuf(str(small)).spec().width == 24
        assert sorted(path.name for path in place.out.iterdir()) == [f"a.000{n}.exr" for n in range(1, 6)]
        assert leftovers(place) == []
        log = farm.log(job)
        assert "frame 1: rendering /World/camera at 24x16, 2 samples per pixel" in log
        assert f"sha256 {frames[0].sha256}" in log
        assert log.rstrip().endswith("ended: succeeded")
        (attempt,) = await farm.attempts(job)
        assert attempt.exit_class is ExitClass.SUCCEEDED
        assert attempt.peak_memory_bytes > 1 << 20


async def test_without_an_output_path_the_server_keeps_the_images(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.render(place.job(frames="", output="", name="back.drop"))
        (frame,) = await farm.queue.frames(job, 10)
        assert Path(frame.path) == farm.farm.places.image(job, "back.drop", 0)
        assert digest(Path(frame.path)) == frame.sha256
        assert leftovers(place) == []
        header = oiio.ImageBuf(frame.path).spec()
        assert header.getattribute("footlight:time_code") == 0.0
        freed = await farm.farm.prune([job])
        assert freed > frame.size_bytes
        assert not farm.farm.places.job(job).exists()


async def test_a_frame_is_rendered_at_its_own_time(place: Place) -> None:
    """Two frames of a stage that moves differ."""
    moves = """def Cube "box" {
        double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (2, 0, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]"""
    place.stage.write_text(place.stage.read_text().replace('def Cube "box" {', moves))
    async with place.farm() as farm:
        job = await farm.render(place.job(frames="1,2"))
        first, second = await farm.queue.frames(job, 10)
        assert first.sha256 != second.sha256
        pixels = [oiio.ImageBuf(frame.path).get_pixels(oiio.FLOAT) for frame in (first, second)]
        assert pixels[0] is not None
        assert pixels[1] is not None
        assert abs(pixels[0] - pixels[1]).max() > 0.01


@pytest.mark.parametrize("split", [2, 5])
async def test_a_split_frame_is_the_unsplit_one_byte_for_byte(place: Place, split: int) -> None:
    async with place.farm() as farm:
        options = {"frames": "7", "spp": 5, "aovs": ["position", "error", "depth"], "png": render_pb2.Png()}
        whole = await farm.render(place.job(output=str(place.out / "whole.####.exr"), **options))
        parts = await farm.render(place.job(output=str(place.out / "parts.####.exr"), split=split, **options))
        assert digest(place.out / "whole.0007.exr") == digest(place.out / "parts.0007.exr")
        pictures = [farm.farm.places.picture(job, "main", 7) for job in (whole, parts)]
        assert digest(pictures[0]) == digest(pictures[1])
        (frame,) = await farm.queue.frames(parts, 10)
        assert stats_pb2.RenderStats.FromString(frame.stats).samples == 24 * 16 * 5
        tasks = await farm.queue.tasks(parts, 100)
        assert [task.kind for task in tasks] == [TaskKind.RENDER] * split + [TaskKind.MERGE]
        async with asyncio.timeout(10):  # they go after the job has ended
            while list((place.data / "jobs" / str(parts) / "parts").iterdir()):
                await asyncio.sleep(0.05)
        assert leftovers(place) == []


async def test_the_environment_of_a_job_reaches_its_workers(place: Place) -> None:
    async with replace(place, environment={"OCIO"}).farm() as farm:
        options = {"retries": 0, "environment": {"OCIO": "/nowhere/studio.ocio"}, "png": render_pb2.Png(view="Film")}
        job = await farm.submit(place.job(frames="1", **options))
        assert (await farm.end(job)).state is JobState.FAILED
        assert "studio.ocio" in (await farm.attempts(job))[0].message


async def test_the_contact_sheet_has_the_frames_that_are_done(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-6"))
        with pytest.raises(FrameNotFoundError):
            await farm.farm.sheet(job, "no such layer")
        await farm.until(lambda: farm.queue.frames(job, 10), bool)
        early = oiio.ImageBuf(str(await farm.farm.sheet(job, "main"))).spec()
        assert early.width > 24
        await farm.end(job)
        paths = await asyncio.gather(*(farm.farm.sheet(job, "main") for _ in range(3)))
        sheet = oiio.ImageBuf(str(paths[0])).spec()
        assert (sheet.width, sheet.height) == (3 * 28 + 4, 2 * 20 + 4)
        made = paths[0].stat().st_ino
        assert (await farm.farm.sheet(job, "main")).stat().st_ino == made, "it is up to date"


async def test_what_is_going_on_can_be_asked(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="5", spp=ENDLESS))
        name = await farm.rendering(job)
        (running,) = farm.farm.running()
        assert (running.attempt.job, running.attempt.task, running.frame, running.render) == (job, 1, 5, name)
        assert running.progress is not None
        assert running.progress.samples_total == ENDLESS
        assert farm.sessions.get(name).render.spec.stage_path == str(place.stage)
        assert running.attempt.worker in {lane.name for lane in farm.farm.lanes()}
        assert farm.farm.attempt(job, 2) is None
        assert Places(place.data).log(job, 1, 1) == farm.farm.log_path(job, 1, 1)


async def test_all_lanes_are_used_at_the_same_time(place: Place) -> None:
    place = replace(place, lanes=3)

    async def busiest(farm: Running, job: int) -> int:
        most = 0
        while not (await farm.queue.job(job)).state.ended:
            most = max(most, len(farm.farm.running()))
            await asyncio.sleep(0.02)
        return most

    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1-9", width=8, height=8, spp=1))
        async with asyncio.timeout(60):
            assert await busiest(farm, job) == 3
        used = {attempt.worker for n in range(1, 10) for attempt in await farm.attempts(job, n)}
        assert len(used) == 3
