"""The durable queue of the farm: every method is one transaction, and what it answers is on disk."""

import asyncio
import logging
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Concatenate, ParamSpec, TypeVar

from sqlalchemy import Connection

from footlight_server.farm.changes import Changes
from footlight_server.farm.model import (
    Attempt,
    Claim,
    Ending,
    Event,
    ExitClass,
    Frame,
    Job,
    JobPlan,
    JobState,
    Lane,
    Limit,
    Selection,
    StagedFrame,
    Task,
    TaskCounts,
    TaskState,
    Usage,
)
from footlight_server.farm.sql import claims, create, endings, facts, frames, lanes, limits, reads, steer, tokens
from footlight_server.farm.sql.database import Database
from footlight_server.farm.sql.engines import READERS
from footlight_server.farm.sql.migrate import migrate
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.sql.writer import Writer
from footlight_server.farm.tokens import Scope, Token
from footlight_server.farm.transitions import Policy
from footlight_server.farm.why import WaitFacts
from footlight_server.sessions.errors import StorageError

log = logging.getLogger(__name__)

P = ParamSpec("P")
T = TypeVar("T")

# [s] A call is given up after this; what it waits for inside (locks, a server) has shorter limits of its own.
PATIENCE = 60.0
_NOT_GIVEN_BACK = "a claim that nobody took could not be given back; the next start does it: %s"
_GIVEN_BACK = Ending(ExitClass.PREEMPTED, "nobody took the claim")


