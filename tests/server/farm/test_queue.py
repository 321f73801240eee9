"""Laws of the durable queue, on both databases: jobs, what depends on what, steering, frames, events, tokens."""

import asyncio
import random
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest
import sqlalchemy

from footlight_server.farm.model import (
    Claim,
    Ending,
    EventKind,
    ExitClass,
    JobPlan,
    JobState,
    LayerPlan,
    Limit,
    LimitUnit,
    Selection,
    TaskCounts,
    TaskPlan,
    TaskState,
    Usage,
)
from footlight_server.farm.queue import Queue
from footlight_server.farm.sql.create import create_job
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.tokens import Scope
from footlight_server.sessions.errors import (
    FrameNotFoundError,
    JobEndedError,
    JobNotEndedError,
    JobNotFoundError,
    RequestIdReusedError,
    StorageError,
    TaskNotFoundError,
    TokenNotFoundError,
)
from tests.server.farm.audit import audit
from tests.server.farm.jobs import (
    CANCELLED,
    CRASH,
    LANES,
    ONE,
    SCENE,
    SUCCEEDED,
    TWO,
    Clock,
    a_job,
    claim,
    frame_of,
    merge,
    render,
    run,
    run_all,
)

Call = Callable[[], Awaitable[object]]


async def states(queue: Queue, job: int) -> list[str]:
    return [task.state.value for task in await queue.tasks(job, 1000)]


# --- jobs ---


async def test_a_job_is_kept_as_it_was_given(queue: Queue, clock: Clock) -> None:
    plan = a_job(show="film", shot="a10", tags=("night", "hero"), paused=True, priority=70)
    job = await queue.create_job(plan)
    assert (job.title, job.user, job.spec, job.show, job.shot) == ("a job", "ada", b"job", "film", "a10")
    assert (job.tags, job.paused, job.priority, job.retries) == (("hero", "night"), True, 70, 2)
    assert (job.state, job.created, job.started, job.ended) == (JobState.QUEUED, clock.now, None, None)
    assert (job.counts, job.frames_done, job.frames_total) == (TaskCounts(ready=3), 0, 3)
    assert await queue.job(job.number) == job
    assert await queue.layer_spec(job.number, "main") == b"layer main"
    with pytest.raises(JobNotFoundError):
        await queue.job(job.number + 1)
    with pytest.raises(FrameNotFoundError):
        await queue.layer_spec(job.number, "other")


async def test_a_job_runs_to_its_end(queue: Queue, clock: Clock) -> None:
    job = await queue.create_job(a_job())
    clock.now += 5
    first = await claim(queue)
    assert (first.attempt.number, first.attempt.worker, first.attempt.host) == (1, "north/1", "north")
    assert (first.job_spec, first.layer_spec, first.user) == (b"job", b"layer main", "ada")
    assert first.task.state is TaskState.RUNNING
    assert first.task.last_attempt == first.attempt
    running = await queue.job(job.number)
    assert (running.state, running.started, running.counts) == (
        JobState.RUNNING,
        clock.now,
        TaskCounts(ready=2, running=1),
    )
    clock.now += 5
    ended = await queue.finish(first.attempt, replace(SUCCEEDED, peak_memory_bytes=99))
    assert ended is not None
    assert ended.state is TaskState.SUCCEEDED
    assert ended.last_attempt is not None
    assert (ended.last_attempt.ended, ended.last_attempt.exit_class) == (clock.now, ExitClass.SUCCEEDED)
    assert ended.last_attempt.peak_memory_bytes == 99
    assert await run_all(queue) == [(job.number, 2), (job.number, 3)]
    done = await queue.job(job.number)
    assert (done.state, done.ended, done.counts) == (JobState.SUCCEEDED, clock.now, TaskCounts(succeeded=3))
    assert done.render_seconds > 0
    await audit(queue)


async def test_the_same_request_makes_one_job(queue: Queue) -> None:
    plan = a_job(request_id="r1")
    jobs = await asyncio.gather(*(queue.create_job(plan) for _ in range(5)))
    assert len({job.number for job in jobs}) == 1
    assert await queue.job_of_request("ada", "r1") == jobs[0]
    assert await queue.job_of_request("bob", "r1") is None
    other = await queue.create_job(replace(plan, user="bob"))
    assert other.number != jobs[0].number
    with pytest.raises(RequestIdReusedError):
        await queue.create_job(replace(plan, spec=b"another"))
    await queue.cancel(jobs[0].number)
    await queue.prune([jobs[0].number])
    assert (await queue.create_job(plan)).number > other.number


