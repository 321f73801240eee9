"""The life of one render as a pure function: step(state, event, now) -> (state, effects)."""

from dataclasses import dataclass, replace
from enum import Enum, auto

from footlight_server.workers.failure import Failure, FailureReason


class Phase(Enum):
    """Where a render is; names as in the protocol's RenderState."""

    QUEUED = auto()
    OPENING = auto()
    RENDERING = auto()
    WRITING = auto()
    SUCCEEDED = auto()
    FAILED = auto()
    CANCELLED = auto()

    @property
    def ended(self) -> bool:
        """No event changes it any more."""
        return self in ENDS


ENDS = frozenset({Phase.SUCCEEDED, Phase.FAILED, Phase.CANCELLED})


@dataclass(frozen=True, slots=True)
class Patience:
    """[s] How long each phase may last without a word from the worker."""

    opening: float = 300.0
    # A slice of rendering lasts about a second at most; a minute of silence is a hang.
    rendering: float = 60.0
    # Gigabytes to a slow disk.
    writing: float = 300.0
    # From asking to keep what is there until the worker begins to write it.
    finishing: float = 30.0
    # From SIGKILL to the process being gone.
    dying: float = 2.0
    # From being taken up to the end, whatever the worker says; 0: no limit.
    total: float = 0.0


@dataclass(frozen=True, slots=True)
class State:
    """What decides the next step."""

    phase: Phase = Phase.QUEUED
    created: float = 0.0
    started: float | None = None
    ended: float | None = None
    # When patience with this phase ends, and with the render as a whole; None: never.
    deadline: float | None = None
    latest: float | None = None
    failure: Failure | None = None
    has_image: bool = False
    # CancelRender was called; what has converged shall be written.
    cancelled: bool = False
    keep: bool = False
    # The worker was killed; the render ends, as `failure` and `cancelled` say, when it is gone.
    killed: bool = False


# --- events ---


@dataclass(frozen=True, slots=True)
class TakenUp:
    """A worker has the task."""


@dataclass(frozen=True, slots=True)
class RenderingBegan:
    """The film is there."""


@dataclass(frozen=True, slots=True)
class Heard:
    """The worker said something that changes no state: tiles, progress."""


@dataclass(frozen=True, slots=True)
class WritingBegan:
    """All samples are in."""


@dataclass(frozen=True, slots=True)
class Finished:
    """The worker is done."""

    has_image: bool
    cancelled: bool = False


@dataclass(frozen=True, slots=True)
class Failed:
    """The worker, or the server on its behalf, gave up."""

    failure: Failure


@dataclass(frozen=True, slots=True)
class WorkerGone:
    """The process ended; `failure` says of what."""

    failure: Failure


@dataclass(frozen=True, slots=True)
class CancelAsked:
    """A client, or the server on its way out, wants an end."""

    keep: bool = False


@dataclass(frozen=True, slots=True)
class DeadlinePassed:
    """`State.deadline` lies behind."""


Event = TakenUp | RenderingBegan | Heard | WritingBegan | Finished | Failed | WorkerGone | CancelAsked | DeadlinePassed


class Effect(Enum):
    """What the shell has to do after a step."""

    # Tell the viewers of the new state.
    ANNOUNCE = auto()
    # Ask the worker to write what is there.
    FINISH_WORKER = auto()
    # SIGKILL.
    KILL_WORKER = auto()
    # Remove files that are no result.
    DISCARD_FILES = auto()


