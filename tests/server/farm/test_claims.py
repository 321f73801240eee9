"""Laws of giving tasks to lanes: each once, in order, within limits, away from where they failed, never stuck."""

import asyncio
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import Connection, create_engine, select, update
from sqlalchemy.event import listen

from footlight_server.farm.blocklist import may_take, usable_lanes
from footlight_server.farm.model import Ending, ExitClass, Lane, LayerPlan, Limit, LimitUnit, Selection, TaskState
from footlight_server.farm.queue import Queue
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.claims import claim_many
from footlight_server.farm.sql.engines import url_of, writing
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.transitions import Policy
from tests.server.farm.audit import audit
from tests.server.farm.jobs import (
    CRASH,
    LANES,
    ONE,
    SUCCEEDED,
    THREE,
    TWO,
    Clock,
    a_job,
    claim,
    frame_of,
    render,
    run,
    run_all,
)

# --- order ---


async def test_priority_then_age_then_number(queue: Queue) -> None:
    low = await queue.create_job(a_job(frames=2, priority=10))
    first = await queue.create_job(a_job(frames=2))
    second = await queue.create_job(a_job(frames=2))
    high = await queue.create_job(a_job(frames=1, priority=100))
    order = [(job.number, task) for job in (high, first, second, low) for task in (1, 2)]
    assert await run_all(queue) == [each for each in order if each != (high.number, 2)]


async def test_layers_of_a_job_are_mixed_by_number(queue: Queue) -> None:
    layers = (LayerPlan("a", b""), LayerPlan("b", b""))
    job = await queue.create_job(a_job(*layers, tasks=tuple(render("ba"[i % 2], i) for i in range(6))))
    assert await run_all(queue) == [(job.number, number) for number in range(1, 7)]


async def test_a_job_far_down_the_line_is_found(queue: Queue) -> None:
    for _ in range(40):
        await queue.create_job(a_job(LayerPlan("main", b"", limits=("none",)), frames=1))
    await queue.set_limit(Limit("none", 0, LimitUnit.TASK))
    free = await queue.create_job(a_job(frames=1, priority=0))
    assert await run_all(queue) == [(free.number, 1)]


async def test_several_lanes_get_different_tasks_at_once(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=2))
    claims = await queue.claim_many(LANES, LANES)
    assert [(each.attempt.worker, each.attempt.task) for each in claims] == [("north/1", 1), ("north/2", 2)]
    assert (await queue.job(job.number)).counts.running == 2


async def test_what_is_delayed_waits_and_the_next_one_runs(queue: Queue, clock: Clock) -> None:
    await queue.create_job(a_job(frames=2))
    await run(queue, Ending(ExitClass.LOST))
    assert (await claim(queue)).attempt.task == 2
    assert await queue.claim(ONE, LANES) is None
    wake = await queue.next_wake()
    assert wake == clock.now + 1
    clock.now = wake
    assert (await claim(queue)).attempt.task == 1


async def test_a_clock_that_was_set_back_delays_nothing_for_long(queue: Queue, clock: Clock) -> None:
    await queue.create_job(a_job(frames=1))
    await run(queue, Ending(ExitClass.LOST))
    clock.now -= 86_400
    assert await queue.next_wake() is None
    assert (await claim(queue)).attempt.number == 2


# --- limits ---


async def test_a_limit_by_task(queue: Queue) -> None:
    limited = await queue.create_job(a_job(LayerPlan("main", b"", limits=("gpu", "unknown")), frames=4))
    free = await queue.create_job(a_job(frames=1, priority=1))
    await queue.set_limit(Limit("gpu", 2, LimitUnit.TASK))
    claims = await queue.claim_many(LANES, LANES)
    assert [each.attempt.job for each in claims] == [limited.number, limited.number, free.number]
    assert await queue.limits() == [Limit("gpu", 2, LimitUnit.TASK, 2)]
    await queue.finish(claims[2].attempt, SUCCEEDED)
    assert await queue.claim(THREE, LANES) is None
    assert await queue.set_limit(Limit("gpu", 3, LimitUnit.TASK)) == Limit("gpu", 3, LimitUnit.TASK, 2)
    third = await claim(queue, THREE)
    await queue.set_limit(Limit("gpu", 0, LimitUnit.TASK))
    await queue.finish(third.attempt, SUCCEEDED)
    assert await queue.claim(THREE, LANES) is None