async def test_a_plan_that_contradicts_itself_is_refused_whole(queue: Queue) -> None:
    main = LayerPlan("main", b"")
    bad = [
        a_job(main, tasks=(render("other", 1),)),
        a_job(main, main),
        a_job(main, tasks=(render("main", 1, needs=(1,)), render("main", 2))),
        a_job(main, tasks=(render("main", 1), render("main", 1))),
    ]
    for plan in bad:
        with pytest.raises(ValueError, match=r"layers|task|frames"):
            await queue.create_job(plan)
    with pytest.raises(JobNotFoundError):
        await queue.create_job(a_job(depends=(77,)))
    assert await queue.jobs(10) == []


async def test_jobs_are_listed_newest_first_by_pages_and_filters(queue: Queue) -> None:
    numbers = [(await queue.create_job(a_job(frames=1, user=f"user{i % 2}"))).number for i in range(7)]
    special = await queue.create_job(a_job(frames=1, show="film", shot="a10", tags=("hero",)))
    await run(queue)
    seen: list[int] = []
    while page := await queue.jobs(3, before=seen[-1] if seen else None):
        seen += [job.number for job in page]
    assert seen == [special.number, *reversed(numbers)]
    assert [job.number for job in await queue.jobs(10, user="user1")] == numbers[5::-2]
    for filters in ({"show": "film"}, {"shot": "a10"}, {"tag": "hero"}):
        assert [job.number for job in await queue.jobs(10, **filters)] == [special.number]
    assert await queue.jobs(10, tag="her") == []
    assert [job.number for job in await queue.jobs(10, states=[JobState.SUCCEEDED])] == [numbers[0]]
    assert await queue.usage("user1") == Usage(3, 3)
    assert await queue.usage("user0") == Usage(3, 3)
    assert await queue.usage("nobody") == Usage(0, 0)


async def test_tasks_are_listed_by_pages_and_filters(queue: Queue) -> None:
    layers = (LayerPlan("a", b""), LayerPlan("b", b""))
    tasks = tuple(render("ab"[i % 2], i) for i in range(20))
    job = await queue.create_job(a_job(*layers, tasks=tasks))
    await run(queue)
    seen: list[int] = []
    while page := await queue.tasks(job.number, 6, after=seen[-1] if seen else 0):
        seen += [task.number for task in page]
    assert seen == list(range(1, 21))
    assert [task.number for task in await queue.tasks(job.number, 3, layer="b")] == [2, 4, 6]
    assert [task.number for task in await queue.tasks(job.number, 9, states=[TaskState.SUCCEEDED])] == [1]
    assert (await queue.task(job.number, 4)).frames == (3,)
    assert await queue.tasks(job.number, 9, layer="c") == []
    with pytest.raises(JobNotFoundError):
        await queue.tasks(job.number + 1, 9)
    with pytest.raises(TaskNotFoundError):
        await queue.task(job.number, 21)
    with pytest.raises(TaskNotFoundError):
        await queue.attempts(job.number, 21)


# --- what depends on what ---


async def test_a_task_waits_for_the_tasks_it_needs(queue: Queue) -> None:
    tasks = (render("main", 1), render("main", 2), render("main", 3, needs=(0, 1)))
    job = await queue.create_job(a_job(tasks=tasks))
    assert await states(queue, job.number) == ["ready", "ready", "blocked"]
    await run(queue)
    assert await states(queue, job.number) == ["succeeded", "ready", "blocked"]
    await run(queue)
    assert await states(queue, job.number) == ["succeeded", "succeeded", "ready"]
    await audit(queue)


async def test_a_layer_waits_for_the_whole_of_another(queue: Queue) -> None:
    layers = (LayerPlan("fx", b""), LayerPlan("empty", b""), LayerPlan("beauty", b"", depends=("fx", "empty")))
    tasks = (render("fx", 1), render("fx", 2), render("beauty", 1), render("beauty", 2))
    job = await queue.create_job(a_job(*layers, tasks=tasks))
    await run(queue)
    assert await states(queue, job.number) == ["succeeded", "ready", "blocked", "blocked"]
    await audit(queue)
    await run(queue)
    assert await states(queue, job.number) == ["succeeded", "succeeded", "ready", "ready"]
    await audit(queue)
    assert len(await run_all(queue)) == 2
    assert (await queue.job(job.number)).state is JobState.SUCCEEDED


