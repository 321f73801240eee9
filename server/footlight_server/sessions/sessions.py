"""All renders of a server: the queue in front of the workers, what is remembered, and the end."""

import asyncio
import uuid
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from footlight.v1 import render_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.sessions.errors import (
    QueueFullError,
    RenderNotFoundError,
    RequestIdReusedError,
    ShuttingDownError,
)
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.session import Session
from footlight_server.sessions.tasks import make_task
from footlight_server.settings import Settings
from footlight_server.workers.pool import WorkerPool

# [renders] That have ended and are remembered with their results; said in the protocol.
REMEMBERED = 100
# [bytes] Of pixels of ended renders, kept for viewers that come late.
KEPT_PIXELS = 256 << 20
# [renders] That may wait.
LONGEST_QUEUE = 10_000
# [renders] Made for the farm that have ended and can still be asked for, without their pixels.
_REMEMBERED_ADOPTED = 32
# [bytes] Of a page, after which no more follows; clients take 4 MB, and a report has up to 2 MB.
_PAGE_BYTES = 3 << 19
# [s] For all renders to end when the server stops.
_STOPPING = 4.0


@dataclass(frozen=True, slots=True)
class Page:
    """Renders, newest first, and where the next page begins; empty: nowhere."""

    renders: list[render_pb2.Render]
    next_token: str


@dataclass(frozen=True, slots=True)
class _Running:
    """A session that has not ended, or is just ending, and the task that sees to it."""

    session: Session
    task: asyncio.Task[None]

    def cancel(self, *, keep: bool) -> None:
        """Have it end; one that waits for a worker waits no longer."""
        waits = not self.session.taken_up
        self.session.cancel(keep=keep)
        if waits:
            self.task.cancel()


class Sessions:
    """Owns the tasks that run renders. Everything happens on the event loop."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._pool = WorkerPool(settings.worker_memory, spare=not settings.private)
        self._slots = asyncio.Semaphore(settings.workers)
        self._encoders = ThreadPoolExecutor(1, "encoder")
        # In the order they were created.
        self._sessions: dict[str, Session] = {}
        self._running: dict[str, _Running] = {}
        # In the order they ended.
        self._ended: deque[str] = deque()
        # request_id -> what was asked for, and the render that came of it.
        self._requests: dict[str, tuple[bytes, str]] = {}
        self._numbers = count(1)
        # Renders that the farm runs, by name: what clients may look at, and nothing of what is above.
        self._adopted: dict[str, Session] = {}
        self._stopping = False

    def warm_up(self) -> None:
        """Have the first worker ready before the first render."""
        self._pool.prepare()

    def create(self, spec: render_pb2.RenderSpec, request_id: str, files: Path | None = None) -> Session:
        """Accept a render, or find the one that the same request made before. `files`: of the spec's bundle."""
        asked = spec.SerializeToString(deterministic=True)
        if request_id in self._requests:
            known, name = self._requests[request_id]
            if known != asked:
                raise RequestIdReusedError(f"request_id {request_id!r} named a different render, {name}")
            return self.get(name)
        session = self._start(spec, files, explain=False)
        self._sessions[session.name] = session
        if request_id:
            self._requests[request_id] = (asked, session.name)
            session.request_id = request_id
        return session

    def knows(self, request_id: str) -> bool:
        """A render was made with this request_id, and is remembered."""
        return request_id in self._requests

    def get(self, name: str) -> Session:
        """The render of that name, the farm's as well. Raises RenderNotFoundError."""
        session = self._sessions.get(name) or self._adopted.get(name)
        if session is None:
            raise RenderNotFoundError(f"no render {name!r}")
        return session

    def page(self, size: int, newest: int | None) -> Page:
        """Up to `size` renders, from number `newest` down; fewer if their reports are long."""
        numbered = (s for s in reversed(self._sessions.values()) if newest is None or s.number <= newest)
        renders: list[render_pb2.Render] = []
        total = 0
        for session in numbered:
            if len(renders) == size or total > _PAGE_BYTES:
                return Page(renders, str(session.number))
            renders.append(session.render)
            total += renders[-1].ByteSize()
        return Page(renders, "")

    def adopt(self, task: worker_pb2.Task, directory: Path, patience: Patience) -> Session:
        """A session that the farm runs by itself: no slot, no place in the list, but watched like any render."""
        session = Session(uuid.uuid4().hex, 0, task, directory, patience, self._encoders)
        self._adopted[session.name] = session
        while len(self._adopted) > _REMEMBERED_ADOPTED:
            ended = next((name for name, known in self._adopted.items() if known.ended), None)
            if ended is None:
                break
            del self._adopted[ended]
        return session

    def cancel(self, name: str, *, keep: bool) -> Session:
        """Have a render end soon. The farm's are stopped through their job."""
        session = self.get(name)
        if name in self._adopted:
            raise RenderNotFoundError(f"{name} belongs to a job; cancel the job, or skip its task")
        if name in self._running:
            self._running[name].cancel(keep=keep)
        return session

    def bundles_in_use(self) -> set[str]:
        """Of the renders that have not ended; the farm knows its own."""
        return {running.session.render.spec.bundle for running in self._running.values()} - {""}

    async def explain(self, spec: render_pb2.RenderSpec, files: Path | None = None) -> render_pb2.Render:
        """Translate a stage without rendering it; if the caller gives up, so do we. `files`: of the spec's bundle."""
        running = self._running[self._start(spec, files, explain=True).name]
        try:
            await asyncio.shield(running.task)
            return running.session.render
        finally:
            running.cancel(keep=False)

    def drain(self) -> None:
        """Accept nothing more; what was accepted goes on."""
        self._stopping = True

    async def close(self) -> None:
        """End everything, within seconds."""
        self._stopping = True
        tasks = [running.task for running in self._running.values()]
        for running in list(self._running.values()):
            running.cancel(keep=False)
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=_STOPPING)
            for task in late:
                task.cancel()
        await self._pool.close()
        self._encoders.shutdown(wait=False, cancel_futures=True)

    def _start(self, spec: render_pb2.RenderSpec, files: Path | None, *, explain: bool) -> Session:
        if self._stopping:
            raise ShuttingDownError("the server is stopping")
        if len(self._running) >= LONGEST_QUEUE:
            raise QueueFullError(f"{len(self._running)} renders wait; that is the most")
        identifier = uuid.uuid4().hex
        directory = self._settings.scratch / identifier
        task = make_task(spec, self._settings, directory, files)
        task.explain = explain
        session = Session(identifier, next(self._numbers), task, directory, self._settings.patience, self._encoders)
        running = asyncio.create_task(self._run(session), name=session.name)
        self._running[session.name] = _Running(session, running)
        running.add_done_callback(lambda _: self._retire(session))
        return session

    async def _run(self, session: Session) -> None:
        async with self._slots:
            await session.run(self._pool)

    def _retire(self, session: Session) -> None:
        """It has ended: forget what is older than what we remember."""
        self._running.pop(session.name, None)
        if not self._stopping:
            self._pool.prepare()
        if session.name not in self._sessions:
            return
        if not session.has_image:
            session.forget_pixels()
        self._ended.append(session.name)
        while len(self._ended) > REMEMBERED:
            self._forget(self._sessions.pop(self._ended.popleft()))
        pixels = 0
        for name in reversed(self._ended):
            pixels += self._sessions[name].film_bytes
            if pixels > KEPT_PIXELS:
                self._sessions[name].forget_pixels()

    def _forget(self, session: Session) -> None:
        if session.request_id:
            del self._requests[session.request_id]
        asyncio.get_running_loop().run_in_executor(None, session.discard_files)
