"""What the farm queue takes: submitting, claiming, ending and listing, on SQLite with every commit on disk."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from footlight_server.farm.model import Claim, Ending, ExitClass, JobPlan, Lane, LayerPlan, TaskKind, TaskPlan
from footlight_server.farm.queue import Queue

# [tasks]
TASKS = 10_000
# [lanes] That ask at the same time, as a dispatcher does for those that are free; and one by one.
LANES = tuple(Lane(f"host{number // 4}/{number % 4}", f"host{number // 4}") for number in range(32))
PAGE = 1000


@dataclass(frozen=True, slots=True)
class Measured:
    """[s] To submit a job of TASKS tasks, half of which need one of the others, and to cancel it; [tasks/s] claimed in
    batches and by single calls at the same time, and ended; [s] for the slowest page of the list.
    """

    submit: float
    claims_in_batches: float
    claims_one_by_one: float
    endings: float
    slowest_page: float
    cancel: float


def measure(folder: Path, claims: int) -> Measured:
    """On a new database in the folder; so many claims of each kind."""
    return asyncio.run(_measure(folder, claims))


def a_job() -> JobPlan:
    """Two layers, the second frame by frame after the first."""
    half = TASKS // 2
    tasks = [TaskPlan("fx", TaskKind.RENDER, (frame,), 0, 64) for frame in range(half)]
    tasks += [TaskPlan("beauty", TaskKind.RENDER, (frame,), 0, 64, (frame,)) for frame in range(half)]
    layers = (LayerPlan("fx", b"fx" * 100), LayerPlan("beauty", b"beauty" * 100))
    return JobPlan("bench", "bench", b"spec" * 100, 50, 2, layers, tuple(tasks))


async def _measure(folder: Path, claims: int) -> Measured:
    queue = await Queue.open(f"sqlite:///{folder}/queue.db")
    try:
        start = time.perf_counter()
        job = await queue.create_job(a_job())
        submit = time.perf_counter() - start
        batched: list[Claim] = []
        in_batches = await _rate(claims, lambda: _claim_batch(queue, batched), lambda: len(batched))
        single: list[Claim] = []
        one_by_one = await _rate(claims, lambda: _claim_together(queue, single), lambda: len(single))
        start = time.perf_counter()
        done = Ending(ExitClass.SUCCEEDED)
        for begin in range(0, len(batched), len(LANES)):
            await asyncio.gather(*(queue.finish(each.attempt, done) for each in batched[begin : begin + len(LANES)]))
        endings = len(batched) / (time.perf_counter() - start)
        slowest = 0.0
        for after in range(0, TASKS, PAGE):
            start = time.perf_counter()
            page = await queue.tasks(job.number, PAGE, after)
            slowest = max(slowest, time.perf_counter() - start)
            if len(page) != PAGE:
                raise RuntimeError(f"a page of {len(page)} tasks")
        start = time.perf_counter()
        await queue.cancel(job.number)
        cancel = time.perf_counter() - start
    finally:
        await queue.close()
    return Measured(submit, in_batches, one_by_one, endings, slowest, cancel)


async def _rate(count: int, turn: Callable[[], Awaitable[None]], so_far: Callable[[], int]) -> float:
    start = time.perf_counter()
    while so_far() < count:
        await turn()
    return so_far() / (time.perf_counter() - start)


async def _claim_batch(queue: Queue, claims: list[Claim]) -> None:
    claims += await queue.claim_many(LANES, LANES)


async def _claim_together(queue: Queue, claims: list[Claim]) -> None:
    found = await asyncio.gather(*(queue.claim(lane, LANES) for lane in LANES))
    claims += [claim for claim in found if claim]