async def test_a_job_waits_for_another_to_succeed(queue: Queue) -> None:
    first = await queue.create_job(a_job(frames=2, retries=0))
    second = await queue.create_job(a_job(frames=1, depends=(first.number,)))
    third = await queue.create_job(a_job(frames=1, depends=(first.number, second.number)))
    await run(queue, SCENE)
    await run(queue)
    assert (await queue.job(first.number)).state is JobState.FAILED
    assert (await queue.job(second.number)).state is JobState.QUEUED
    assert await queue.claim(ONE, LANES) is None
    await queue.retry(first.number, Selection())
    assert await run_all(queue) == [(first.number, 1), (second.number, 1), (third.number, 1)]
    for job in (first, second, third):
        assert (await queue.job(job.number)).state is JobState.SUCCEEDED
    late = await queue.create_job(a_job(frames=1, depends=(first.number,)))
    assert late.counts == TaskCounts(ready=1)
    await audit(queue)


async def test_a_retry_shuts_the_gates_that_a_skip_has_opened(queue: Queue) -> None:
    layers = (LayerPlan("fx", b""), LayerPlan("beauty", b"", depends=("fx",)))
    tasks = (render("fx", 1), render("fx", 2, needs=(0,)), render("beauty", 1))
    job = await queue.create_job(a_job(*layers, tasks=tasks))
    after = await queue.create_job(a_job(frames=1, depends=(job.number,)))
    _, changed = await queue.skip(job.number, Selection(layer="fx"))
    assert changed == 2
    assert await states(queue, job.number) == ["skipped", "skipped", "ready"]
    await audit(queue)
    await queue.skip(job.number, Selection(layer="beauty"))
    assert await states(queue, after.number) == ["ready"]
    _, changed = await queue.retry(job.number, Selection())
    assert changed == 3
    assert await states(queue, job.number) == ["ready", "blocked", "blocked"]
    assert await states(queue, after.number) == ["blocked"]
    await audit(queue)
    assert [task for number, task in await run_all(queue) if number == job.number] == [1, 2, 3]
    await audit(queue)


async def test_what_needs_a_failed_task_stays_until_it_is_skipped_or_retried(queue: Queue) -> None:
    tasks = (render("main", 1), render("main", 2, needs=(0,)))
    job = await queue.create_job(a_job(tasks=tasks, retries=0))
    await run(queue, SCENE)
    failed = await queue.job(job.number)
    assert (failed.state, failed.counts) == (JobState.FAILED, TaskCounts(failed=1, blocked=1))
    opened, changed = await queue.skip(job.number, Selection(tasks=frozenset({1})))
    assert (opened.state, opened.ended, changed) == (JobState.RUNNING, None, 1)
    await run(queue)
    assert (await queue.job(job.number)).state is JobState.SUCCEEDED
    await audit(queue)


# --- steering ---


async def test_a_paused_job_starts_nothing_and_what_runs_goes_on(queue: Queue) -> None:
    job = await queue.create_job(a_job())
    first = await claim(queue)
    assert (await queue.pause(job.number)).paused
    assert (await queue.pause(job.number)).paused
    assert await queue.claim(TWO, LANES) is None
    assert await queue.finish(first.attempt, SUCCEEDED) is not None
    assert not (await queue.resume(job.number)).paused
    await run_all(queue)
    for steer in (queue.pause, queue.resume):
        with pytest.raises(JobEndedError):
            await steer(job.number)


async def test_cancelling_ends_what_waits_at_once_and_what_runs_when_it_is_stopped(queue: Queue) -> None:
    job = await queue.create_job(a_job())
    done = await run(queue)
    running = await claim(queue)
    assert await queue.orders() == []
    cancelling = await queue.cancel(job.number)
    assert cancelling.state is JobState.CANCELLING
    assert cancelling.counts == TaskCounts(succeeded=1, running=1, cancelled=1)
    assert await queue.orders() == [running.attempt]
    assert (await queue.cancel(job.number)).state is JobState.CANCELLING
    stopped = await queue.finish(running.attempt, CANCELLED)
    assert stopped is not None
    assert stopped.state is TaskState.CANCELLED
    assert await queue.orders() == []
    ended = await queue.job(job.number)
    assert (ended.state, ended.counts) == (JobState.CANCELLED, TaskCounts(succeeded=1, cancelled=2))
    assert await queue.cancel(job.number) == ended
    assert await queue.finish(done, SUCCEEDED) is None
    again, changed = await queue.retry(job.number, Selection())
    assert (again.state, changed) == (JobState.RUNNING, 2)
    await run_all(queue)
    assert (await queue.job(job.number)).state is JobState.SUCCEEDED
    await audit(queue)


