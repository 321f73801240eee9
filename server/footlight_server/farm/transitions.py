"""The life of a task as a pure function, step(status, event, now, policy) -> (status, effects); a job's state by it."""

from dataclasses import dataclass, replace
from enum import Enum, StrEnum, auto

from footlight_server.farm.model import ExitClass, JobState, TaskCounts, TaskState


@dataclass(frozen=True, slots=True)
class Policy:
    """When to try again. `retries`: of the job; how many failures that count are forgiven."""

    retries: int = 2
    # A full disk is nobody's scene: as long as any retry is allowed, so many are, which with their pauses is 40 min.
    output_retries: int = 12
    # [attempts] LOST so often in a row is forgiven: beyond, the task itself makes its workers vanish.
    most_losses: int = 20
    # [s] After the first failure, four times as long after each further one, never more than the longest.
    first_pause: float = 1.0
    pause_growth: float = 4.0
    longest_pause: float = 300.0
    # [tasks] Of a job that fail on a lane before the job does not use it any more.
    block_after: int = 3


class Stop(StrEnum):
    """What becomes of a running task when its attempt ends, because someone asked for it; stored by these words."""

    NO = ""
    SKIP = "skip"
    CANCEL = "cancel"


@dataclass(frozen=True, slots=True)
class Status:
    """What decides the next step of a task."""

    state: TaskState
    # Tasks, layers or jobs it needs are not done.
    gated: bool
    # That count against the retries.
    failures: int = 0
    # LOST in a row.
    losses: int = 0
    # The number of the current or last attempt.
    attempt: int = 0
    # [s since 1970, UTC] 0: at once.
    not_before: float = 0.0
    stop: Stop = Stop.NO


# --- events ---


@dataclass(frozen=True, slots=True)
class GateMoved:
    """All it needs is done, or (`gated`) something is not any more."""

    gated: bool


@dataclass(frozen=True, slots=True)
class Taken:
    """A lane takes it."""


@dataclass(frozen=True, slots=True)
class AttemptEnded:
    """An attempt says how it ended."""

    attempt: int
    exit_class: ExitClass


@dataclass(frozen=True, slots=True)
class SkipAsked:
    """Someone gives up on it."""


@dataclass(frozen=True, slots=True)
class CancelAsked:
    """Its job is cancelled."""


@dataclass(frozen=True, slots=True)
class RetryAsked:
    """Someone wants another round."""


TaskEvent = GateMoved | Taken | AttemptEnded | SkipAsked | CancelAsked | RetryAsked


class Effect(Enum):
    """What has to be recorded besides the task itself."""

    # A new attempt, with the number in the status.
    BEGIN_ATTEMPT = auto()
    # The current attempt has ended.
    END_ATTEMPT = auto()
    # It failed on the attempt's lane, which may be the lane's fault.
    BLAME_LANE = auto()
    # No lane is to blame any more.
    FORGET_BLAME = auto()
    # What needs it may go on, or has to wait again.
    DONE = auto()
    UNDONE = auto()


Step = tuple[Status, tuple[Effect, ...]]

DONE_STATES = frozenset({TaskState.SUCCEEDED, TaskState.SKIPPED})
WAITING_STATES = frozenset({TaskState.BLOCKED, TaskState.READY})
# Another lane might do better.
LANE_FAULTS = frozenset({ExitClass.CRASH, ExitClass.OUT_OF_MEMORY, ExitClass.TIMEOUT, ExitClass.OUTPUT})
# What caused it may pass: a pause helps.
PASSING_FAULTS = frozenset({ExitClass.CRASH, ExitClass.OUTPUT})


def initial(*, gated: bool) -> Status:
    """A task that was just put into the queue."""
    return Status(TaskState.BLOCKED if gated else TaskState.READY, gated)