def step(  # noqa: C901, PLR0911 - the one place of all transitions
    state: State, event: Event, now: float, patience: Patience
) -> tuple[State, tuple[Effect, ...]]:
    """The state after `event` at time `now` [s, any clock that only goes forward], and what it calls for."""
    if state.phase.ended:
        return state, ()
    match event:
        case CancelAsked(keep=keep):
            return _cancel(state, now, patience, keep=keep)
        case WorkerGone(failure=failure):
            return _end(state, now, failure)
        case DeadlinePassed():
            return _out_of_patience(state, now, patience)
        case _ if state.killed:
            return state, ()
        case Failed(failure=failure):
            return _end(state, now, failure)
        case Finished(has_image=has_image, cancelled=cancelled):
            phase = Phase.CANCELLED if cancelled else Phase.SUCCEEDED
            ended = replace(state, phase=phase, ended=now, deadline=None, has_image=has_image)
            return ended, (Effect.ANNOUNCE,) if has_image else (Effect.DISCARD_FILES, Effect.ANNOUNCE)
        case TakenUp():
            latest = now + patience.total if patience.total else None
            return _enter(replace(state, started=now, latest=latest), Phase.OPENING, now + patience.opening)
        case RenderingBegan():
            return _enter(state, Phase.RENDERING, now + patience.rendering)
        case WritingBegan():
            return _enter(state, Phase.WRITING, now + patience.writing)
        case Heard():
            if state.phase is Phase.RENDERING and not state.keep:
                return replace(state, deadline=_earlier(now + patience.rendering, state.latest)), ()
            return state, ()


def _enter(state: State, phase: Phase, deadline: float) -> tuple[State, tuple[Effect, ...]]:
    if phase.value <= state.phase.value:  # back, or the same again: only a worker that is not ours any more says so
        return state, ()
    return replace(state, phase=phase, deadline=_earlier(deadline, state.latest)), (Effect.ANNOUNCE,)


def _earlier(deadline: float, latest: float | None) -> float:
    return deadline if latest is None else min(deadline, latest)


def _end(state: State, now: float, failure: Failure) -> tuple[State, tuple[Effect, ...]]:
    """No image came of it. A cancellation counts more than what the worker died of on the way."""
    if state.cancelled:
        ended = replace(state, phase=Phase.CANCELLED, failure=None)
    else:
        ended = replace(state, phase=Phase.FAILED, failure=state.failure or failure)
    return replace(ended, ended=now, deadline=None), (Effect.DISCARD_FILES, Effect.ANNOUNCE)


def _kill(state: State, now: float, patience: Patience) -> tuple[State, tuple[Effect, ...]]:
    return replace(state, killed=True, deadline=now + patience.dying), (Effect.KILL_WORKER,)


def _cancel(state: State, now: float, patience: Patience, *, keep: bool) -> tuple[State, tuple[Effect, ...]]:
    state = replace(state, cancelled=True)
    if state.phase is Phase.QUEUED:
        return _end(state, now, Failure(FailureReason.INTERNAL, "cancelled"))
    if state.killed:
        return state, ()
    if not keep:
        return _kill(state, now, patience)
    if state.keep or state.phase is Phase.WRITING:
        return state, ()
    if state.phase is Phase.OPENING:  # nothing to keep
        return _kill(state, now, patience)
    return replace(state, keep=True, deadline=now + patience.finishing), (Effect.FINISH_WORKER,)


def _out_of_patience(state: State, now: float, patience: Patience) -> tuple[State, tuple[Effect, ...]]:
    if state.deadline is None or now < state.deadline:
        return state, ()
    if state.latest is not None and now >= state.latest and not state.keep:
        what = f"it was not done within its limit of {patience.total:g} s"
    else:
        what = _silence(state.phase, patience)
    failure = state.failure or Failure(FailureReason.TIMEOUT, what)
    if state.killed:  # it does not even die; the render ends all the same
        return _end(state, now, failure)
    return _kill(replace(state, failure=failure), now, patience)


def _silence(phase: Phase, patience: Patience) -> str:
    return {
        Phase.OPENING: f"opening the stage took longer than the limit of {patience.opening:g} s",
        Phase.RENDERING: f"the worker said nothing for {patience.rendering:g} s",
        Phase.WRITING: f"writing the image took longer than {patience.writing:g} s",
    }.get(phase, "the deadline passed")