async def test_skipping_a_running_task_stops_it(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=1))
    running = await claim(queue)
    skipping, changed = await queue.skip(job.number, Selection())
    assert (skipping.state, changed) == (JobState.RUNNING, 1)
    assert await queue.orders() == [running.attempt]
    await queue.finish(running.attempt, CRASH)
    assert await states(queue, job.number) == ["skipped"]
    assert (await queue.job(job.number)).state is JobState.SUCCEEDED
    await audit(queue)


async def test_a_selection_is_by_number_layer_and_frame(queue: Queue) -> None:
    layers = (LayerPlan("a", b""), LayerPlan("b", b""))
    tasks = (render("a", 1, 2), render("a", 3, 4), render("b", 1, 2), render("b", 3, 4))
    job = await queue.create_job(a_job(*layers, tasks=tasks))

    async def chosen(selection: Selection) -> list[int]:
        await queue.skip(job.number, selection)
        skipped = await queue.tasks(job.number, 9, states=[TaskState.SKIPPED])
        await queue.retry(job.number, Selection())
        return [task.number for task in skipped]

    assert await chosen(Selection(tasks=frozenset({2, 3}))) == [2, 3]
    assert await chosen(Selection(layer="b")) == [3, 4]
    assert await chosen(Selection(frames=frozenset({2, 99}))) == [1, 3]
    assert await chosen(Selection(layer="a", frames=frozenset({4}))) == [2]
    assert await chosen(Selection(tasks=frozenset({1}), frames=frozenset({4}))) == []
    assert await chosen(Selection(frames=frozenset())) == []
    assert await chosen(Selection()) == [1, 2, 3, 4]
    for selection in (Selection(tasks=frozenset({5})), Selection(layer="c")):
        with pytest.raises(TaskNotFoundError):
            await queue.skip(job.number, selection)
        with pytest.raises(TaskNotFoundError):
            await queue.retry(job.number, selection)


async def test_pruned_is_gone_and_numbers_are_not_given_again(queue: Queue, clock: Clock) -> None:
    first = await queue.create_job(a_job(frames=1, bundles=("d1", "d2"), tags=("hero",)))
    second = await queue.create_job(a_job(frames=1, bundles=("d2", "d3")))
    assert await queue.bundles_in_use() == {"d1", "d2", "d3"}
    await run(queue)
    with pytest.raises(JobNotEndedError):
        await queue.prune([first.number, second.number])
    await run(queue)
    clock.now += 100
    assert await queue.prunable(99) == [first.number, second.number]
    assert await queue.prunable(99, user="bob") == []
    assert await queue.prunable(101) == []
    last = queue.last_event()
    await queue.prune([second.number])
    assert await queue.bundles_in_use() == {"d1", "d2"}
    for gone in (queue.job, queue.cancel):
        with pytest.raises(JobNotFoundError):
            await gone(second.number)
    with pytest.raises(JobNotFoundError):
        await queue.prune([second.number])
    third = await queue.create_job(a_job())
    assert third.number > second.number
    assert [event.id > last for event in await queue.events(third.number, 0, 10)] == [True]


async def test_a_job_that_failed_is_kept_while_another_waits_for_it(queue: Queue, clock: Clock) -> None:
    failed = await queue.create_job(a_job(frames=1))
    await run(queue, SCENE)
    waiting = await queue.create_job(a_job(frames=1, depends=(failed.number,)))
    clock.now += 1
    assert await queue.prunable(0) == []
    with pytest.raises(JobNotEndedError):
        await queue.prune([failed.number])
    await queue.cancel(waiting.number)
    clock.now += 1
    assert await queue.prunable(0) == [failed.number, waiting.number]


async def test_a_job_that_succeeded_is_not_needed_by_those_that_waited_for_it(queue: Queue, clock: Clock) -> None:
    done = await queue.create_job(a_job(frames=1))
    waiting = await queue.create_job(a_job(frames=1, depends=(done.number,)))
    await run(queue)
    clock.now += 1
    assert await queue.prunable(0) == [done.number]
    await queue.prune([done.number])
    assert await run_all(queue) == [(waiting.number, 1)]
    await audit(queue)


# --- attempts ---


async def test_a_failure_is_tried_again_after_a_pause_and_every_try_is_kept(queue: Queue, clock: Clock) -> None:
    job = await queue.create_job(a_job(frames=1))
    for number in (1, 2, 3):
        claimed = await claim(queue, LANES[number - 1])
        assert claimed.attempt.number == number
        task = await queue.finish(claimed.attempt, CRASH)
        assert task is not None
        assert task.failures == number
        if number < 3:
            assert task.state is TaskState.READY
            assert await queue.claim(TWO, [TWO]) is None
            assert await queue.next_wake() == task.not_before
            clock.now = task.not_before
            assert await queue.next_wake() is None
    assert (await queue.job(job.number)).state is JobState.FAILED
    attempts = await queue.attempts(job.number, 1)
    assert [(a.number, a.worker, a.exit_class) for a in attempts] == [
        (number, lane.name, ExitClass.CRASH) for number, lane in enumerate(LANES, 1)
    ]
    assert (attempts[0].message, attempts[0].prim_path, attempts[0].peak_memory_bytes) == (
        CRASH.message,
        "/World",
        1000,
    )