async def test_a_limit_by_host_counts_hosts_and_not_tasks(queue: Queue) -> None:
    await queue.create_job(a_job(LayerPlan("main", b"", limits=("licence",)), frames=9))
    await queue.set_limit(Limit("licence", 1, LimitUnit.HOST))
    north = [await claim(queue, lane) for lane in (ONE, TWO)]
    assert await queue.claim(THREE, LANES) is None
    assert await queue.limits() == [Limit("licence", 1, LimitUnit.HOST, 1)]
    for each in north:
        await queue.finish(each.attempt, SUCCEEDED)
    await claim(queue, THREE)
    assert await queue.claim(ONE, LANES) is None


async def test_a_limit_holds_within_one_call(queue: Queue) -> None:
    await queue.create_job(a_job(LayerPlan("main", b"", limits=("one",)), frames=4))
    await queue.set_limit(Limit("one", 1, LimitUnit.TASK))
    assert len(await queue.claim_many(LANES, LANES)) == 1


# --- where tasks have failed ---


async def test_a_task_is_not_given_again_to_where_it_failed_while_there_is_another_lane(
    queue: Queue, clock: Clock
) -> None:
    await queue.create_job(a_job(frames=1, retries=10))
    for lane, forbidden in ((ONE, [ONE]), (TWO, [ONE, TWO])):
        await run(queue, CRASH, lane)
        clock.now += 300
        for each in forbidden:
            assert await queue.claim(each, LANES) is None
    await run(queue, CRASH, THREE)
    clock.now += 300
    # Everywhere: so anywhere again.
    await run(queue, CRASH, TWO)
    clock.now += 300
    # A lane that went away does not count, one that is new does.
    four = Lane("south/2", "south")
    assert await queue.claim(ONE, [ONE, four]) is None
    await claim(queue, ONE, (ONE, TWO))


async def test_what_is_not_the_lanes_fault_does_not_count_against_it(queue: Queue, clock: Clock) -> None:
    await queue.create_job(a_job(frames=1))
    for how in (ExitClass.PREEMPTED, ExitClass.LOST):
        await run(queue, Ending(how))
        clock.now += 1
    assert (await claim(queue)).attempt.worker == ONE.name


async def test_a_job_does_not_use_a_lane_where_three_of_its_tasks_failed(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=6, retries=10))
    other = await queue.create_job(a_job(frames=1, priority=1))
    for count in range(3):
        assert await queue.blocked_jobs(ONE) == []
        assert (await run(queue, Ending(ExitClass.TIMEOUT))).task == count + 1
    assert await queue.blocked_jobs(ONE) == [job.number]
    assert await queue.blocked_jobs(TWO) == []
    assert (await claim(queue)).attempt.job == other.number
    assert (await claim(queue, TWO)).attempt.task == 1
    await audit(queue)


async def test_failing_twice_on_one_lane_counts_once(queue: Queue, clock: Clock) -> None:
    job = await queue.create_job(a_job(frames=3, retries=10))
    for _ in range(4):
        await run(queue, CRASH, ONE, (ONE,))
        clock.now += 300
    assert await queue.blocked_jobs(ONE) == []
    assert (await queue.task(job.number, 1)).failures == 4
    await audit(queue)


async def test_when_all_lanes_are_blocked_the_least_failed_is_used(queue: Queue) -> None:
    await queue.create_job(a_job(frames=8, retries=0))
    lanes = (ONE, TWO)
    for lane, live, tasks in ((ONE, lanes, 3), (ONE, (ONE,), 1), (TWO, lanes, 3)):
        for _ in range(tasks):
            await run(queue, Ending(ExitClass.TIMEOUT), lane, live)
    assert await queue.claim(ONE, lanes) is None
    assert (await claim(queue, TWO, lanes)).attempt.task == 8


