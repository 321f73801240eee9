"""What clients see of jobs: the queue's record, with what the farm knows of attempts that run and the sizes of logs."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from footlight.v1 import job_pb2
from footlight_server.api.job_messages import attempt_message, frame_message, job_message, task_message, timestamp
from footlight_server.api.names import job_name
from footlight_server.api.streams import patiently
from footlight_server.farm.dispatcher import Farm
from footlight_server.farm.model import Attempt, Event, EventKind, Job, Task
from footlight_server.farm.queue import Queue
from footlight_server.sessions.errors import FrameNotFoundError, TaskNotFoundError

# [tasks] Looked up one by one; for more, a page is quicker.
_FEW = 4
_PAGE = 1000


@dataclass(frozen=True, slots=True)
class Seen:
    """A message for whoever watches a job. `id`: of the event, 0 for what is not recorded; `size` [bytes]."""

    id: int
    event: job_pb2.JobEvent
    size: int


@dataclass(frozen=True, slots=True)
class Resolved:
    """Events with what they are about as it is now, and the job as it was then or later."""

    seen: list[Seen]
    job: Job


class JobViews:
    """Reads; changes nothing."""

    def __init__(self, queue: Queue, farm: Farm) -> None:
        self.queue = queue
        self.farm = farm

    async def tasks(self, tasks: Sequence[Task]) -> list[job_pb2.Task]:
        """Messages for tasks of one job."""
        sizes = await self._log_sizes([task.last_attempt for task in tasks if task.last_attempt is not None])
        running = {run.attempt.task: run for run in self.farm.running(tasks[0].job)} if tasks else {}
        return [
            task_message(task, running.get(task.number), sizes.get((task.number, task.attempt), 0)) for task in tasks
        ]

    async def attempts(self, attempts: Sequence[Attempt]) -> list[job_pb2.Attempt]:
        """Messages for attempts at one task."""
        sizes = await self._log_sizes(attempts)
        running = self.farm.attempt(attempts[0].job, attempts[0].task) if attempts else None
        return [attempt_message(a, running, sizes[a.task, a.number]) for a in attempts]

    async def resolve(self, number: int, events: Sequence[Event]) -> Resolved:
        """Messages for events of one job, in their order; of several about the same thing only the last.

        The rest would say the same: what they are about is looked up after they happened.
        """
        last = {
            (event.kind, event.task if event.kind is EventKind.TASK else (event.layer, event.frame)): event
            for event in events
        }
        kept = sorted(last.values(), key=lambda event: event.id)
        job = await self.queue.job(number)
        wanted = sorted(event.task for event in kept if event.kind is EventKind.TASK and event.task is not None)
        tasks = {task.number: task for task in await self._tasks(number, wanted)}
        messages = dict(zip(tasks, await self.tasks(list(tasks.values())), strict=True))
        seen = []
        for event in kept:
            message = job_pb2.JobEvent(id=event.id, time=timestamp(event.time), job=job_name(number))
            match event.kind:
                case EventKind.JOB:
                    message.changed.CopyFrom(job_message(job))
                case EventKind.TASK:
                    message.task.CopyFrom(messages[event.task or 0])
                case EventKind.FRAME:
                    try:
                        frame = await self.queue.frame(number, event.layer, event.frame or 0)
                    except FrameNotFoundError:  # it was made anew since, and is recorded again then
                        continue
                    message.frame.CopyFrom(frame_message(frame))
            seen.append(Seen(event.id, message, message.ByteSize()))
        return Resolved(seen, job)

    async def _tasks(self, job: int, numbers: Sequence[int]) -> list[Task]:
        """These tasks, given in ascending order; by pages if they are many."""
        if len(numbers) <= _FEW:
            return [await self.queue.task(job, number) for number in numbers]
        wanted, found = set(numbers), []
        after = numbers[0] - 1
        while after < numbers[-1]:
            page = await self.queue.tasks(job, min(_PAGE, numbers[-1] - after), after)
            if not page:
                raise TaskNotFoundError(f"{job_name(job)} has no task {numbers[-1]}")
            found += [task for task in page if task.number in wanted]
            after = page[-1].number
        return found

    async def _log_sizes(self, attempts: Sequence[Attempt]) -> dict[tuple[int, int], int]:
        """[bytes] By task and attempt."""

        def sizes() -> dict[tuple[int, int], int]:
            return {(a.task, a.number): self._log_size(a) for a in attempts}

        return await patiently(asyncio.to_thread(sizes)) if attempts else {}

    def _log_size(self, attempt: Attempt) -> int:
        try:
            return self.farm.log_path(attempt.job, attempt.task, attempt.number).stat().st_size
        except OSError:  # nothing was written yet
            return 0
