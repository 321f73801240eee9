"""What happens to a job, read once for all who watch it: any number of watchers costs the queue as much as one."""

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Iterator

from footlight.v1 import job_pb2
from footlight_server.api.job_messages import job_message, timestamp
from footlight_server.api.job_views import JobViews, Seen
from footlight_server.api.names import job_name
from footlight_server.farm.attempt import Running
from footlight_server.farm.changes import Changes
from footlight_server.farm.model import TaskState
from footlight_server.sessions.errors import ServiceError, ShuttingDownError

log = logging.getLogger(__name__)

# [events] Read at a time.
PAGE = 250
# [messages], [bytes] Kept for those who are a little late; who is later than that reads the queue's record.
_KEPT = 1000
_KEPT_BYTES = 4 << 20
# [s] Between two looks at the queue: what happens in between comes together.
_PACE = 0.1
# [s] Between two messages of counts, and of a task's progress; said in the protocol.
_PERIOD = 1.0
# [s] Without any change; a look costs nothing then.
_IDLE = 30.0


class JobFeed:
    """The latest of one job: events from after `floor` on, and in their place counts and progress that have no id."""

    def __init__(self, number: int, views: JobViews) -> None:
        self.news = Changes()
        # All events of the job with a greater id are, or were, in here.
        self.floor = views.queue.last_event()
        # The job had ended when it was last looked at.
        self.ended = False
        # What ended the feed itself.
        self.error: Exception | None = None
        self.watchers = 0
        self._number = number
        self._views = views
        self._kept: deque[Seen] = deque()
        self._kept_bytes = 0
        # Messages that are not kept any more.
        self._dropped = 0
        self._read_to = self.floor
        self._counts_due = False
        self._counts_sent = 0.0
        self._progress_sent = 0.0
        self._progress: dict[int, bytes] = {}
        self._reader = asyncio.create_task(self._run(), name=f"feed of {job_name(number)}")

    def position(self, after: int) -> int | None:
        """Where to begin for whoever has seen the events up to `after`; None: not everything since is here."""
        if after < self.floor:
            return None
        ahead = next((i for i, seen in enumerate(self._kept) if seen.id > after), len(self._kept))
        return self._dropped + ahead

    def since(self, position: int) -> list[Seen] | None:
        """The messages from a position on; None: some of them are not here any more."""
        if position < self._dropped:
            return None
        return [self._kept[i] for i in range(position - self._dropped, len(self._kept))]

    async def close(self) -> None:
        """Read no more; who still watches is told that the server stops."""
        self._fail(ShuttingDownError("the server is stopping"))
        self._reader.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._reader

    async def _run(self) -> None:
        try:
            self.ended = (await self._views.queue.job(self._number)).state.ended
            while True:
                seen = self._views.queue.changed.count
                await self._read()
                await self._show_counts()
                await self._show_progress()
                self.news.ring()
                await asyncio.sleep(_PACE)
                await self._wait(seen)
        except ServiceError as error:
            self._fail(error)
        except Exception as error:
            log.exception("%s: its feed failed", job_name(self._number))
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Whoever watches is told."""
        self.error = self.error or error
        self.news.ring()

    async def _read(self) -> None:
        """Take in all that was recorded since."""
        while events := await self._views.queue.events(self._number, self._read_to, PAGE):
            resolved = await self._views.resolve(self._number, events)
            for seen in resolved.seen:
                self._keep(seen)
            self._read_to = events[-1].id
            self.ended = resolved.job.state.ended
            self._counts_due = not any(seen.event.HasField("changed") for seen in resolved.seen)

    async def _show_counts(self) -> None:
        """Counts follow tasks without an event of their own."""
        now = time.monotonic()
        if self._counts_due and now - self._counts_sent >= _PERIOD:
            job = await self._views.queue.job(self._number)
            self._keep_unrecorded(job_pb2.JobEvent(changed=job_message(job)))
            self._counts_due, self._counts_sent = False, now

    async def _show_progress(self) -> None:
        """Of tasks that have come further."""
        now = time.monotonic()
        if now - self._progress_sent < _PERIOD:
            return
        self._progress_sent = now
        moved = [run for run in self._views.farm.running(self._number) if self._has_moved(run)]
        tasks = [await self._views.queue.task(self._number, run.attempt.task) for run in moved]
        for message in await self._views.tasks([task for task in tasks if task.state is TaskState.RUNNING]):
            self._keep_unrecorded(job_pb2.JobEvent(progress=message))

    def _has_moved(self, run: Running) -> bool:
        if run.progress is None:
            return False
        now = run.progress.SerializeToString(deterministic=True)
        before, self._progress[run.attempt.task] = self._progress.get(run.attempt.task), now
        return bool(now != before)

    async def _wait(self, seen: int) -> None:
        """Until the queue has changed, or it is time for counts or progress."""
        busy = self._counts_due or self._views.farm.running(self._number)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_PERIOD - _PACE if busy else _IDLE):
                await self._views.queue.changed.wait(seen)

    def _keep_unrecorded(self, event: job_pb2.JobEvent) -> None:
        event.job = job_name(self._number)
        event.time.CopyFrom(timestamp(time.time()))
        self._keep(Seen(0, event, event.ByteSize()))

    def _keep(self, seen: Seen) -> None:
        self._kept.append(seen)
        self._kept_bytes += seen.size
        while len(self._kept) > _KEPT or (self._kept_bytes > _KEPT_BYTES and len(self._kept) > 1):
            dropped = self._kept.popleft()
            self._kept_bytes -= dropped.size
            self._dropped += 1
            self.floor = max(self.floor, dropped.id)


class JobFeeds:
    """One feed for each job that is watched, for as long as it is."""

    def __init__(self, views: JobViews) -> None:
        self._views = views
        self._feeds: dict[int, JobFeed] = {}
        self._closing: set[asyncio.Task[None]] = set()

    @contextlib.contextmanager
    def watching(self, number: int) -> Iterator[JobFeed]:
        """The feed of a job inside the block."""
        feed = self._feeds.get(number)
        if feed is None or feed.error is not None:
            feed = self._feeds[number] = JobFeed(number, self._views)
        feed.watchers += 1
        try:
            yield feed
        finally:
            feed.watchers -= 1
            if not feed.watchers:
                self._let_go(number, feed)

    async def close(self) -> None:
        """Let go of all."""
        for number, feed in list(self._feeds.items()):
            self._let_go(number, feed)
        if self._closing:
            await asyncio.wait(self._closing, timeout=_PERIOD)

    def _let_go(self, number: int, feed: JobFeed) -> None:
        if self._feeds.get(number) is feed:
            del self._feeds[number]
        closing = asyncio.create_task(feed.close())
        self._closing.add(closing)
        closing.add_done_callback(self._closing.discard)