async def test_a_block_and_a_failure_together_leave_a_way(queue: Queue) -> None:
    """A task that failed on the only lane its job still uses goes there again: the other is no alternative."""
    await queue.create_job(a_job(frames=4, retries=100))
    lanes = (ONE, TWO)
    for _ in range(3):
        await run(queue, Ending(ExitClass.TIMEOUT), ONE, lanes)
    fourth = await claim(queue, TWO, (TWO,))
    while fourth.attempt.task != 4:
        await queue.finish(fourth.attempt, SUCCEEDED)
        fourth = await claim(queue, TWO, (TWO,))
    await queue.finish(fourth.attempt, Ending(ExitClass.TIMEOUT))
    assert await queue.claim(ONE, lanes) is None
    assert (await claim(queue, TWO, lanes)).attempt.task == 4


async def test_a_retry_forgets_where_it_failed(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=3, retries=0))
    for _ in range(3):
        await run(queue, CRASH)
    await queue.retry(job.number, Selection(tasks=frozenset({1})))
    assert await queue.blocked_jobs(ONE) == []
    await audit(queue)
    assert (await claim(queue)).attempt.task == 1


lanes = st.lists(st.sampled_from("abcde"), min_size=1, unique=True)


@given(lanes, st.dictionaries(st.sampled_from("abcdef"), st.integers(0, 5)), st.sets(st.sampled_from("abcdef")))
def test_there_always_is_a_lane_for_a_job_and_a_task(
    live: list[str], failed_tasks: dict[str, int], failed_on: set[str]
) -> None:
    usable = usable_lanes(live, failed_tasks, 3)
    assert set(usable) <= set(live)
    assert usable
    allowed = [lane for lane in live if may_take(lane, usable, failed_on)]
    assert allowed
    if fresh := [lane for lane in usable if lane not in failed_on]:
        assert allowed == fresh


async def test_sql_and_the_pure_rule_agree(queue: Queue) -> None:
    """What a claim decides in SQL is what farm/blocklist.py says."""
    await queue.create_job(a_job(frames=4, retries=1000))
    failed: dict[int, set[str]] = {}
    for turn in range(40):
        live = [lane for bit, lane in enumerate(LANES) if (turn * 5 + 3) >> bit & 1] or [ONE]
        names = [lane.name for lane in live]
        blame = Counter(lane for lanes in failed.values() for lane in lanes)
        for lane in live:
            usable = usable_lanes(sorted(names), blame, 3)
            expected = next(
                (task for task in (1, 2, 3, 4) if may_take(lane.name, usable, failed.get(task, set()))), None
            )
            claimed = await queue.claim(lane, live)
            assert (claimed and claimed.attempt.task) == expected
            if claimed:
                fails = turn % 3 != 2
                await queue.finish(claimed.attempt, Ending(ExitClass.TIMEOUT if fails else ExitClass.PREEMPTED))
                if fails:
                    failed.setdefault(claimed.attempt.task, set()).add(lane.name)
                    blame = Counter(lane for lanes in failed.values() for lane in lanes)


# --- each task once ---


async def test_concurrent_claims_give_each_task_once(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=60))

    async def worker(lane: Lane) -> list[int]:
        taken = []
        while claimed := await queue.claim(lane, LANES):
            taken.append(claimed.attempt.task)
        return taken

    taken = await asyncio.gather(*(worker(Lane(f"h/{number}", "h")) for number in range(4)))
    assert sorted(chain.from_iterable(taken)) == list(range(1, 61))
    assert (await queue.job(job.number)).counts.running == 60
    await audit(queue)


TASKS, THREADS = 40, 4


def in_threads(work: Callable[[], list[int]]) -> list[int]:
    """What the threads took, all together."""
    with ThreadPoolExecutor(THREADS) as threads:
        return list(chain.from_iterable(threads.map(lambda _: work(), range(THREADS))))


async def filled(url: str) -> None:
    queue = await Queue.open(url)
    await queue.create_job(a_job(frames=TASKS))
    await queue.close()


