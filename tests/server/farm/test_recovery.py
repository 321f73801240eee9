"""A server may die between any two steps of a result: the next one finishes or forgets it, and no frame is wrong."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from footlight_server.farm.model import Attempt, Frame, Lane, TaskState
from footlight_server.farm.places import Places, workspace
from footlight_server.farm.recovery import recover
from footlight_server.farm.results import holds, put_in_place, seal
from tests.server.farm.farm import Place, Running, digest

LANE = Lane("here/1", "here")


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


class Step:
    """A frame of a claimed task on its way to its place; the methods are the dispatcher's steps."""

    def __init__(self, farm: Running, attempt: Attempt, frame: int, content: bytes) -> None:
        self.farm, self.attempt = farm, attempt
        self.target = farm.place.out / f"a.{frame:04d}.exr"
        self.made = workspace(self.target, attempt, frame) / "image.exr"
        self.content = content
        self.frame = Frame(
            attempt.job,
            "main",
            frame,
            str(self.target),
            hashlib.sha256(content).hexdigest(),
            len(content),
            attempt.task,
            attempt.number,
        )

    def make(self) -> None:
        self.made.parent.mkdir()
        self.made.write_bytes(self.content)

    async def stage(self) -> None:
        assert await self.farm.queue.stage_frame(self.attempt, self.frame, str(self.made))

    def rename(self) -> None:
        put_in_place(self.made, self.target)

    async def commit(self) -> None:
        assert await self.farm.queue.commit_frame(self.attempt, self.frame)


async def up_to(step: Step, count: int) -> None:
    """The first steps of a result, and then the server is gone."""
    if count > 0:
        step.make()
    if count > 1:
        await step.stage()
    if count > 2:
        step.rename()
    if count > 3:
        await step.commit()


# steps done -> the frame is there for the next server.
STEPS = {0: False, 1: False, 2: True, 3: True, 4: True}


async def died(place: Place, count: int, spoil: Callable[[Step], None] | None = None) -> int:
    """A server claims a job of two frames and dies with the first after so many steps; answers the job."""
    queue = await place.open_queue()
    farm = Running(place, queue, None, None)
    job = await farm.submit(place.job(frames="1-2", chunk=2))
    claim = await queue.claim(LANE, [LANE])
    assert claim is not None
    step = Step(farm, claim.attempt, 1, b"what a worker made")
    await up_to(step, count)
    if spoil is not None:
        spoil(step)
    await queue.close()
    return job


@pytest.mark.parametrize("count", STEPS)
async def test_every_step_is_a_safe_place_to_die(place: Place, count: int) -> None:
    job = await died(place, count)
    async with place.farm() as farm:
        ended = await farm.end(job)
        assert ended.frames_done == 2
        frame = await farm.queue.frame(job, "main", 1)
        assert (frame.attempt == 1) == STEPS[count], "a finished frame is not rendered again, an unfinished one is"
        assert frame.sha256 == digest(place.out / "a.0001.exr")
        assert await farm.queue.staged() == []
        assert [path.name for path in sorted(place.out.iterdir())] == ["a.0001.exr", "a.0002.exr"]


@pytest.mark.parametrize("count", [2, 3])
async def test_a_file_with_other_bytes_is_not_taken_for_the_result(place: Place, count: int) -> None:
    """A torn write, or somebody else's file of that name."""

    def spoil(step: Step) -> None:
        (step.made if count == 2 else step.target).write_bytes(b"what a worker")

    job = await died(place, count, spoil)
    async with place.farm() as farm:
        await farm.end(job)
        frame = await farm.queue.frame(job, "main", 1)
        assert frame.attempt == 2
        assert frame.sha256 == digest(place.out / "a.0001.exr")


async def test_a_result_that_cannot_be_put_in_place_is_made_again(place: Place) -> None:
    def spoil(step: Step) -> None:
        step.target.mkdir()

    await died(place, 2, spoil)
    queue = await place.open_queue()
    try:
        assert await recover(queue, Places(place.data)) == 1
        assert await queue.staged() == []
        assert (await queue.task(1, 1)).state is TaskState.READY
        assert (await queue.task(1, 1)).frames_done == 0
    finally:
        await queue.close()


async def test_what_was_cancelled_meanwhile_is_not_committed(place: Place) -> None:
    """The next server is told to cancel the job before it looks: impossible by itself, but fenced all the same."""
    job = await died(place, 3)
    queue = await place.open_queue()
    (attempt,) = await queue.running()
    await queue.recover()
    assert await queue.staged() == [], "an attempt that has ended stages nothing"
    late = Frame(job, "main", 1, str(place.out / "a.0001.exr"), "0" * 64, 1, 1, 1)
    assert not await queue.commit_frame(attempt, late)
    await queue.close()


def test_the_digest_is_of_all_bytes(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(bytes(range(256)) * 10_000)
    sealed = seal(path)
    assert (sealed.sha256, sealed.size_bytes) == (hashlib.sha256(path.read_bytes()).hexdigest(), 2_560_000)
    assert holds(path, sealed.sha256)
    path.write_bytes(path.read_bytes()[:-1])
    assert not holds(path, sealed.sha256)
    assert not holds(tmp_path / "gone", sealed.sha256)
