"""Takes tasks of a job through their steps, and keeps what follows from them: counts, gates, the job's own state."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from sqlalchemy import ColumnElement, bindparam, func, select, update

from footlight_server.farm.model import JobState, TaskCounts, TaskState
from footlight_server.farm.sql import schema
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.transitions import (
    WAITING_STATES,
    Effect,
    GateMoved,
    Policy,
    Status,
    Stop,
    TaskEvent,
    job_state,
    step,
)
from footlight_server.sessions.errors import JobNotFoundError

_job, _layer, _task = schema.job.c, schema.layer.c, schema.task.c
# [values] In one statement; both databases take some ten thousand.
BATCH = 1000
COUNTS = tuple(TaskCounts.__slots__)

_SELECT_JOB = (
    select(
        _job.state,
        _job.paused,
        _job.cancelling,
        _job.retries,
        _job.started,
        _job.ended,
        _job.unmet,
        *(_job[name] for name in COUNTS),
    )
    .where(_job.number == bindparam("the_job"))
    .with_for_update()
)
_UPDATE_JOB = (
    update(schema.job)
    .where(_job.number == bindparam("the_job"))
    .values(
        {
            name: bindparam(f"new_{name}")
            for name in (*COUNTS, "state", "paused", "cancelling", "started", "ended", "unmet")
        }
        | {"render_seconds": _job.render_seconds + bindparam("more_seconds")}
    )
)
_SELECT_LAYERS = select(_layer.number, _layer.name, _layer.unmet, _layer.tasks_left).where(
    _layer.job == bindparam("the_job")
)
_UPDATE_LAYER = (
    update(schema.layer)
    .where(_layer.job == bindparam("the_job"), _layer.number == bindparam("the_layer"))
    .values(unmet=bindparam("new_unmet"), tasks_left=bindparam("new_left"))
)
_SELECT_TASKS = select(
    _task.number,
    _task.layer,
    _task.state,
    _task.unmet,
    _task.failures,
    _task.losses,
    _task.attempt,
    _task.not_before,
    _task.stop,
).where(_task.job == bindparam("the_job"))
_SELECT_TASK = _SELECT_TASKS.where(_task.number == bindparam("the_task")).with_for_update(skip_locked=True)
_UPDATE_TASK = (
    update(schema.task)
    .where(_task.job == bindparam("the_job"), _task.number == bindparam("the_task"))
    .values(
        state=bindparam("new_state"),
        failures=bindparam("new_failures"),
        losses=bindparam("new_losses"),
        attempt=bindparam("new_attempt"),
        not_before=bindparam("new_not_before"),
        stop=bindparam("new_stop"),
    )
)
_UPDATE_UNMET = (
    update(schema.task)
    .where(_task.job == bindparam("the_job"), _task.number == bindparam("the_task"))
    .values(unmet=_task.unmet + bindparam("more"))
)
_need = schema.task_need.c
_SELECT_NEEDING = (
    select(_need.task, func.count())
    .where(_need.job == bindparam("the_job"), _need.needs.in_(bindparam("done", expanding=True)))
    .group_by(_need.task)
)
_layer_need = schema.layer_need.c
_SELECT_NEEDING_LAYERS = select(_layer_need.layer).where(
    _layer_need.job == bindparam("the_job"), _layer_need.needs == bindparam("the_layer")
)
_job_need = schema.job_need.c
_SELECT_NEEDING_JOBS = select(_job_need.job).where(_job_need.needs == bindparam("the_job")).order_by(_job_need.job)


@dataclass(frozen=True, slots=True)
class TaskRow:
    """A task with what decides its next step."""

    number: int
    layer: int
    status: Status


@dataclass(frozen=True, slots=True)
class Stepped:
    """A task that an event has changed."""

    row: TaskRow
    status: Status
    effects: tuple[Effect, ...]


@dataclass(slots=True)
class _Layer:
    name: str
    unmet: int
    tasks_left: int


class JobChange:
    """One job in a transaction. After the last step, `write` has to be called. Raises JobNotFoundError."""

    def __init__(self, transaction: Transaction, number: int) -> None:
        self.transaction, self.number = transaction, number
        row = transaction.connection.execute(_SELECT_JOB, {"the_job": number}).one_or_none()
        if row is None:
            raise JobNotFoundError(f"no job jobs/{number}")
        self._was = JobState(row.state)
        self._was_paused = self.paused = bool(row.paused)
        self.cancelling = bool(row.cancelling)
        self.policy: Policy = replace(transaction.policy, retries=row.retries)
        self._started: float | None = row.started
        self._ended: float | None = row.ended
        self._unmet: int = row.unmet
        self._counts = Counter({name: getattr(row, name) for name in COUNTS})
        self._layers: dict[int, _Layer] | None = None
        # [s] To be added to what rendering has cost.
        self.render_seconds = 0.0

    @property
    def ended(self) -> bool:
        """It had ended when the transaction began."""
        return self._was.ended

    def layer_name(self, number: int) -> str:
        """Of a layer of the job."""
        return self._known_layers()[number].name

    def task(self, number: int) -> TaskRow | None:
        """A task, locked; None if there is none, or another transaction has it."""
        found = list(self._rows(_SELECT_TASK, the_task=number))
        return found[0] if found else None

    def tasks(self, *conditions: ColumnElement[bool]) -> list[TaskRow]:
        """Tasks by conditions on the columns of schema.task, in order."""
        return list(self._rows(_SELECT_TASKS.where(*conditions).order_by(_task.number)))

    def tasks_numbered(self, numbers: Iterable[int]) -> list[TaskRow]:
        """These tasks, as far as they are there, in order."""
        return [row for batch in _batches(sorted(set(numbers))) for row in self.tasks(_task.number.in_(batch))]

    def step(self, rows: Iterable[TaskRow], event: TaskEvent) -> list[Stepped]:
        """Take tasks through one event; answers those that it changed. What depends on them is seen to."""
        now, policy = self.transaction.now, self.policy
        changed = []
        for row in rows:
            status, effects = step(row.status, event, now, policy)
            # Whether it is gated is not kept with the task: the counters say it.
            if effects or replace(status, gated=row.status.gated) != row.status:
                changed.append(Stepped(row, status, effects))
        self._record(changed)
        for effect, done in ((Effect.DONE, 1), (Effect.UNDONE, -1)):
            if rows_of := [each.row for each in changed if effect in each.effects]:
                self._move_gates(rows_of, done)
        return changed

    def write(self) -> JobState:
        """Write the job's row, with its state by its tasks; jobs that depend on it are seen to."""
        counts = TaskCounts(**self._counts)
        if counts.running and self._started is None:
            self._started = self.transaction.now
        state = job_state(counts, started=self._started is not None, cancelling=self.cancelling, waits=self._unmet > 0)
        if state.ended != (self._ended is not None):
            self._ended = self.transaction.now if state.ended else None
        self.transaction.connection.execute(
            _UPDATE_JOB,
            {
                "the_job": self.number,
                **{f"new_{name}": count for name, count in self._counts.items()},
                "new_state": state.value,
                "new_paused": self.paused,
                "new_cancelling": self.cancelling and not state.ended,
                "new_started": self._started,
                "new_ended": self._ended,
                "new_unmet": self._unmet,
                "more_seconds": self.render_seconds,
            },
        )
        self.transaction.rings = True
        if state is not self._was or self.paused != self._was_paused:
            self.transaction.job_changed(self.number, state)
        succeeded = (state is JobState.SUCCEEDED) - (self._was is JobState.SUCCEEDED)
        if succeeded:
            self._move_job_gates(succeeded)
        return state

    # --- what follows ---

    def _rows(self, statement: object, **parameters: object) -> Iterator[TaskRow]:
        layers = self._known_layers()
        result = self.transaction.connection.execute(
            statement,  # type: ignore[call-overload]
            {"the_job": self.number, **parameters},
        )
        for number, layer, state, unmet, failures, losses, attempt, not_before, stop in result:
            gated = bool(unmet or layers[layer].unmet or self._unmet)
            status = Status(TaskState(state), gated, failures, losses, attempt, not_before, Stop(stop))
            yield TaskRow(number, layer, status)

    def _known_layers(self) -> dict[int, _Layer]:
        if self._layers is None:
            rows = self.transaction.connection.execute(_SELECT_LAYERS, {"the_job": self.number})
            self._layers = {number: _Layer(name, unmet, left) for number, name, unmet, left in rows}
        return self._layers

    def _record(self, changed: Sequence[Stepped]) -> None:
        """Write new statuses, count them, and say so."""
        if not changed:
            return
        self.transaction.connection.execute(
            _UPDATE_TASK,
            [
                {
                    "the_job": self.number,
                    "the_task": each.row.number,
                    "new_state": each.status.state.value,
                    "new_failures": each.status.failures,
                    "new_losses": each.status.losses,
                    "new_attempt": each.status.attempt,
                    "new_not_before": each.status.not_before,
                    "new_stop": each.status.stop.value,
                }
                for each in changed
            ],
        )
        for each in changed:
            before, after = each.row.status.state, each.status.state
            if before is not after:
                self._counts[before.value] -= 1
                self._counts[after.value] += 1
                self.transaction.task_changed(self.number, each.row.number, self.layer_name(each.row.layer), after)

    def _move_gates(self, rows: Sequence[TaskRow], done: int) -> None:
        """Tasks are done (1), or are not any more (-1): open or shut what waits for them, and for their layers."""
        needing: Counter[int] = Counter()
        for batch in _batches([row.number for row in rows]):
            found = self.transaction.connection.execute(_SELECT_NEEDING, {"the_job": self.number, "done": batch})
            for task, count in found:
                needing[task] += count
        if needing:
            self.transaction.connection.execute(
                _UPDATE_UNMET,
                [{"the_job": self.number, "the_task": task, "more": -done * n} for task, n in needing.items()],
            )
            self._step_gates(self.tasks_numbered(needing))
        for number, count in Counter(row.layer for row in rows).items():
            layer = self._known_layers()[number]
            before, layer.tasks_left = layer.tasks_left, layer.tasks_left - done * count
            self._write_layer(number)
            if (before == 0) != (layer.tasks_left == 0):
                self._move_layer_gates(number, done)

    def _move_layer_gates(self, needed: int, done: int) -> None:
        layers = self.transaction.connection.execute(
            _SELECT_NEEDING_LAYERS, {"the_job": self.number, "the_layer": needed}
        ).scalars()
        for number in layers.all():
            self._known_layers()[number].unmet -= done
            self._write_layer(number)
            self._step_gates(self.tasks(_task.layer == number, _task.state.in_(WAITING_STATES)))

    def _write_layer(self, number: int) -> None:
        layer = self._known_layers()[number]
        self.transaction.connection.execute(
            _UPDATE_LAYER,
            {
                "the_job": self.number,
                "the_layer": number,
                "new_unmet": layer.unmet,
                "new_left": layer.tasks_left,
            },
        )

    def _step_gates(self, rows: Sequence[TaskRow]) -> None:
        """The counters have moved; the tasks follow."""
        for gated in (False, True):
            self.step([row for row in rows if row.status.gated is gated], GateMoved(gated))

    def _move_job_gates(self, succeeded: int) -> None:
        """This job has succeeded (1), or has not any more (-1)."""
        jobs = self.transaction.connection.execute(_SELECT_NEEDING_JOBS, {"the_job": self.number}).scalars()
        for number in jobs.all():
            needing = JobChange(self.transaction, number)
            needing._unmet -= succeeded
            needing._step_gates(needing.tasks(_task.state.in_(WAITING_STATES)))
            needing.write()


def _batches(numbers: Sequence[int]) -> Iterator[list[int]]:
    for start in range(0, len(numbers), BATCH):
        yield list(numbers[start : start + BATCH])
