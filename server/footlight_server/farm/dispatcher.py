"""Gives the queue's tasks to free lanes and sees each attempt to its end; what the server has of the farm in memory."""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from footlight_server.farm.attempt import AttemptRun, BundleFiles, Running, Surroundings, insist
from footlight_server.farm.changes import Changes
from footlight_server.farm.executor import Executor
from footlight_server.farm.logs import LogWriter
from footlight_server.farm.meter import FarmMeter
from footlight_server.farm.model import Claim, Ending, ExitClass, Lane, TaskKind
from footlight_server.farm.places import Places
from footlight_server.farm.pruning import finish_pruning, prune
from footlight_server.farm.queue import Queue
from footlight_server.farm.recovery import recover
from footlight_server.farm.rests import Rests
from footlight_server.farm.sheet import Sheets
from footlight_server.sessions.errors import StorageError
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from footlight_server.workers.pool import WorkerPool

log = logging.getLogger(__name__)

# [s] After a failure of the database, doubled up to the second.
_FIRST_PAUSE, _LONGEST_PAUSE = 0.5, 5.0
# [s] The longest sleep: the wall clock, which says when a delayed task is due, may be set while we sleep.
_LONGEST_SLEEP = 60.0
# [s] After a delayed task is due: timers may be early.
_MARGIN = 0.02
# [s] Between two looks whether all that runs by the queue's record runs here.
_COMPARING = 60.0
# [s] From being stopped until an attempt has ended and is recorded.
_ENDING = 6.0

Key = tuple[int, int, int]


