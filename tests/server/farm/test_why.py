"""Why something waits, in words, first what has to change first; from facts made up, and from a queue."""

from dataclasses import replace

import pytest

from footlight_server.farm.model import Ending, ExitClass, Lane, LayerPlan, Limit, LimitUnit, Selection, TaskState
from footlight_server.farm.queue import Queue
from footlight_server.farm.why import WaitedLayer, WaitFacts, explain_wait
from footlight_server.sessions.errors import JobNotFoundError, TaskNotFoundError
from tests.server.farm.jobs import CRASH, LANES, ONE, SCENE, SUCCEEDED, TWO, Clock, a_job, claim, render, run

WAITS = WaitFacts(12, waits=True, now=1_000_000.0)
BUSY = frozenset(lane.name for lane in LANES)


@pytest.mark.parametrize(
    ("facts", "reasons"),
    [
        (WaitFacts(12, waits=False, paused=True), []),
        (WAITS, ["ready: the next free worker takes it"]),
        (replace(WAITS, paused=True), ["jobs/12 is paused"]),
        (replace(WAITS, jobs=((3, "running"),)), ["waits for jobs/3, which is running"]),
        (
            replace(WAITS, layers=(WaitedLayer("beauty", 3, 50),)),
            ["waits for layer beauty: 3 of 50 tasks left"],
        ),
        (
            replace(WAITS, tasks=((4, TaskState.FAILED), (5, TaskState.READY)), tasks_left=9),
            [
                "waits for jobs/12/tasks/4, which is failed; that has to be retried or skipped",
                "waits for jobs/12/tasks/5, which is ready",
                "waits for 7 more tasks",
            ],
        ),
        (
            replace(WAITS, limits=(Limit("houdini", 5, LimitUnit.TASK, 5), Limit("disk", 2, LimitUnit.HOST, 1))),
            ["limit houdini: 5 of 5 tasks run"],
        ),
        (
            replace(WAITS, limits=(Limit("nuke", 1, LimitUnit.HOST, 1),)),
            ["limit nuke: 1 of 1 hosts run tasks"],
        ),
        (
            replace(WAITS, not_before=1_000_064.0, last_exit=ExitClass.CRASH),
            ["after a crash, not before 13:47:44 UTC (in 64 s)"],
        ),
        (replace(WAITS, not_before=999_999.0, last_exit=ExitClass.CRASH), ["ready: the next free worker takes it"]),
        (replace(WAITS, busy=BUSY, ahead=14), ["all 3 workers are busy; 14 tasks are before this one"]),
        (replace(WAITS, busy=BUSY), ["all 3 workers are busy"]),
        (replace(WAITS, ahead=1), ["1 task is before this one"]),
        (
            replace(WAITS, busy=BUSY, failed_on=frozenset({"north/1"})),
            ["the workers it may use are busy: north/2, south/1", "it failed on north/1 before"],
        ),
        (
            replace(WAITS, busy=BUSY, failed_tasks={"north/1": 3, "north/2": 9}),
            [
                "the workers it may use are busy: south/1",
                "at least 3 tasks of this job failed on north/1, north/2",
            ],
        ),
        (
            replace(WAITS, busy=BUSY, failed_tasks={"north/1": 4, "north/2": 3, "south/1": 5}),
            [
                "the workers it may use are busy: north/2",
                "at least 3 tasks of this job failed on each worker; only north/2, where the fewest did, is still used",
            ],
        ),
    ],
)
def test_reasons(facts: WaitFacts, reasons: list[str]) -> None:
    assert explain_wait(facts, LANES) == reasons


def test_without_workers_nothing_runs() -> None:
    assert explain_wait(WAITS, []) == ["there are no workers"]
    assert explain_wait(replace(WAITS, busy=frozenset({"a"})), [Lane("a", "h")]) == ["the worker is busy"]


async def test_a_queue_says_why(queue: Queue, clock: Clock) -> None:
    async def why(job: int, task: int | None = None) -> list[str]:
        return explain_wait(await queue.wait_facts(job, task), LANES)

    layers = (
        LayerPlan("fx", b"", limits=("gpu",)),
        LayerPlan("beauty", b"", depends=("fx",)),
    )
    tasks = (render("fx", 1), render("fx", 2, needs=(0,)), render("beauty", 1))
    job = (await queue.create_job(a_job(*layers, tasks=tasks))).number
    late = (await queue.create_job(a_job(frames=1, depends=(job,)))).number
    assert await why(job) == ["ready: the next free worker takes it"]
    assert await why(job, 2) == [f"waits for jobs/{job}/tasks/1, which is ready", "1 task is before this one"]
    assert (await why(job, 3))[0] == "waits for layer fx: 2 of 2 tasks left"
    assert (await why(late))[0] == f"waits for jobs/{job}, which is queued"

    high = (await queue.create_job(a_job(frames=2, priority=51))).number
    await queue.create_job(a_job(frames=9, priority=49))
    assert await why(job, 1) == ["2 tasks are before this one"]
    assert await why(high, 1) == ["ready: the next free worker takes it"]
    await queue.cancel(high)

    await queue.pause(job)
    assert (await why(job))[0] == f"jobs/{job} is paused"
    assert (await why(late))[0] == f"waits for jobs/{job}, which is paused"
    await queue.resume(job)

    await queue.set_limit(Limit("gpu", 0, LimitUnit.TASK))
    assert await why(job) == ["limit gpu: 0 of 0 tasks run"]
    await queue.set_limit(Limit("gpu", 1, LimitUnit.TASK))

    first = await claim(queue)
    assert await why(job) == []
    assert await why(job, 1) == []
    await queue.finish(first.attempt, CRASH)
    assert (await why(job, 1))[0].startswith("after a crash, not before ")
    clock.now += 1
    other = (await queue.create_job(a_job(frames=3, priority=90))).number
    for lane in LANES:
        await claim(queue, lane)
    assert await why(other) == []
    assert await why(job, 1) == ["the workers it may use are busy: north/2, south/1", "it failed on north/1 before"]

    await queue.cancel(job)
    assert await why(job) == []
    assert await why(late) == [
        f"waits for jobs/{job}, which is cancelled; that has to be retried or skipped",
        "all 3 workers are busy",
    ]
    with pytest.raises(JobNotFoundError):
        await why(99)
    with pytest.raises(TaskNotFoundError):
        await why(job, 99)


async def test_a_block_that_leaves_one_lane_is_said(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=9, retries=0))
    lanes = (ONE, TWO)
    for lane in lanes:
        for _ in range(3):
            await run(queue, Ending(ExitClass.TIMEOUT), lane, lanes)
    await claim(queue, ONE, lanes)
    reasons = explain_wait(await queue.wait_facts(job.number, 8), lanes)
    assert reasons[-1] == (
        "at least 3 tasks of this job failed on each worker; only north/1, where the fewest did, is still used"
    )


async def test_what_waits_for_a_failure_says_so(queue: Queue) -> None:
    job = await queue.create_job(a_job(tasks=(render("main", 1), render("main", 2, needs=(0,)))))
    await run(queue, SCENE)
    assert explain_wait(await queue.wait_facts(job.number), LANES) == []
    facts = await queue.wait_facts(job.number, 2)
    assert explain_wait(facts, LANES)[0] == (
        f"waits for jobs/{job.number}/tasks/1, which is failed; that has to be retried or skipped"
    )
    await queue.skip(job.number, Selection(tasks=frozenset({1})))
    claimed = await claim(queue)
    assert await queue.finish(claimed.attempt, SUCCEEDED) is not None