class Queue:
    """One server's queue, in SQLite or PostgreSQL; made by `open`, and nobody else's until `close`.

    Every method raises StorageError if the database is locked, full or away for longer than some seconds; nothing of
    the call has happened then, and it can be made again. A call whose caller is cancelled happens all the same, as a
    whole; a claim that nobody took is given back.
    """

    def __init__(self, database: Database, last_event: int, clock: Callable[[], float], policy: Policy) -> None:
        self._database, self._clock, self._policy = database, clock, policy
        self._writer = Writer(database)
        self._readers = ThreadPoolExecutor(READERS, "queue-reader")
        self._changed = Changes()
        self._first_event = self._last_event = last_event
        # Of the jobs that have had events since; others have had none after the first.
        self._last_events: dict[int, int] = {}
        # [s, monotonic] Of running attempts: the wall clock may be set meanwhile.
        self._begun: dict[tuple[int, int, int], float] = {}

    @classmethod
    async def open(cls, url: str, clock: Callable[[], float] = time.time, policy: Policy | None = None) -> "Queue":
        """The queue at `sqlite:///absolute/path` or `postgresql://user@host/name`, made or migrated as need be.

        `clock`: [s since 1970, UTC]. Raises DatabaseBusyError if a server that lives owns it, DatabaseRefusedError if
        it is of a newer version, on a network file system (SQLite), or not to be opened at all.
        """
        policy = policy or Policy()
        async with asyncio.timeout(PATIENCE):
            database, last_event = await asyncio.to_thread(_opened, url, clock, policy)
        return cls(database, last_event, clock, policy)

    async def close(self) -> None:
        """End what is under way and let go of the database."""
        async with asyncio.timeout(PATIENCE):
            await asyncio.to_thread(self._close)

    @property
    def changed(self) -> Changes:
        """Rings after every transaction that changed something; for the dispatcher and whoever watches jobs."""
        return self._changed

    # --- jobs ---

    async def create_job(self, plan: JobPlan) -> Job:
        """Put a job into the queue. A request_id that this user gave before answers the job it made.

        Raises RequestIdReusedError if that one was of another spec, JobNotFoundError for a job it depends on.
        """
        return await self._write(create.create_job, plan)

    async def job_of_request(self, user: str, request_id: str) -> Job | None:
        """The job that this user made with that request_id, if it is not pruned."""
        return await self._read(reads.job_of_request, user, request_id)

    async def usage(self, user: str) -> Usage:
        """What a user has in the queue that has not ended."""
        return await self._read(reads.usage, user)

    async def task_counts(self) -> TaskCounts:
        """Tasks by state, over all jobs that are not pruned."""
        return await self._read(reads.task_counts)

    async def job(self, number: int) -> Job:
        """A job as it is. Raises JobNotFoundError."""
        return await self._read(reads.job_numbered, number)

    async def jobs(
        self,
        limit: int,
        before: int | None = None,
        states: Iterable[JobState] = (),
        user: str = "",
        show: str = "",
        shot: str = "",
        tag: str = "",
    ) -> list[Job]:
        """Newest first, with numbers below `before`; what is empty chooses all."""
        return await self._read(reads.jobs, limit, before, tuple(states), user, show, shot, tag)

    async def pause(self, number: int) -> Job:
        """Start nothing new of a job. Idempotent. Raises JobNotFoundError, JobEndedError."""
        return await self._write(steer.pause, number, paused=True)

    async def resume(self, number: int) -> Job:
        """Start tasks of it again. Idempotent. Raises JobNotFoundError, JobEndedError."""
        return await self._write(steer.pause, number, paused=False)

    async def cancel(self, number: int) -> Job:
        """Cancel what waits at once; what runs is in `orders` and ends when the dispatcher says so. Idempotent.

        Does nothing to a job that has ended. Raises JobNotFoundError.
        """
        return await self._write(steer.cancel, number)

    async def retry(self, number: int, selection: Selection) -> tuple[Job, int]:
        """Another round for tasks that have failed, were skipped or cancelled; answers how many that were.

        Raises JobNotFoundError, TaskNotFoundError for a task or layer that the job does not have.
        """
        return await self._write(steer.retry, number, selection)

    async def skip(self, number: int, selection: Selection) -> tuple[Job, int]:
        """Give up on tasks that have not succeeded; those that run are in `orders` and end when the dispatcher says so.

        Answers how many were chosen. Raises JobNotFoundError, TaskNotFoundError.
        """
        return await self._write(steer.skip, number, selection)

    async def prunable(self, older_than: float, user: str | None = None) -> list[int]:
        """Jobs that have ended for longer than `older_than` [s], and that no job still waits for; of a user, or all."""
        return await self._read(steer.prunable, self._clock() - older_than, user)

    async def prune(self, numbers: Sequence[int]) -> None:
        """Forget jobs, all or none. Raises JobNotFoundError, JobNotEndedError (also if a job still waits for it)."""
        await self._write(steer.prune, tuple(numbers))
        for number in numbers:
            self._last_events.pop(number, None)

    async def bundles_in_use(self) -> set[str]:
        """Digests of bundles that a job which is not pruned was made with."""
        return await self._read(reads.bundles_in_use)

    # --- tasks ---

    async def tasks(
        self,
        job: int,
        limit: int,
        after: int = 0,
        states: Iterable[TaskState] = (),
        layer: str = "",
    ) -> list[Task]:
        """In order, with numbers above `after` and their last attempts. Raises JobNotFoundError."""
        return await self._read(reads.tasks, job, limit, after, tuple(states), layer)

    async def task(self, job: int, number: int) -> Task:
        """A task with its last attempt. Raises JobNotFoundError, TaskNotFoundError."""
        return await self._read(reads.task_numbered, job, number)

    async def attempts(self, job: int, task: int) -> list[Attempt]:
        """All attempts at a task, in order. Raises JobNotFoundError, TaskNotFoundError."""
        return await self._read(reads.attempts, job, task)

    async def layer_spec(self, job: int, layer: str) -> bytes:
        """The serialized LayerSpec. Raises JobNotFoundError, FrameNotFoundError if it has no such layer."""
        return await self._read(reads.layer_spec, job, layer)

    # --- frames ---

    async def frames(self, job: int, limit: int, after: tuple[str, int] | None = None) -> list[Frame]:
        """Images (no parts) by layer and frame number, after that (layer, frame). Raises JobNotFoundError."""
        return await self._read(reads.frames, job, limit, after)

    async def frame(self, job: int, layer: str, frame: int) -> Frame:
        """The image of a frame. Raises JobNotFoundError, FrameNotFoundError."""
        return await self._read(reads.frame, job, layer, frame)

    async def parts(self, job: int, tasks: Sequence[int]) -> list[Frame]:
        """What these tasks have made, images or parts, by task and frame number."""
        return await self._read(reads.parts, job, tuple(tasks))

    async def stage_frame(self, attempt: Attempt, frame: Frame, temp_path: str) -> bool:
        """Note, before the rename, that `temp_path` holds what will be at `frame.path`.

        False: the attempt is not the current one any more, and the file is not to be renamed.
        """
        return await self._write(frames.stage_frame, attempt, frame, temp_path)

    async def commit_frame(self, attempt: Attempt, frame: Frame) -> bool:
        """Record, after the rename, that the frame is there. False: the attempt is not the current one any more."""
        return await self._write(frames.commit_frame, attempt, frame)

    async def staged(self) -> list[StagedFrame]:
        """Frames whose rename may or may not have happened when the server died.

        At start, before `recover`: for each, look whether the file at `frame.path` (or at `temp_path`, then rename it)
        has the digest of the frame; if so `commit_frame`, which takes it as long as the attempt is current; otherwise
        `unstage`.
        """
        return await self._read(reads.staged)

    async def unstage(self, staged: StagedFrame) -> None:
        """Forget that a frame was staged. Idempotent."""
        await self._write(frames.unstage, staged)

    # --- giving tasks to lanes ---

    async def claim(self, lane: Lane, live_lanes: Sequence[Lane]) -> Claim | None:
        """The next task for a lane, now RUNNING in a new attempt; None if there is nothing for it now.

        Highest priority first, then the older job, then the task's number; of what is READY, not paused, not delayed
        after a failure, within all limits, and not barred from this lane by its failures there. `live_lanes`: all lanes
        there are, busy or not; where every one of them is barred, one may be used all the same.
        """
        found = await self.claim_many([lane], live_lanes)
        return found[0] if found else None

    async def claim_many(self, lanes: Sequence[Lane], live_lanes: Sequence[Lane]) -> list[Claim]:
        """As `claim` for each of these lanes in turn, in one transaction. `claim.attempt.worker` names the lane."""
        work = self._start_write(claims.claim_many, tuple(lanes), tuple(live_lanes))
        try:
            found = await _in_time(work)
        except (asyncio.CancelledError, StorageError):  # nobody takes what it may still find
            work.add_done_callback(self._give_back)
            raise
        self._begun |= {_key(claim.attempt): time.monotonic() for claim in found}
        return found

    async def finish(self, attempt: Attempt, ending: Ending) -> Task | None:
        """End an attempt: its task ends, or waits for another one. None: the attempt was not the current one any more.

        Where stopping it was asked for (see `orders`), any ending but SUCCEEDED means that it has been stopped.
        """
        begun = self._begun.get(_key(attempt))
        seconds = 0.0 if begun is None else time.monotonic() - begun
        task = await self._write(endings.finish, attempt, ending, seconds)
        self._begun.pop(_key(attempt), None)
        return task

    async def recover(self) -> int:
        """At start, after `staged`: attempts that a server left running are PREEMPTED; answers how many."""
        return await self._write(endings.recover)

    async def running(self) -> list[Attempt]:
        """The attempts that have not ended."""
        return await self._read(reads.running)

    async def orders(self) -> list[Attempt]:
        """Running attempts that shall be stopped, because their job was cancelled or their task skipped.

        The dispatcher asks after each change, stops them, and then says `finish` with CANCELLED for each.
        """
        return await self._read(reads.orders)

    async def next_wake(self) -> float | None:
        """When the first task that is delayed after a failure may be taken up [s since 1970, UTC]; None: none waits."""
        return await self._read(facts.next_wake, self._clock(), self._policy)

    async def blocked_jobs(self, lane: Lane) -> list[int]:
        """Jobs that have not ended and do not use this lane, because too many of their tasks failed on it."""
        return await self._read(lanes.blocked_jobs, lane.name, self._policy.block_after)

    # --- limits ---

    async def set_limit(self, limit: Limit) -> Limit:
        """Make or change a limit (`running` is not read). Idempotent. What runs above it goes on."""
        return await self._write(limits.set_limit, limit)

    async def limits(self) -> list[Limit]:
        """All limits by name, with what runs now."""
        return await self._read(limits.limits)

    # --- what has happened, and what has not ---

    async def events(self, job: int, after: int, limit: int, *, certain: bool = False) -> list[Event]:
        """What was recorded of a job after that event, in order. Cheap if there is nothing new.

        `certain`: all that was on disk when this was called, though `changed` may not have rung for it yet.
        """
        if not certain and after >= self._last_events.get(job, self._first_event):
            return []
        return await self._read(reads.events, job, after, limit)

    def last_event(self) -> int:
        """Id of the last event recorded, of any job."""
        return self._last_event

    async def wait_facts(self, job: int, task: int | None = None) -> WaitFacts:
        """What `explain_wait` of farm/why.py needs to know. Raises JobNotFoundError, TaskNotFoundError."""
        return await self._read(facts.wait_facts, job, task, self._clock(), self._policy)

    # --- tokens ---

    async def create_token(
        self, token_hash: str, user: str, scope: Scope, comment: str = "", expires: float | None = None
    ) -> Token:
        """Keep a token by the hash of its secret."""
        return await self._write(tokens.create_token, token_hash, user, scope, comment, expires)

    async def tokens(self) -> list[Token]:
        """All tokens by number, the revoked ones too."""
        return await self._read(tokens.tokens)

    async def token_by_hash(self, token_hash: str) -> Token | None:
        """The token, whether it still opens anything or not."""
        return await self._read(tokens.token_by_hash, token_hash)

    async def revoke_token(self, number: int) -> Token:
        """It opens nothing from now on. Idempotent. Raises TokenNotFoundError."""
        return await self._write(tokens.revoke_token, number)

    async def touch_token(self, number: int, used: float) -> None:
        """Note when it was used last [s since 1970, UTC]; an earlier time than is known changes nothing."""
        await self._write(tokens.touch_token, number, used)

    # --- transactions ---

    async def _read(self, work: Callable[Concatenate[Connection, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            call = asyncio.get_running_loop().run_in_executor(
                self._readers, lambda: self._database.read(work, *args, **kwargs)
            )
        except RuntimeError as error:
            raise StorageError("the queue is closed") from error
        return await _in_time(call)

    async def _write(self, work: Callable[Concatenate[Transaction, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        return await _in_time(self._start_write(work, *args, **kwargs))

    def _start_write(
        self, work: Callable[Concatenate[Transaction, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> "asyncio.Future[T]":
        """The call's future. Cancelled or not, what changed is told to whoever waits for changes."""
        written = asyncio.wrap_future(self._writer.submit(lambda transaction: work(transaction, *args, **kwargs)))
        answer: asyncio.Future[T] = asyncio.get_running_loop().create_future()

        def tell(_: object) -> None:
            if error := written.exception():
                answer.set_exception(error)
                answer.exception()  # seen, though perhaps nobody waits any more
            else:
                value, transaction = written.result()
                self._tell(transaction)
                answer.set_result(value)

        written.add_done_callback(tell)
        return answer

    def _tell(self, transaction: Transaction) -> None:
        self._last_event = max(self._last_event, transaction.last_event)
        self._last_events |= dict.fromkeys(transaction.jobs, transaction.last_event)
        if transaction.rings:
            self._changed.ring()

    def _give_back(self, claimed: "asyncio.Future[list[Claim]]") -> None:
        """Claims that nobody took, since their caller was cancelled."""
        if claimed.cancelled() or claimed.exception():
            return
        try:
            for claim in claimed.result():
                self._start_write(endings.finish, claim.attempt, _GIVEN_BACK, 0.0).add_done_callback(_note_failure)
        except StorageError as error:
            log.warning(_NOT_GIVEN_BACK, error)

    def _close(self) -> None:
        self._writer.close()
        self._readers.shutdown()
        self._database.close()


def _opened(url: str, clock: Callable[[], float], policy: Policy) -> tuple[Database, int]:
    """The database, and the id of its last event."""
    database = Database(url, clock, policy)
    try:
        migrate(database)
        return database, database.read(reads.last_event)
    except BaseException:
        database.close()
        raise


async def _in_time(call: "asyncio.Future[T]") -> T:
    """Its result. It is never interrupted: a transaction happens as a whole or not at all, whoever waits for it."""
    try:
        # Not wait_for: in Python 3.11 it loses a cancellation that comes together with the result.
        async with asyncio.timeout(PATIENCE):
            return await asyncio.shield(call)
    except TimeoutError as error:
        raise StorageError(f"the database did not answer for {PATIENCE:g} s") from error


def _note_failure(call: "asyncio.Future[Task | None]") -> None:
    if not call.cancelled() and (error := call.exception()):
        log.warning(_NOT_GIVEN_BACK, error)


def _key(attempt: Attempt) -> tuple[int, int, int]:
    return attempt.job, attempt.task, attempt.number