async def test_only_the_current_attempt_may_stage_commit_and_finish(queue: Queue) -> None:
    await queue.create_job(a_job(frames=1))
    old = await claim(queue)
    await queue.finish(old.attempt, Ending(ExitClass.PREEMPTED))
    new = await claim(queue)
    assert new.attempt.number == old.attempt.number + 1
    assert not await queue.stage_frame(old.attempt, frame_of(old), "/tmp/a")
    assert not await queue.commit_frame(old.attempt, frame_of(old))
    assert await queue.finish(old.attempt, SUCCEEDED) is None
    assert await queue.stage_frame(new.attempt, frame_of(new), "/tmp/b")
    assert await queue.commit_frame(new.attempt, frame_of(new))
    assert await queue.finish(new.attempt, SUCCEEDED) is not None
    assert not await queue.commit_frame(new.attempt, frame_of(new))
    await audit(queue)


async def test_what_a_message_may_hold(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=1))
    await run(queue, Ending(ExitClass.SCENE, "a\0b \udcff ü %s", "/W\0"))
    [attempt] = await queue.attempts(job.number, 1)
    assert attempt.message == "a\ufffdb ? ü %s"


async def test_recovery_gives_back_what_ran(queue: Queue, database_url: str, clock: Clock) -> None:
    job = await queue.create_job(a_job())
    cancelled = await queue.create_job(a_job(frames=1))
    skipped = await queue.create_job(a_job(frames=1))
    claimed = await queue.claim_many([ONE, TWO], LANES)
    await queue.pause(job.number)
    claimed += await queue.claim_many([LANES[2]], LANES)
    claimed += await queue.claim_many([LANES[2]], LANES)
    await queue.cancel(cancelled.number)
    await queue.skip(skipped.number, Selection())
    assert len(claimed) == 4
    assert await queue.running() == [each.attempt for each in claimed]
    await queue.close()
    again = await Queue.open(database_url, clock)
    try:
        assert await again.recover() == 4
        assert await again.running() == []
        assert await states(again, job.number) == ["ready"] * 3
        assert (await again.task(job.number, 1)).failures == 0
        assert (await again.job(cancelled.number)).state is JobState.CANCELLED
        assert (await again.job(skipped.number)).state is JobState.SUCCEEDED
        assert [a.exit_class for a in await again.attempts(job.number, 1)] == [ExitClass.PREEMPTED]
        for each in claimed:
            assert await again.finish(each.attempt, SUCCEEDED) is None
        await audit(again)
    finally:
        await again.close()


# --- frames ---


async def test_frames_are_counted_once_and_listed_by_pages(queue: Queue) -> None:
    layers = (LayerPlan("Z", b""), LayerPlan("a", b""))
    job = await queue.create_job(a_job(*layers, tasks=(render("a", 2, -1, 10), render("Z", 7))))
    claims = await queue.claim_many([ONE, TWO], LANES)
    for claimed in claims:
        for number in claimed.task.frames:
            for _ in range(2):
                assert await queue.stage_frame(claimed.attempt, frame_of(claimed, number), "/tmp/x")
                assert await queue.commit_frame(claimed.attempt, frame_of(claimed, number))
    assert (await queue.job(job.number)).frames_done == 4
    assert (await queue.task(job.number, 1)).frames_done == 3
    order = [("Z", 7), ("a", -1), ("a", 2), ("a", 10)]
    seen: list[tuple[str, int]] = []
    while page := await queue.frames(job.number, 3, after=seen[-1] if seen else None):
        seen += [(frame.layer, frame.frame) for frame in page]
    assert seen == order
    assert await queue.frame(job.number, "a", -1) == frame_of(claims[0], -1)
    for layer, number in (("a", 7), ("Z", 2), ("x", 7)):
        with pytest.raises(FrameNotFoundError):
            await queue.frame(job.number, layer, number)
    with pytest.raises(JobNotFoundError):
        await queue.frames(job.number + 1, 3)
    await audit(queue)