def step(  # noqa: PLR0911 - the one place of all transitions
    status: Status, event: TaskEvent, now: float, policy: Policy
) -> Step:
    """The status after `event` at `now` [s since 1970, UTC], and what it calls for; the same if it means nothing."""
    match event:
        case GateMoved(gated=gated):
            moved = replace(status, gated=gated)
            return (_wait(moved), ()) if status.state in WAITING_STATES else (moved, ())
        case Taken() if status.state is TaskState.READY:
            taken = replace(status, state=TaskState.RUNNING, attempt=status.attempt + 1, not_before=0.0, stop=Stop.NO)
            return taken, (Effect.BEGIN_ATTEMPT,)
        case AttemptEnded(attempt=attempt, exit_class=how) if _is_current(status, attempt):
            ended, effects = _after_attempt(status, how, now, policy)
            return ended, (Effect.END_ATTEMPT, *effects)
        case SkipAsked():
            return _skip(status)
        case CancelAsked() if status.state is TaskState.RUNNING:
            return replace(status, stop=Stop.CANCEL), ()
        case CancelAsked() if status.state in WAITING_STATES:
            return replace(status, state=TaskState.CANCELLED, not_before=0.0), ()
        case RetryAsked() if status.state.ended and status.state is not TaskState.SUCCEEDED:
            again = _wait(replace(status, failures=0, losses=0, not_before=0.0))
            undone = (Effect.UNDONE,) if status.state in DONE_STATES else ()
            return again, (Effect.FORGET_BLAME, *undone)
        case _:
            return status, ()


def _is_current(status: Status, attempt: int) -> bool:
    """The fence: what an older attempt says does not count any more."""
    return status.state is TaskState.RUNNING and status.attempt == attempt


def _wait(status: Status) -> Status:
    return replace(status, state=TaskState.BLOCKED if status.gated else TaskState.READY)


def _skip(status: Status) -> Step:
    if status.state is TaskState.RUNNING and status.stop is Stop.NO:
        return replace(status, stop=Stop.SKIP), ()
    if status.state is TaskState.RUNNING or status.state in DONE_STATES:
        return status, ()
    return replace(status, state=TaskState.SKIPPED, not_before=0.0), (Effect.DONE,)


def _after_attempt(status: Status, how: ExitClass, now: float, policy: Policy) -> Step:
    ended = replace(status, stop=Stop.NO, losses=status.losses + 1 if how is ExitClass.LOST else 0)
    if how is ExitClass.SUCCEEDED:
        return replace(ended, state=TaskState.SUCCEEDED), (Effect.DONE,)
    if status.stop is Stop.SKIP:
        return replace(ended, state=TaskState.SKIPPED), (Effect.DONE,)
    if status.stop is Stop.CANCEL or how is ExitClass.CANCELLED:
        return replace(ended, state=TaskState.CANCELLED), ()
    if how is ExitClass.PREEMPTED:
        return _wait(ended), ()
    if how is ExitClass.LOST:
        return _after_loss(ended, now, policy), ()
    return _after_failure(ended, how, now, policy)


def _after_loss(status: Status, now: float, policy: Policy) -> Status:
    if status.losses > policy.most_losses:
        return replace(status, state=TaskState.FAILED)
    return _wait(replace(status, not_before=now + policy.first_pause))


def _after_failure(status: Status, how: ExitClass, now: float, policy: Policy) -> Step:
    failed = replace(status, failures=status.failures + 1)
    effects = (Effect.BLAME_LANE,) if how in LANE_FAULTS else ()
    if how is ExitClass.SCENE or failed.failures > _forgiven(how, policy):
        return replace(failed, state=TaskState.FAILED), effects
    not_before = now + _pause(failed.failures, policy) if how in PASSING_FAULTS else 0.0
    return _wait(replace(failed, not_before=not_before)), effects


def _forgiven(how: ExitClass, policy: Policy) -> int:
    if how is ExitClass.OUTPUT and policy.retries:
        return max(policy.retries, policy.output_retries)
    return policy.retries


def _pause(failures: int, policy: Policy) -> float:
    # The exponent is bounded before the power is taken: 100 retries would overflow nothing, but say nothing either.
    return float(min(policy.first_pause * policy.pause_growth ** min(failures - 1, 20), policy.longest_pause))


def job_state(counts: TaskCounts, *, started: bool, cancelling: bool, waits: bool) -> JobState:
    """The state of a job by its tasks. `waits`: a job it depends on has not succeeded, so BLOCKED tasks may yet run.

    Otherwise, when nothing runs or can be taken, BLOCKED tasks need a task that has failed or was cancelled.
    """
    if not counts.ready and not counts.running and not (counts.blocked and waits):
        if counts.cancelled:
            return JobState.CANCELLED
        if counts.failed:
            return JobState.FAILED
        if not counts.blocked:
            return JobState.SUCCEEDED
    if cancelling:
        return JobState.CANCELLING
    return JobState.RUNNING if started else JobState.QUEUED
