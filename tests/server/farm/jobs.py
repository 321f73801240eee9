"""Jobs to put into a queue, lanes to run them on, and a clock that stands still."""

from dataclasses import dataclass, replace

from footlight_server.farm.model import (
    Attempt,
    Claim,
    Ending,
    ExitClass,
    Frame,
    JobPlan,
    Lane,
    LayerPlan,
    TaskKind,
    TaskPlan,
)
from footlight_server.farm.queue import Queue

ONE, TWO, THREE = Lane("north/1", "north"), Lane("north/2", "north"), Lane("south/1", "south")
LANES = (ONE, TWO, THREE)
SUCCEEDED, CANCELLED = Ending(ExitClass.SUCCEEDED), Ending(ExitClass.CANCELLED)
CRASH = Ending(ExitClass.CRASH, "the worker crashed (SIGSEGV)", "/World", 1000)
SCENE = Ending(ExitClass.SCENE, "no camera")


@dataclass
class Clock:
    """[s since 1970, UTC]."""

    now: float = 1_000_000.0

    def __call__(self) -> float:
        return self.now


def a_job(*layers: LayerPlan, tasks: tuple[TaskPlan, ...] = (), frames: int = 3, **options: object) -> JobPlan:
    """One layer `main` of so many tasks of a frame each, unless layers and tasks are given."""
    layers = layers or (LayerPlan("main", b"layer main"),)
    tasks = tasks or tuple(render(layers[0].name, 1000 + index) for index in range(frames))
    plan = JobPlan(title="a job", user="ada", spec=b"job", priority=50, retries=2, layers=layers, tasks=tasks)
    return replace(plan, **options)


def render(layer: str, *frames: int, needs: tuple[int, ...] = (), samples: tuple[int, int] = (0, 16)) -> TaskPlan:
    return TaskPlan(layer, TaskKind.RENDER, frames, *samples, needs)


def merge(layer: str, frame: int, needs: tuple[int, ...]) -> TaskPlan:
    return TaskPlan(layer, TaskKind.MERGE, (frame,), 0, 16, needs)


def frame_of(claim: Claim, number: int | None = None) -> Frame:
    """An image of a claim's first frame."""
    task = claim.task
    number = task.frames[0] if number is None else number
    path = f"/images/{task.layer}.{number}.exr"
    return Frame(task.job, task.layer, number, path, "ab" * 32, 1234, task.number, claim.attempt.number, b"stats")


async def claim(queue: Queue, lane: Lane = ONE, live: tuple[Lane, ...] = LANES) -> Claim:
    """The next task for a lane, of which there has to be one."""
    claimed = await queue.claim(lane, live)
    assert claimed is not None
    return claimed


async def run(queue: Queue, ending: Ending = SUCCEEDED, lane: Lane = ONE, live: tuple[Lane, ...] = LANES) -> Attempt:
    """Claim a task and end it so."""
    attempt = (await claim(queue, lane, live)).attempt
    assert await queue.finish(attempt, ending) is not None
    return attempt


async def run_all(queue: Queue, lane: Lane = ONE, live: tuple[Lane, ...] = LANES) -> list[tuple[int, int]]:
    """Let everything there is for a lane succeed; answers (job, task) in the order they were claimed."""
    order = []
    while claimed := await queue.claim(lane, live):
        order.append((claimed.attempt.job, claimed.attempt.task))
        await queue.finish(claimed.attempt, SUCCEEDED)
    return order
