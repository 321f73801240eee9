"""Laws of a task's life: nothing is lost, ends last until someone wants another round, old attempts say nothing."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight_server.farm.model import ExitClass, JobState, TaskCounts, TaskState
from footlight_server.farm.transitions import (
    DONE_STATES,
    WAITING_STATES,
    AttemptEnded,
    CancelAsked,
    Effect,
    GateMoved,
    Policy,
    RetryAsked,
    SkipAsked,
    Status,
    Stop,
    Taken,
    TaskEvent,
    initial,
    job_state,
    step,
)

POLICY = Policy(retries=2)
COUNTED = (ExitClass.CRASH, ExitClass.OUT_OF_MEMORY, ExitClass.TIMEOUT, ExitClass.OUTPUT)
FREE = (ExitClass.LOST, ExitClass.PREEMPTED)

events = st.one_of(
    st.just(Taken()),
    st.just(Taken()),
    st.builds(AttemptEnded, attempt=st.integers(0, 6), exit_class=st.sampled_from(ExitClass)),
    st.builds(GateMoved, gated=st.booleans()),
    st.sampled_from([SkipAsked(), CancelAsked(), RetryAsked()]),
)
histories = st.lists(events, max_size=40)


def through(status: Status, *history: TaskEvent, now: float = 0.0, policy: Policy = POLICY) -> Status:
    for event in history:
        status, _ = step(status, event, now, policy)
    return status


def running(history: list[TaskEvent]) -> Status:
    """A task that runs, whatever happened before."""
    status = through(initial(gated=False), *history)
    if status.state.ended:
        status = through(status, RetryAsked()) if status.state is not TaskState.SUCCEEDED else initial(gated=False)
    return through(status, GateMoved(gated=False), Taken())


@given(histories, events)
def test_what_has_ended_changes_only_by_retry_and_what_was_given_up_by_skip(
    history: list[TaskEvent], event: TaskEvent
) -> None:
    status = through(initial(gated=False), *history)
    after, effects = step(status, event, 0.0, POLICY)
    if status.state.ended and not isinstance(event, RetryAsked | SkipAsked):
        assert replace(after, gated=status.gated) == status
        assert effects == ()


@given(histories)
def test_success_is_for_ever(history: list[TaskEvent]) -> None:
    status = running([])
    succeeded = through(status, AttemptEnded(status.attempt, ExitClass.SUCCEEDED))
    assert through(succeeded, *history).state is TaskState.SUCCEEDED


@given(histories)
def test_whatever_happened_a_task_that_has_not_succeeded_can_be_brought_to_success(history: list[TaskEvent]) -> None:
    status = running(history)
    assert status.state is TaskState.RUNNING
    assert through(status, AttemptEnded(status.attempt, ExitClass.SUCCEEDED)).state is TaskState.SUCCEEDED


@given(histories, st.sampled_from(ExitClass), st.integers(-3, 10))
def test_only_the_current_attempt_is_heard(history: list[TaskEvent], how: ExitClass, attempt: int) -> None:
    status = through(initial(gated=False), *history)
    if status.state is not TaskState.RUNNING or attempt != status.attempt:
        assert step(status, AttemptEnded(attempt, how), 5.0, POLICY) == (status, ())


@given(histories, st.sampled_from(ExitClass))
def test_the_current_attempt_is_heard_once(history: list[TaskEvent], how: ExitClass) -> None:
    status = running(history)
    ended, effects = step(status, AttemptEnded(status.attempt, how), 5.0, POLICY)
    assert Effect.END_ATTEMPT in effects
    assert ended.state is not TaskState.RUNNING
    assert step(ended, AttemptEnded(status.attempt, how), 6.0, POLICY) == (ended, ())


@given(histories)
def test_a_task_waits_exactly_while_it_is_gated_and_none_that_is_gated_is_taken(history: list[TaskEvent]) -> None:
    status = initial(gated=False)
    for event in history:
        before, (status, effects) = status, step(status, event, 0.0, POLICY)
        if status.state in WAITING_STATES:
            assert (status.state is TaskState.BLOCKED) == status.gated
        if Effect.BEGIN_ATTEMPT in effects:
            assert before.state is TaskState.READY
            assert status.attempt == before.attempt + 1
        assert status.attempt >= before.attempt
        assert (status.stop is not Stop.NO) <= (status.state is TaskState.RUNNING)


@given(histories)
def test_done_and_undone_are_said_when_it_becomes_so(history: list[TaskEvent]) -> None:
    status, done = initial(gated=False), False
    for event in history:
        status, effects = step(status, event, 0.0, POLICY)
        assert (Effect.DONE in effects) == (not done and status.state in DONE_STATES)
        assert (Effect.UNDONE in effects) == (done and status.state not in DONE_STATES)
        done = status.state in DONE_STATES


def test_who_retries_what_was_skipped_makes_others_wait_again() -> None:
    skipped = through(initial(gated=False), SkipAsked())
    again, effects = step(skipped, RetryAsked(), 0.0, POLICY)
    assert again.state is TaskState.READY
    assert Effect.UNDONE in effects


@given(st.lists(st.sampled_from(COUNTED + FREE), min_size=1, max_size=30), st.integers(0, 6))
def test_failures_count_by_class_and_the_last_retry_is_the_last(ends: list[ExitClass], retries: int) -> None:
    policy = Policy(retries=retries)
    status, counted, lost = initial(gated=False), 0, 0
    for how in ends:
        status = through(status, Taken(), policy=policy)
        status = through(status, AttemptEnded(status.attempt, how), policy=policy)
        counted += how in COUNTED
        lost = lost + 1 if how is ExitClass.LOST else 0
        assert status.failures == counted
        forgiven = max(retries, policy.output_retries) if how is ExitClass.OUTPUT and retries else retries
        failed = (how in COUNTED and counted > forgiven) or lost > policy.most_losses
        assert status.state is (TaskState.FAILED if failed else TaskState.READY)
        if failed:
            return


def test_a_full_disk_is_waited_for_longer_than_a_crash_but_not_where_nothing_is_to_be_tried_again() -> None:
    status, waited = initial(gated=False), 0.0
    for attempt in range(1, POLICY.output_retries + 1):
        status = through(status, Taken(), AttemptEnded(attempt, ExitClass.OUTPUT))
        waited += status.not_before
    assert status.state is TaskState.READY
    assert waited > 1800
    assert through(running([]), AttemptEnded(1, ExitClass.OUTPUT), policy=Policy(retries=0)).state is TaskState.FAILED


def test_the_scene_is_never_tried_again() -> None:
    status = running([])
    assert through(status, AttemptEnded(1, ExitClass.SCENE), policy=Policy(retries=100)).state is TaskState.FAILED


def test_twenty_losses_in_a_row_are_forgiven_and_no_more() -> None:
    status = initial(gated=False)
    for _ in range(20):
        status = through(status, Taken())
        status = through(status, AttemptEnded(status.attempt, ExitClass.LOST))
    assert status.state is TaskState.READY
    status = through(status, Taken())
    assert through(status, AttemptEnded(21, ExitClass.LOST)).state is TaskState.FAILED
    # In between it was heard of.
    status = through(status, AttemptEnded(21, ExitClass.CRASH), Taken(), AttemptEnded(22, ExitClass.LOST))
    assert status.losses == 1


def test_pauses_grow_fourfold_to_five_minutes() -> None:
    policy = Policy(retries=100)
    status, pauses = initial(gated=False), []
    for _ in range(7):
        status = through(status, Taken(), policy=policy)
        assert status.not_before == 0.0
        status = through(status, AttemptEnded(status.attempt, ExitClass.CRASH), now=1000.0, policy=policy)
        pauses.append(status.not_before - 1000.0)
    assert pauses == [1, 4, 16, 64, 256, 300, 300]


@pytest.mark.parametrize(
    ("how", "pause"),
    [(ExitClass.OUTPUT, 1), (ExitClass.LOST, 1), (ExitClass.TIMEOUT, 0), (ExitClass.PREEMPTED, 0)],
)
def test_a_pause_where_it_helps(how: ExitClass, pause: float) -> None:
    status = through(running([]), AttemptEnded(1, how), now=1000.0)
    assert status.not_before == (1000.0 + pause if pause else 0.0)


@given(st.sampled_from([how for how in ExitClass if how is not ExitClass.SUCCEEDED]))
def test_a_running_task_ends_as_was_asked_however_its_attempt_does(how: ExitClass) -> None:
    status = running([])
    assert through(status, SkipAsked()).state is TaskState.RUNNING
    assert through(status, SkipAsked(), AttemptEnded(1, how)).state is TaskState.SKIPPED
    assert through(status, CancelAsked(), AttemptEnded(1, how)).state is TaskState.CANCELLED
    assert through(status, SkipAsked(), CancelAsked(), AttemptEnded(1, how)).state is TaskState.CANCELLED


def test_what_came_to_an_image_in_spite_of_it_has_succeeded() -> None:
    for asked in (SkipAsked(), CancelAsked()):
        assert through(running([]), asked, AttemptEnded(1, ExitClass.SUCCEEDED)).state is TaskState.SUCCEEDED


def test_a_retry_begins_anew() -> None:
    status = initial(gated=False)
    for attempt in (1, 2, 3):
        status = through(status, Taken(), AttemptEnded(attempt, ExitClass.CRASH))
    assert status.state is TaskState.FAILED
    again, effects = step(status, RetryAsked(), 0.0, POLICY)
    assert again == Status(TaskState.READY, gated=False, attempt=3)
    assert effects == (Effect.FORGET_BLAME,)


# --- jobs ---

few = st.integers(0, 2)
all_counts = st.builds(
    TaskCounts, blocked=few, ready=few, running=few, succeeded=few, failed=few, skipped=few, cancelled=few
)


@given(all_counts, st.booleans(), st.booleans(), st.booleans())
def test_a_job_has_ended_exactly_when_nothing_of_it_can_run(
    counts: TaskCounts, started: bool, cancelling: bool, waits: bool
) -> None:
    state = job_state(counts, started=started, cancelling=cancelling, waits=waits)
    may_run = counts.ready or counts.running or (counts.blocked and waits)
    stuck = counts.blocked and not (counts.failed or counts.cancelled)
    if may_run:
        assert not state.ended
    elif not stuck:  # BLOCKED tasks that wait for nothing cannot be
        assert state.ended
    if state is JobState.SUCCEEDED:
        assert counts.blocked == counts.failed == counts.cancelled == 0


def test_states_of_a_job() -> None:
    def state(*, started: bool = True, cancelling: bool = False, waits: bool = False, **counts: int) -> JobState:
        return job_state(TaskCounts(**counts), started=started, cancelling=cancelling, waits=waits)

    assert state(ready=3, started=False) is JobState.QUEUED
    assert state(ready=3) is JobState.RUNNING
    assert state(succeeded=2, skipped=1) is JobState.SUCCEEDED
    assert state(succeeded=2, failed=1) is JobState.FAILED
    assert state(failed=1, blocked=5) is JobState.FAILED
    assert state(failed=1, ready=1) is JobState.RUNNING
    assert state(failed=1, blocked=5, waits=True) is JobState.RUNNING
    assert state(blocked=5, waits=True, started=False) is JobState.QUEUED
    assert state(running=1, cancelled=5, cancelling=True) is JobState.CANCELLING
    assert state(succeeded=1, cancelled=5, cancelling=True) is JobState.CANCELLED
    assert state(failed=1, cancelled=5) is JobState.CANCELLED