async def test_a_frame_that_is_there_is_not_rendered_again(queue: Queue, clock: Clock) -> None:
    job = await queue.create_job(a_job(tasks=(render("main", 1, 2, 3),)))
    first = await claim(queue)
    assert first.done == frozenset()
    await queue.commit_frame(first.attempt, frame_of(first, 2))
    await queue.finish(first.attempt, Ending(ExitClass.LOST))
    clock.now += 1
    second = await claim(queue, TWO)
    assert second.done == {2}
    await queue.finish(second.attempt, SCENE)
    await queue.retry(job.number, Selection())
    assert (await claim(queue)).done == {2}


async def test_parts_are_merged_and_are_no_images(queue: Queue) -> None:
    tasks = (
        render("main", 5, samples=(0, 8)),
        render("main", 5, samples=(8, 16)),
        merge("main", 5, (0, 1)),
    )
    job = await queue.create_job(a_job(tasks=tasks))
    assert job.frames_total == 1
    parts = [await claim(queue, lane) for lane in (ONE, TWO)]
    for part in parts:
        await queue.commit_frame(part.attempt, frame_of(part))
        await queue.finish(part.attempt, SUCCEEDED)
    assert await queue.frames(job.number, 10) == []
    assert (await queue.job(job.number)).frames_done == 0
    merging = await claim(queue)
    assert merging.needs_from == (1, 2)
    assert await queue.parts(job.number, merging.needs_from) == [frame_of(part) for part in parts]
    assert await queue.commit_frame(merging.attempt, frame_of(merging))
    assert await queue.frame(job.number, "main", 5) == frame_of(merging)
    assert (await queue.job(job.number)).frames_done == 1
    kinds = [event.kind for event in await queue.events(job.number, 0, 100)]
    assert kinds.count(EventKind.FRAME) == 1
    await audit(queue)


async def test_what_was_staged_is_known_after_a_restart(queue: Queue, database_url: str, clock: Clock) -> None:
    await queue.create_job(a_job(tasks=(render("main", 1, 2, 3),)))
    claimed = await claim(queue)
    for number in (1, 2, 3):
        assert await queue.stage_frame(claimed.attempt, frame_of(claimed, number), f"/tmp/{number}")
    await queue.commit_frame(claimed.attempt, frame_of(claimed, 1))
    await queue.close()
    again = await Queue.open(database_url, clock)
    try:
        two, three = await again.staged()
        assert (two.attempt, two.frame, two.temp_path) == (claimed.attempt, frame_of(claimed, 2), "/tmp/2")
        assert await again.commit_frame(two.attempt, two.frame)
        await again.unstage(three)
        assert await again.staged() == []
        assert await again.recover() == 1
        assert (await claim(again)).done == {1, 2}
    finally:
        await again.close()


async def test_an_attempt_that_ends_leaves_nothing_staged(queue: Queue) -> None:
    await queue.create_job(a_job(frames=1))
    claimed = await claim(queue)
    await queue.stage_frame(claimed.attempt, frame_of(claimed), "/tmp/x")
    await queue.finish(claimed.attempt, CRASH)
    assert await queue.staged() == []


# --- what has happened ---


async def test_events_tell_the_whole_story_and_resume_anywhere(queue: Queue, clock: Clock) -> None:
    job = await queue.create_job(a_job(frames=2))
    other = await queue.create_job(a_job(frames=1, priority=1))
    claimed = await claim(queue)
    await queue.commit_frame(claimed.attempt, frame_of(claimed))
    await queue.finish(claimed.attempt, SUCCEEDED)
    await queue.pause(job.number)
    await queue.cancel(job.number)
    story = await queue.events(job.number, 0, 100)
    assert [(e.kind.value, e.task, e.frame, e.state) for e in story] == [
        ("job", None, None, "queued"),
        ("task", 1, None, "running"),
        ("job", None, None, "running"),
        ("frame", 1, 1000, ""),
        ("task", 1, None, "succeeded"),
        ("job", None, None, "running"),
        ("task", 2, None, "cancelled"),
        ("job", None, None, "cancelled"),
    ]
    assert all(e.job == job.number and e.time == clock.now for e in story)
    assert {e.layer for e in story if e.task} == {"main"}
    assert story == sorted(story, key=lambda e: e.id)
    for index, event in enumerate(story):
        assert await queue.events(job.number, event.id, 3) == story[index + 1 : index + 4]
    assert queue.last_event() == story[-1].id
    assert len(await queue.events(other.number, 0, 100)) == 1


