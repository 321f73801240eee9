"""Why a job or task is not running, in plain words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from footlight_server.farm.blocklist import may_take, usable_lanes
from footlight_server.farm.model import ExitClass, Lane, Limit, LimitUnit, TaskState

CAUSES = {
    ExitClass.CRASH: "a crash",
    ExitClass.OUTPUT: "an image that could not be written",
    ExitClass.LOST: "a worker that was lost",
}


@dataclass(frozen=True, slots=True)
class WaitedLayer:
    """A layer that is waited for. [tasks] not done, and in all."""

    name: str
    left: int
    total: int


@dataclass(frozen=True, slots=True)
class WaitFacts:
    """What the queue knows about a task that waits; of a job, about the first of its tasks that does."""

    job: int
    # False: it runs or has ended, so there is nothing to explain.
    waits: bool
    # [s since 1970, UTC]
    now: float = 0.0
    paused: bool = False
    # What it needs and is not done; of tasks the first few, and how many there are.
    jobs: tuple[tuple[int, str], ...] = ()
    layers: tuple[WaitedLayer, ...] = ()
    tasks: tuple[tuple[int, TaskState], ...] = ()
    tasks_left: int = 0
    # Those of its layer.
    limits: tuple[Limit, ...] = ()
    # [s since 1970, UTC] 0: at once. After which failure.
    not_before: float = 0.0
    last_exit: ExitClass | None = None
    # Lanes: where the task failed, how many of the job's tasks failed, and which are busy.
    failed_on: frozenset[str] = frozenset()
    failed_tasks: Mapping[str, int] = field(default_factory=dict)
    block_after: int = 3
    busy: frozenset[str] = frozenset()
    # READY tasks that are taken before this one.
    ahead: int = 0


def explain_wait(facts: WaitFacts, live_lanes: Sequence[Lane]) -> list[str]:
    """The reasons; the first is what has to change first. Empty if it runs or has ended."""
    if not facts.waits:
        return []
    reasons = [
        *_of_the_job(facts),
        *_of_needs(facts),
        *_of_limits(facts),
        *_of_the_pause(facts),
        *_of_lanes(facts, [lane.name for lane in live_lanes]),
    ]
    return reasons or ["ready: the next free worker takes it"]


def _of_the_job(facts: WaitFacts) -> list[str]:
    return [f"jobs/{facts.job} is paused"] if facts.paused else []


def _of_needs(facts: WaitFacts) -> list[str]:
    reasons = [f"waits for jobs/{number}, which is {state}{_way_out(state)}" for number, state in facts.jobs]
    reasons += [f"waits for layer {layer.name}: {layer.left} of {layer.total} tasks left" for layer in facts.layers]
    reasons += [
        f"waits for jobs/{facts.job}/tasks/{number}, which is {state}{_way_out(state)}" for number, state in facts.tasks
    ]
    if (more := facts.tasks_left - len(facts.tasks)) > 0:
        reasons.append(f"waits for {more} more tasks")
    return reasons


def _way_out(state: str) -> str:
    """What has to happen to something waited for that will not end well by itself."""
    return "; that has to be retried or skipped" if state in {TaskState.FAILED, TaskState.CANCELLED} else ""


def _of_limits(facts: WaitFacts) -> list[str]:
    what = {LimitUnit.TASK: "tasks run", LimitUnit.HOST: "hosts run tasks"}
    return [
        f"limit {limit.name}: {limit.running} of {limit.most} {what[limit.unit]}"
        for limit in facts.limits
        if limit.running >= limit.most
    ]


def _of_the_pause(facts: WaitFacts) -> list[str]:
    left = facts.not_before - facts.now
    if left <= 0:
        return []
    cause = CAUSES.get(facts.last_exit, "a failure") if facts.last_exit else "a failure"
    time = datetime.fromtimestamp(facts.not_before, UTC).strftime("%H:%M:%S UTC")
    return [f"after {cause}, not before {time} (in {left:.0f} s)"]


def _of_lanes(facts: WaitFacts, live: Sequence[str]) -> list[str]:
    if not live:
        return ["there are no workers"]
    usable = usable_lanes(live, facts.failed_tasks, facts.block_after)
    allowed = [lane for lane in usable if may_take(lane, usable, facts.failed_on)]
    free = [lane for lane in allowed if lane not in facts.busy]
    if free and not facts.ahead:
        return []
    before = f"; {facts.ahead} tasks are before this one" if facts.ahead > 1 else ""
    before = "; 1 task is before this one" if facts.ahead == 1 else before
    if free:
        return [before.removeprefix("; ")]
    if len(allowed) == len(live):
        count = "the worker is busy" if len(live) == 1 else f"all {len(live)} workers are busy"
        return [count + before]
    return [f"the workers it may use are busy: {_some(allowed)}{before}", *_barred(facts, live, usable)]


def _barred(facts: WaitFacts, live: Sequence[str], usable: Sequence[str]) -> list[str]:
    """Why lanes that are there do not count."""
    reasons = []
    if all(facts.failed_tasks.get(lane, 0) >= facts.block_after for lane in live):
        reasons.append(
            f"at least {facts.block_after} tasks of this job failed on each worker; "
            f"only {usable[0]}, where the fewest did, is still used"
        )
    elif blocked := [lane for lane in live if lane not in usable]:
        reasons.append(f"at least {facts.block_after} tasks of this job failed on {_some(blocked)}")
    if failed := [lane for lane in usable if not may_take(lane, usable, facts.failed_on)]:
        reasons.append(f"it failed on {_some(failed)} before")
    return reasons


def _some(lanes: Sequence[str]) -> str:
    """The first few names."""
    more = len(lanes) - 5
    return ", ".join(lanes[:5]) + (f" and {more} more" if more > 0 else "")