class Farm:
    """One in a server. `start` begins to give out tasks, `drain` and `close` end it; nothing is lost between.

    `clock`: [s since 1970, UTC], the queue's.
    """

    def __init__(
        self,
        settings: Settings,
        queue: Queue,
        sessions: Sessions,
        executor: Executor,
        bundles: BundleFiles | None = None,
        meter: FarmMeter | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._queue = queue
        self._executor = executor
        self._clock = clock
        self._around = Surroundings(settings, Places(settings.data), queue, sessions, bundles, meter)
        self._logs = LogWriter(clock)
        self._sheet_workers = WorkerPool(settings.worker_memory, spare=False)
        self._sheets = Sheets(settings, self._around.places, queue, self._sheet_workers)
        # By lane: who runs there, and the task that sees to it.
        self._runs: dict[str, AttemptRun] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._rests = Rests()
        # Rings when a lane has become free, and when the server stops.
        self._freed = Changes()
        self._loop: asyncio.Task[None] | None = None
        # [s, monotonic]
        self._compare_at = 0.0
        self._stopping = False

    # --- its life ---

    async def start(self) -> None:
        """Take up what a server before this one left, then give out tasks. Raises what the queue and executor raise."""
        await finish_pruning(self._queue, self.places)
        left = await recover(self._queue, self.places)
        if left:
            log.info("%d attempts of the server before this one are made ready again", left)
        await self._executor.start()
        self._loop = asyncio.create_task(self._dispatch(), name="farm")

    async def drain(self, seconds: float) -> None:
        """Give out nothing more; what runs may go on for so long, then it is stopped and its tasks are ready again."""
        self._stopping = True
        self._freed.ring()
        if self._loop is not None:
            _, late = await asyncio.wait({self._loop}, timeout=_ENDING)
            if late:  # the database does not answer
                self._loop.cancel()
        if self._tasks and seconds > 0:
            await asyncio.wait(self._tasks, timeout=seconds)
        for run in self._runs.values():
            run.stop(ExitClass.PREEMPTED, "the server stops")
        if self._tasks:
            _, late = await asyncio.wait(self._tasks, timeout=_ENDING)
            for task in late:  # the next server finds them
                task.cancel()
            if late:
                await asyncio.wait(late, timeout=_ENDING)

    async def close(self) -> None:
        """Stop what runs at once and let go of the workers. The queue is closed by whoever opened it, afterwards."""
        await self.drain(0.0)
        await self._executor.close()
        await self._sheet_workers.close()
        await asyncio.to_thread(self._logs.close)

    # --- what is asked about it ---

    @property
    def places(self) -> Places:
        """The names in the data folder."""
        return self._around.places

    def lanes(self) -> Sequence[Lane]:
        """Where tasks can run, as of now."""
        return self._executor.lanes()

    def running(self, job: int | None = None) -> list[Running]:
        """The attempts that run now: lane, frame at hand, render, progress. Of all jobs, or of one."""
        runs = self._runs.values()
        return [run.now for run in runs if job is None or run.claim.task.job == job]

    def attempt(self, job: int, task: int) -> Running | None:
        """The attempt at a task that runs now."""
        return next((running for running in self.running(job) if running.attempt.task == task), None)

    def log_path(self, job: int, task: int, attempt: int) -> Path:
        """Of an attempt's log; the file may not be there (yet)."""
        return self.places.log(job, task, attempt)

    async def sheet(self, job: int, layer: str) -> Path:
        """The contact sheet of a layer, made now if it is out of date.

        Raises JobNotFoundError, FrameNotFoundError if no frame is done, StorageError if it cannot be made.
        """
        return await self._sheets.sheet(job, layer)

    async def prune(self, jobs: Sequence[int]) -> int:
        """Forget jobs, and what the data folder keeps of them; [bytes] that were freed. Raises as Queue.prune."""
        return await prune(self._queue, self.places, jobs)

    # --- giving out tasks ---

    async def _dispatch(self) -> None:
        """Claim for free lanes and stop what is to be stopped, after each change; sleep otherwise."""
        pause = _FIRST_PAUSE
        while not self._stopping:
            seen, freed = self._queue.changed.count, self._freed.count
            self._executor.changed().clear()
            try:
                await self._give_back_lost()
                await self._stop_ordered()
                # Asked before the claim: what falls due between the two would be missed by both the other way round.
                due = await self._next_due()
                await self._give_out()
            except StorageError as error:
                log.warning("the queue does not answer: %s", error)
                await asyncio.sleep(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)
                continue
            except Exception:
                # Whatever it was, jobs that wait shall not wait for ever because of it.
                log.exception("the dispatcher failed, and goes on")
                await asyncio.sleep(_LONGEST_PAUSE)
                continue
            pause = _FIRST_PAUSE
            await self._news(seen, freed, min(max(0.0, due - time.monotonic()), _LONGEST_SLEEP))

    async def _give_back_lost(self) -> None:
        """Make ready again what nobody runs any more: an end that could not be recorded, a claim not given back.

        Only this loop claims, so between its claims all that runs is in `_runs` until after its end is recorded.
        """
        if time.monotonic() < self._compare_at:
            return
        self._compare_at = time.monotonic() + _COMPARING
        known = {_key(run.claim) for run in self._runs.values()}
        for attempt in await self._queue.running():
            if (attempt.job, attempt.task, attempt.number) not in known:
                ended = await self._queue.finish(attempt, Ending(ExitClass.LOST, "nobody ran it any more"))
                if ended is not None:
                    log.warning("jobs/%d/tasks/%d: attempt %d was lost", attempt.job, attempt.task, attempt.number)

    async def _stop_ordered(self) -> None:
        if not self._runs:
            return
        runs = {_key(run.claim): run for run in self._runs.values()}
        for attempt in await self._queue.orders():
            run = runs.get((attempt.job, attempt.task, attempt.number))
            if run is not None:
                run.stop(ExitClass.CANCELLED, "the job was cancelled, or the task skipped")

    async def _give_out(self) -> None:
        lanes = self._executor.lanes()
        now = time.monotonic()
        free = [lane for lane in lanes if lane.name not in self._runs and self._rests.over(lane.name, now)]
        if not free:
            return
        by_name = {lane.name: lane for lane in free}
        for claim in await self._queue.claim_many(free, lanes):
            if self._stopping:
                await self._queue.finish(claim.attempt, Ending(ExitClass.PREEMPTED, "the server stops"))
            else:
                self._begin(claim, by_name[claim.attempt.worker])

    def _begin(self, claim: Claim, lane: Lane) -> None:
        task, attempt = claim.task, claim.attempt
        log.info(
            "jobs/%d/tasks/%d: attempt %d on %s",
            *(task.job, task.number, attempt.number, lane.name),
            extra=_fields(claim) | {"lane": lane.name},
        )
        attempt_log = self._logs.open(self.places.log(task.job, task.number, attempt.number))
        run = AttemptRun(claim, partial(self._executor.source, lane), self._around, attempt_log)
        self._runs[lane.name] = run
        course = asyncio.create_task(self._see_to_end(run, lane), name=f"jobs/{task.job}/tasks/{task.number}")
        self._tasks.add(course)
        course.add_done_callback(self._tasks.discard)

    async def _see_to_end(self, run: AttemptRun, lane: Lane) -> None:
        claim, begun = run.claim, time.monotonic()
        try:
            ending = await run.run()
            seconds = time.monotonic() - begun
            if self._around.meter is not None:
                self._around.meter.count_attempt(ending.exit_class, seconds)
            self._rests.note(lane.name, ending.exit_class, time.monotonic())
            ended = await insist(lambda: self._queue.finish(claim.attempt, ending))
        except Exception:
            log.exception("jobs/%d/tasks/%d: its end was not recorded", claim.task.job, claim.task.number)
            return
        finally:
            del self._runs[lane.name]
            self._freed.ring()
        name = f"jobs/{claim.task.job}/tasks/{claim.task.number}"
        log.info(
            "%s: %s%s",
            *(name, ending.exit_class, f": {ending.message}" if ending.message else ""),
            extra=_fields(claim) | {"lane": lane.name, "exit_class": ending.exit_class, "seconds": seconds},
        )
        if ended is None:
            log.info("%s: attempt %d was not the current one any more", name, claim.attempt.number)
        elif ending.exit_class is ExitClass.SUCCEEDED and claim.task.kind is TaskKind.MERGE:
            await self._drop_parts(claim)

    async def _drop_parts(self, claim: Claim) -> None:
        """Parts are large, and their image is there."""
        with contextlib.suppress(StorageError, OSError):
            for part in await self._queue.parts(claim.task.job, claim.needs_from):
                if Path(part.path).is_relative_to(self.places.data):
                    await asyncio.to_thread(Path(part.path).unlink, missing_ok=True)

    # --- sleeping ---

    async def _next_due(self) -> float:
        """[s, monotonic] When a delayed task is due, if a lane is free for it, or a lane has rested; else never."""
        if len(self._runs) >= len(self._executor.lanes()):
            return math.inf
        # Read before the queue is asked, at the moment that it reads it: afterwards the wall clock may have been set.
        now, here = self._clock(), time.monotonic()
        due = await self._queue.next_wake()
        rested = self._rests.next_end(here)
        return rested if due is None else min(rested, here + max(0.0, due - now) + _MARGIN)

    async def _news(self, seen: int, freed: int, delay: float) -> None:
        """Until the queue or the lanes have changed, or the time is up."""
        waits: set[asyncio.Task[object]] = {
            asyncio.create_task(self._queue.changed.wait(seen)),
            asyncio.create_task(self._freed.wait(freed)),
            asyncio.create_task(self._executor.changed().wait()),
        }
        try:
            await asyncio.wait(waits, timeout=delay, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()


def _fields(claim: Claim) -> dict[str, object]:
    """What a structured log says of an attempt besides its message."""
    return dict(zip(("job", "task", "attempt"), _key(claim), strict=True)) | {"user": claim.user}


def _key(claim: Claim) -> Key:
    return claim.task.job, claim.task.number, claim.attempt.number