async def test_events_of_before_a_restart_are_there(queue: Queue, database_url: str, clock: Clock) -> None:
    job = await queue.create_job(a_job())
    story = await queue.events(job.number, 0, 100)
    await queue.close()
    again = await Queue.open(database_url, clock)
    try:
        assert await again.events(job.number, 0, 100) == story
        assert again.last_event() == story[-1].id
        assert await again.events(job.number, story[-1].id, 100) == []
        await again.pause(job.number)
        assert len(await again.events(job.number, story[-1].id, 100)) == 1
    finally:
        await again.close()


async def test_whoever_waits_for_changes_misses_none(queue: Queue) -> None:
    calls: list[Call] = [
        lambda: queue.create_job(a_job()),
        lambda: queue.set_limit(Limit("gpu", 1, LimitUnit.TASK)),
        lambda: queue.pause(1),
        lambda: queue.resume(1),
        lambda: queue.claim(ONE, LANES),
        lambda: queue.skip(1, Selection()),
        lambda: queue.cancel(1),
    ]
    for call in calls:
        seen = queue.changed.count
        waiting = [asyncio.create_task(queue.changed.wait(seen)) for _ in range(3)]
        await asyncio.sleep(0)
        await call()
        assert await asyncio.wait_for(asyncio.gather(*waiting), 5) == [seen + 1] * 3
        assert await asyncio.wait_for(queue.changed.wait(seen), 1) == seen + 1
    seen = queue.changed.count
    await queue.jobs(10)
    assert await queue.claim(TWO, LANES) is None
    assert queue.changed.count == seen


async def test_a_claim_that_nobody_took_is_given_back(queue: Queue) -> None:
    job = await queue.create_job(a_job(frames=1))
    claiming = asyncio.create_task(queue.claim(ONE, LANES))
    await asyncio.sleep(0)
    claiming.cancel()
    with pytest.raises(asyncio.CancelledError):
        await claiming
    async with asyncio.timeout(10):
        while not await queue.attempts(job.number, 1) or (await queue.job(job.number)).counts.running:
            await asyncio.sleep(0.01)
    assert (await queue.job(job.number)).counts.ready == 1
    assert [a.exit_class for a in await queue.attempts(job.number, 1)] == [ExitClass.PREEMPTED]
    await audit(queue)


async def test_calls_that_share_a_commit_fail_alone(queue: Queue) -> None:
    first = await queue.create_job(a_job())
    calls: list[Awaitable[object]] = []
    for number in range(10):
        calls += [
            queue.create_job(a_job(frames=1, title=f"good {number}")),
            queue.create_job(a_job(tasks=(render("nowhere", 1),))),
            queue.pause(99),
            queue.create_job(a_job(title=None)),
        ]
    commits = 0

    def count(_: object) -> None:
        nonlocal commits
        commits += 1

    sqlalchemy.event.listen(queue._database._writer, "commit", count)
    outcomes = await asyncio.gather(*calls, queue.skip(first.number, Selection()), return_exceptions=True)
    kinds = [type(outcome).__name__ for outcome in outcomes]
    assert kinds == ["Job", "ValueError", "JobNotFoundError", "IntegrityError"] * 10 + ["tuple"]
    jobs = await queue.jobs(100)
    assert sorted(job.title for job in jobs) == ["a job", *(f"good {number}" for number in range(10))]
    await audit(queue)
    # Without what the database itself refuses they do share it.
    commits = 0
    await asyncio.gather(*(queue.pause(jobs[0].number) for _ in range(50)))
    assert commits < 25


async def test_a_call_that_fails_half_way_leaves_nothing_in_a_commit_it_shares(queue: Queue) -> None:
    def give_up_half_way(transaction: Transaction) -> None:
        create_job(transaction, a_job(title="half"))
        raise ValueError("no")

    calls: list[Awaitable[object]] = []
    for _ in range(10):
        calls += [queue._write(give_up_half_way), queue.create_job(a_job())]
    outcomes = await asyncio.gather(*calls, return_exceptions=True)
    assert [type(outcome).__name__ for outcome in outcomes] == ["ValueError", "Job"] * 10
    assert [job.title for job in await queue.jobs(100)] == ["a job"] * 10
    await audit(queue)


async def test_a_queue_that_is_closed_says_so(database_url: str) -> None:
    queue = await Queue.open(database_url)
    waiting = [asyncio.create_task(queue.create_job(a_job())) for _ in range(5)]
    await asyncio.sleep(0)
    await queue.close()
    assert len(await asyncio.gather(*waiting)) == 5
    for call in (queue.jobs(10), queue.create_job(a_job())):
        with pytest.raises(StorageError, match="closed"):
            await call


# --- tokens ---


