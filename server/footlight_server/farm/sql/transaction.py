"""A transaction that writes: its connection, its time, and the events it records at its end."""

from dataclasses import dataclass, field

from sqlalchemy import Connection, func, insert, select

from footlight_server.farm.model import EventKind, JobState, TaskState
from footlight_server.farm.sql.schema import event
from footlight_server.farm.transitions import Policy

_INSERT_EVENT = insert(event)
_LAST_EVENT = select(func.max(event.c.id))


@dataclass(slots=True)
class Transaction:
    """`now`: [s since 1970, UTC], the same for all that is done in it."""

    connection: Connection
    now: float
    policy: Policy
    # Whoever waits for changes has to look again, though there may be no event.
    rings: bool = False
    # Jobs with new events, and after `record` the id of the last one.
    jobs: set[int] = field(default_factory=set)
    last_event: int = 0
    _events: list[dict[str, object]] = field(default_factory=list)

    def job_changed(self, job: int, state: JobState) -> None:
        """A job has a new state or flag."""
        self._note(job, EventKind.JOB, state=state.value)

    def task_changed(self, job: int, task: int, layer: str, state: TaskState) -> None:
        """A task has a new state."""
        self._note(job, EventKind.TASK, task=task, layer=layer, state=state.value)

    def frame_done(self, job: int, task: int, layer: str, frame: int) -> None:
        """An image is there."""
        self._note(job, EventKind.FRAME, task=task, layer=layer, frame=frame)

    def record(self) -> None:
        """Write the events; the last thing that is done in a transaction."""
        if self._events:
            self.rings = True
            self.connection.execute(_INSERT_EVENT, self._events)
            self.last_event = self.connection.execute(_LAST_EVENT).scalar_one()

    def _note(
        self,
        job: int,
        kind: EventKind,
        task: int | None = None,
        layer: str = "",
        frame: int | None = None,
        state: str = "",
    ) -> None:
        self.jobs.add(job)
        self._events.append(
            {
                "time": self.now,
                "job": job,
                "kind": kind.value,
                "task": task,
                "layer": layer,
                "frame": frame,
                "state": state,
            }
        )
