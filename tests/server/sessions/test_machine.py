"""Laws of the life of a render: it ends, it ends once, and it says why."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from footlight_server.sessions.machine import (
    CancelAsked,
    DeadlinePassed,
    Effect,
    Event,
    Failed,
    Finished,
    Heard,
    Patience,
    Phase,
    RenderingBegan,
    State,
    TakenUp,
    WorkerGone,
    WritingBegan,
    step,
)
from footlight_server.workers.failure import Failure, FailureReason

PATIENCE = Patience(opening=10, rendering=5, writing=20, finishing=3, dying=2)
CRASH = Failure(FailureReason.CRASHED, "the worker crashed (SIGSEGV)")

events = st.one_of(
    st.sampled_from([TakenUp(), RenderingBegan(), Heard(), WritingBegan(), DeadlinePassed()]),
    st.builds(Finished, has_image=st.booleans(), cancelled=st.booleans()),
    st.just(Failed(Failure(FailureReason.SCENE, "no"))),
    st.just(WorkerGone(CRASH)),
    st.builds(CancelAsked, keep=st.booleans()),
)
histories = st.lists(st.tuples(events, st.floats(0, 8)), max_size=30)


def run(history: list[tuple[Event, float]]) -> tuple[State, float, list[Effect]]:
    state, now = State(), 0.0
    effects: list[Effect] = []
    for event, pause in history:
        now += pause
        state, new = step(state, event, now, PATIENCE)
        effects += new
    return state, now, effects


def through(*history: Event) -> State:
    return run([(event, 0.0) for event in history])[0]


@given(histories, events)
def test_what_has_ended_stays_as_it_is(history: list[tuple[Event, float]], event: Event) -> None:
    state, now, _ = run(history)
    if state.phase.ended:
        assert step(state, event, now + 1, PATIENCE) == (state, ())


@given(histories)
def test_every_render_that_was_taken_up_ends_when_nothing_more_happens(history: list[tuple[Event, float]]) -> None:
    state, now, _ = run([(TakenUp(), 0.0), *history])
    for _ in range(3):
        if state.phase.ended:
            break
        assert state.deadline is not None
        now = max(now, state.deadline)
        state, _ = step(state, DeadlinePassed(), now, PATIENCE)
    assert state.phase.ended
    assert state.ended is not None


@given(histories)
def test_failed_says_why_and_only_failed_does(history: list[tuple[Event, float]]) -> None:
    state, _, _ = run(history)
    if state.phase.ended:
        assert (state.failure is not None) == (state.phase is Phase.FAILED)


@given(histories)
def test_viewers_hear_of_the_end_once_and_files_without_result_go(history: list[tuple[Event, float]]) -> None:
    state, _, effects = run(history)
    if state.phase.ended:
        assert effects[-1] is Effect.ANNOUNCE
        assert (Effect.DISCARD_FILES in effects) == (not state.has_image)
    assert effects.count(Effect.KILL_WORKER) <= 1


@given(histories)
def test_after_a_cancellation_nothing_fails(history: list[tuple[Event, float]]) -> None:
    state, now, _ = run(history)
    if state.phase.ended:
        return
    state, _ = step(state, CancelAsked(), now, PATIENCE)
    state, _ = step(state, WorkerGone(CRASH), now, PATIENCE)
    assert state.phase is Phase.CANCELLED


def test_the_way_of_a_good_render() -> None:
    way = [TakenUp(), RenderingBegan(), Heard(), WritingBegan(), Finished(has_image=True)]
    phases = [through(*way[: i + 1]).phase for i in range(len(way))]
    assert phases == [Phase.OPENING, Phase.RENDERING, Phase.RENDERING, Phase.WRITING, Phase.SUCCEEDED]


def test_a_dead_worker_fails_the_render_with_its_cause() -> None:
    assert through(TakenUp(), RenderingBegan(), WorkerGone(CRASH)).failure == CRASH


def test_a_hang_in_the_parser_is_killed_and_named() -> None:
    state = through(TakenUp())
    state, effects = step(state, DeadlinePassed(), 9.9, PATIENCE)
    assert effects == ()
    state, effects = step(state, DeadlinePassed(), 10.0, PATIENCE)
    assert effects == (Effect.KILL_WORKER,)
    state, _ = step(state, WorkerGone(CRASH), 10.1, PATIENCE)
    assert state.phase is Phase.FAILED
    assert state.failure is not None
    assert state.failure.reason is FailureReason.TIMEOUT
    assert "10 s" in state.failure.message


def test_keeping_asks_the_worker_to_finish_and_waits_only_so_long() -> None:
    state = through(TakenUp(), RenderingBegan())
    state, effects = step(state, CancelAsked(keep=True), 1.0, PATIENCE)
    assert effects == (Effect.FINISH_WORKER,)
    state, _ = step(state, Heard(), 3.0, PATIENCE)
    state, effects = step(state, DeadlinePassed(), 4.0, PATIENCE)
    assert effects == (Effect.KILL_WORKER,)


def test_a_cancelled_render_that_was_kept_has_its_image() -> None:
    state = through(
        TakenUp(), RenderingBegan(), CancelAsked(keep=True), WritingBegan(), Finished(has_image=True, cancelled=True)
    )
    assert (state.phase, state.has_image) == (Phase.CANCELLED, True)


def test_cancelling_in_the_queue_is_at_once() -> None:
    assert through(CancelAsked()).phase is Phase.CANCELLED


HURRIED = replace(PATIENCE, total=12)


@given(st.lists(st.sampled_from([RenderingBegan(), Heard(), WritingBegan()]), max_size=12), st.floats(0.1, 4))
def test_a_total_limit_holds_however_much_the_worker_says(said: list[Event], pause: float) -> None:
    state, _ = step(State(), TakenUp(), 100.0, HURRIED)
    now = 100.0
    for event in said:
        now += pause
        state, _ = step(state, event, now, HURRIED)
        assert state.deadline is not None
        assert state.deadline <= 112.0
    state, effects = step(state, DeadlinePassed(), max(now, 112.0), HURRIED)
    assert effects == (Effect.KILL_WORKER,)
    assert state.failure is not None
    assert state.failure.message == "it was not done within its limit of 12 s"


def test_silence_before_the_total_limit_is_called_silence() -> None:
    state, _ = step(State(), TakenUp(), 0.0, HURRIED)
    state, _ = step(state, RenderingBegan(), 1.0, HURRIED)
    state, _ = step(state, DeadlinePassed(), 6.0, HURRIED)
    assert state.failure is not None
    assert state.failure.message == "the worker said nothing for 5 s"
