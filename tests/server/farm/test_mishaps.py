"""What befalls attempts on the way, and what the farm makes of it."""

import asyncio
import os
import shutil
import signal
from pathlib import Path

import pytest

from footlight_server.farm.model import Ending, ExitClass, JobState
from footlight_server.farm.results import copy_in_place, seal
from tests.server.farm.farm import ENDLESS, Place, digest, leftovers, workers


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


async def test_a_stage_at_fault_is_not_tried_again(place: Place) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1", camera_path="/World/nobody"))
        assert (await farm.end(job)).state is JobState.FAILED
        (attempt,) = await farm.attempts(job)
        assert attempt.exit_class is ExitClass.SCENE
        assert "/World/nobody" in attempt.message
        assert leftovers(place) == []


async def test_a_killed_worker_costs_an_attempt_and_no_frame_that_was_done(place: Place) -> None:
    async with place.farm() as farm:
        spec = place.job(frames="1-4", chunk=4, width=96, height=64, spp=300)
        job = await farm.submit(spec)
        await farm.until(lambda: farm.queue.frames(job, 10), lambda frames: len(frames) >= 2)
        done = {path: path.stat().st_mtime_ns for path in place.out.glob("*.exr")}
        await farm.rendering(job)
        for pid in workers():
            os.kill(pid, signal.SIGKILL)
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        first, second = await farm.attempts(job)
        assert (first.exit_class, second.exit_class) == (ExitClass.CRASH, ExitClass.SUCCEEDED)
        assert "SIGKILL" in first.message
        assert {path: path.stat().st_mtime_ns for path in done} == done
        assert "frame 1:" not in farm.log(job, 1, 2)
        assert leftovers(place) == []


async def test_a_directory_that_was_swapped_for_a_link_outwards_gets_nothing(place: Place, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    place.output_roots = (place.out,)
    async with place.farm() as farm:
        inside = place.out / "shot"
        inside.mkdir()
        job = await farm.submit(place.job(frames="1", paused=True, output=str(inside / "####.exr")))
        inside.rmdir()
        inside.symlink_to(outside)
        await farm.queue.resume(job)
        assert (await farm.end(job)).state is JobState.FAILED
        (attempt,) = await farm.attempts(job)
        assert "leads out of the directories" in attempt.message
        assert list(outside.iterdir()) == []


async def test_a_directory_that_vanished_is_waited_for(place: Place) -> None:
    async with place.farm() as farm:
        shutil.rmtree(place.out)
        job = await farm.submit(place.job(frames="1"))
        task = await farm.until(lambda: farm.task(job), lambda task: task.failures == 1)
        assert task.last_attempt is not None
        assert task.last_attempt.exit_class is ExitClass.OUTPUT
        assert not place.out.exists(), "it might be a disk that is not mounted"
        place.out.mkdir()
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        assert len(await farm.attempts(job)) == 2


async def test_a_target_that_cannot_be_replaced_is_an_output_failure(place: Place) -> None:
    async with place.farm() as farm:
        (place.out / "a.0001.exr").mkdir()
        job = await farm.submit(place.job(frames="1", retries=0))
        assert (await farm.end(job)).state is JobState.FAILED
        (attempt,) = await farm.attempts(job)
        assert attempt.exit_class is ExitClass.OUTPUT
        assert "a.0001.exr" in attempt.message
        assert await farm.queue.staged() == []
        assert leftovers(place) == []


@pytest.mark.parametrize(("limit", "says"), [("timeout_seconds", "limit of 1 s"), ("stall_timeout_seconds", "nothing")])
async def test_a_frame_that_takes_too_long_is_stopped(place: Place, limit: str, says: str) -> None:
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1", spp=ENDLESS, retries=0, **{limit: 1.0}))
        if limit == "stall_timeout_seconds":
            await farm.rendering(job)
            for pid in workers():
                os.kill(pid, signal.SIGSTOP)
        assert (await farm.end(job, within=30)).state is JobState.FAILED
        (attempt,) = await farm.attempts(job)
        assert attempt.exit_class is ExitClass.TIMEOUT
        assert says in attempt.message


async def test_an_attempt_that_is_not_current_any_more_commits_nothing(place: Place) -> None:
    """Fencing: while a worker is away, its task is given to another; then it comes back with a result."""
    async with place.farm() as farm:
        job = await farm.submit(place.job(frames="1", width=96, height=64, spp=8000))
        await farm.rendering(job)
        (first,) = await farm.attempts(job)
        assert await farm.queue.finish(first, Ending(ExitClass.LOST, "thought to be lost")) is not None
        assert (await farm.end(job)).state is JobState.SUCCEEDED
        second = (await farm.attempts(job))[-1]
        assert second.number == 2
        assert second.worker != first.worker
        async with asyncio.timeout(30):  # whichever of them comes last
            while farm.farm.running():
                await asyncio.sleep(0.02)
        frame = await farm.queue.frame(job, "main", 1)
        assert frame.attempt == 2
        assert frame.sha256 == digest(place.out / "a.0001.exr")
        assert "not the current attempt" in farm.log(job, 1, 1)
        assert leftovers(place) == []


@pytest.mark.parametrize("trick", ["link", "hard link", "pipe"])
async def test_what_a_worker_made_has_to_be_a_file_of_its_own(place: Place, trick: str) -> None:
    """A worker that was taken over might leave a way to a file that it may not read itself."""
    secret, made = place.root / "secret", place.root / "image.exr"
    secret.write_text("not for you")
    match trick:
        case "link":
            made.symlink_to(secret)
        case "hard link":
            made.hardlink_to(secret)
        case "pipe":
            os.mkfifo(made)
    with pytest.raises(OSError, match=r"links|plain file"):
        seal(made)
    with pytest.raises(OSError, match=r"links|plain file"):
        copy_in_place(made, place.out / "thumbnail.png")
    assert list(place.out.iterdir()) == []