async def test_tokens_are_kept_by_their_hash(queue: Queue, clock: Clock) -> None:
    token = await queue.create_token("h1", "ada", Scope.SUBMIT, "laptop", clock.now + 10)
    assert (token.user, token.scope, token.comment, token.created) == ("ada", Scope.SUBMIT, "laptop", clock.now)
    assert await queue.token_by_hash("h1") == token
    assert await queue.token_by_hash("h2") is None
    other = await queue.create_token("h2", "bob", Scope.ADMIN)
    assert await queue.tokens() == [token, other]
    await queue.touch_token(token.number, clock.now + 5)
    await queue.touch_token(token.number, clock.now + 1)
    revoked = await queue.revoke_token(token.number)
    assert (revoked.last_used, revoked.revoked) == (clock.now + 5, clock.now)
    clock.now += 50
    assert await queue.revoke_token(token.number) == revoked
    assert await queue.token_by_hash("h1") == revoked
    with pytest.raises(TokenNotFoundError):
        await queue.revoke_token(99)


# --- everything at once ---


@pytest.mark.parametrize("seed", range(2))
async def test_whatever_is_done_nothing_contradicts_itself_and_all_comes_to_an_end(
    queue: Queue, clock: Clock, seed: int
) -> None:
    chance = random.Random(seed)
    await queue.set_limit(Limit("two", 2, LimitUnit.TASK))
    await queue.set_limit(Limit("host", 1, LimitUnit.HOST))
    jobs: list[int] = []
    running: list[Claim] = []
    for turn in range(150):
        what = chance.choices(
            ["create", "claim", "finish", "skip", "retry", "cancel", "pause", "commit", "recover"],
            [2 if len(jobs) < 8 else 0, 12, 12, 1, 2, 0.3, 1, 3, 0.3],
        )[0]
        clock.now += chance.random() * 20
        job = chance.choice(jobs) if jobs else 0
        if what == "create":
            jobs.append((await queue.create_job(some_job(chance, jobs))).number)
        elif what == "claim":
            lanes = [lane for lane in LANES if lane.name not in {each.attempt.worker for each in running}]
            running += await queue.claim_many(lanes[: chance.randint(0, 3)], LANES)
        elif what == "finish" and running:
            each = running.pop(chance.randrange(len(running)))
            await queue.finish(each.attempt, Ending(chance.choice([*ExitClass, *[ExitClass.SUCCEEDED] * 9])))
        elif what == "commit" and running:
            each = chance.choice(running)
            await queue.commit_frame(each.attempt, frame_of(each))
        elif what in {"skip", "retry"} and job:
            steer = queue.skip if what == "skip" else queue.retry
            await steer(job, Selection(frames=frozenset(chance.sample(range(8), 3))))
        elif what == "cancel" and job:
            await queue.cancel(job)
        elif what == "pause" and job and not (await queue.job(job)).state.ended:
            await (queue.pause if chance.random() < 0.5 else queue.resume)(job)
        elif what == "recover":
            await queue.recover()
            running = []
        stopped = await queue.orders()
        for each in [each for each in running if each.attempt in stopped and chance.random() < 0.5]:
            running.remove(each)
            await queue.finish(each.attempt, CANCELLED)
        if turn % 15 == 0:
            await audit(queue)
    for each in running:
        await queue.finish(each.attempt, SUCCEEDED)
    for number in jobs:
        if not (await queue.job(number)).state.ended:
            await queue.resume(number)
        await queue.retry(number, Selection())
    for _ in range(20):
        for lane in LANES:
            await run_all(queue, lane)
        clock.now += 400
    await audit(queue)
    assert {(await queue.job(number)).state for number in jobs} == {JobState.SUCCEEDED}


def some_job(chance: random.Random, jobs: list[int]) -> JobPlan:
    """Layers that wait for each other in all ways there are."""
    names = ["a", "b", "c"][: chance.randint(1, 3)]
    layers = [
        LayerPlan(
            name,
            b"",
            limits=tuple(chance.sample(["two", "host", "none"], chance.randint(0, 2))),
            depends=tuple(other for other in names[:index] if chance.random() < 0.3),
        )
        for index, name in enumerate(names)
    ]
    tasks: list[TaskPlan] = []
    for name in names:
        for frame in range(chance.randint(1, 5)):
            needs = tuple(sorted(chance.sample(range(len(tasks)), min(len(tasks), chance.choice([0, 0, 1, 2])))))
            tasks.append(render(name, frame, needs=needs))
    depends = tuple(chance.sample(jobs, min(len(jobs), chance.choice([0, 0, 1, 2]))))
    return a_job(*layers, tasks=tuple(tasks), depends=depends, priority=chance.choice([10, 50, 90]))