async def test_transactions_of_several_connections_give_each_task_once(database_url: str) -> None:
    """Not even if two writers shared a database: the transactions themselves exclude each other."""
    await filled(database_url)
    url = url_of(database_url)

    def work() -> list[int]:
        # As Database makes its own, but without its ownership.
        engine = writing(url)
        taken: list[int] = []
        end = time.monotonic() + 10
        try:
            # With nothing there for it at the moment, another may have let go of the row it looked at.
            while len(taken) < TASKS // THREADS and time.monotonic() < end:
                with engine.begin() as connection:
                    transaction = Transaction(connection, time.time(), Policy())
                    taken += [each.attempt.task for each in claim_many(transaction, [ONE], [ONE])]
                    transaction.record()
        finally:
            engine.dispose()
        return taken

    taken = await asyncio.to_thread(in_threads, work)
    assert sorted(taken) == list(range(1, TASKS + 1))
    queue = await Queue.open(database_url)
    await audit(queue)
    await queue.close()


async def test_the_driver_left_to_itself_gives_tasks_twice_in_silence(tmp_path: Path) -> None:
    """The mutant that the test above has to reject: read and then write, in what only looks like a transaction."""
    url = f"sqlite:///{tmp_path}/queue.db"
    await filled(url)
    task = schema.task.c
    # So that all have read before any writes.
    together = threading.Barrier(THREADS, timeout=10)

    def work() -> list[int]:
        engine = create_engine(url, connect_args={"timeout": 10})
        taken: list[int] = []
        for _ in range(TASKS // THREADS):
            with engine.begin() as connection:
                ready = select(task.number).where(task.state == "ready").order_by(task.number).limit(1)
                number = connection.execute(ready).scalar_one()
                together.wait()
                connection.execute(update(schema.task).where(task.number == number).values(state="running"))
            taken.append(number)
            together.wait()
        engine.dispose()
        return taken

    taken = await asyncio.to_thread(in_threads, work)
    assert len(taken) == TASKS
    assert len(set(taken)) < TASKS


# --- speed by design ---


async def test_a_claim_and_what_goes_with_it_walk_along_indices(tmp_path: Path) -> None:
    """However many tasks have ended: SQLite says how it finds the rows of each statement."""
    queue = await Queue.open(f"sqlite:///{tmp_path}/queue.db")
    steps: set[str] = set()

    def explain(connection: Connection, _cursor: object, statement: str, parameters: Any, *_: object) -> None:
        if statement.startswith(("SELECT", "UPDATE", "DELETE")):
            cursor = connection.connection.cursor()
            cursor.execute(f"EXPLAIN QUERY PLAN {statement}", parameters)
            steps.update(row[3] for row in cursor.fetchall())

    try:
        await queue.set_limit(Limit("gpu", 0, LimitUnit.TASK))
        job = await queue.create_job(a_job(LayerPlan("main", b"", limits=("none",)), frames=4))
        await run(queue, Ending(ExitClass.TIMEOUT), TWO)
        for engine in (queue._database._writer, queue._database._reader):
            listen(engine, "before_cursor_execute", explain)
        claimed = await claim(queue)
        await queue.stage_frame(claimed.attempt, frame_of(claimed), "/tmp/x")
        await queue.commit_frame(claimed.attempt, frame_of(claimed))
        await queue.finish(claimed.attempt, SUCCEEDED)
        await queue.next_wake()
        await queue.orders()
        await queue.events(job.number, 1, 10)
        await queue.tasks(job.number, 10, after=1)
        await queue.tasks(job.number, 10, after=1, states=[TaskState.READY])
        await queue.frames(job.number, 10, after=("main", 0))
        await queue.usage("ada")
        await queue.wait_facts(job.number, 3)
    finally:
        await queue.close()
    # What has no more rows than there are lanes, or limits, or jobs that have a task to give.
    short = ("ix_attempt_running", "ix_job_claim", "limit", "CONSTANT ROW", "(subquery")
    assert [step for step in steps if step.startswith("SCAN") and not any(name in step for name in short)] == []
    for index in ("ix_job_claim", "ix_task_claim", "ix_task_delayed", "ix_frame_image", "ix_job_open"):
        assert any(index in step for step in steps), index
