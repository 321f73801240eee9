"""One worker process as the server holds it: spawn, talk, watch its memory, kill, read its end."""

import asyncio
import contextlib
import logging
import os
import socket
import sys
from collections import deque

from footlight.worker.v1 import worker_pb2
from footlight_server.workers import bubblewrap
from footlight_server.workers.channel import ServerEnd
from footlight_server.workers.failure import Failure, FailureReason, read_exit
from footlight_server.workers.film import Film, FilmShape, Plane, open_film
from footlight_server.workers.limits import worker_environment
from footlight_server.workers.memory import resident_memory

log = logging.getLogger(__name__)

_CHILD = "footlight_server.workers.child"
# [bytes] Of its last words that are kept.
_STDERR_KEPT = 8192
# [s] How often its memory is looked at.
_WATCH_PERIOD = 0.25
# [s] From SIGKILL until we stop waiting; from the start until it is warm.
_DYING = 2.0
WARMING = 60.0


class WorkerGoneError(Exception):
    """The process has ended without a last message."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class WorkerProcess:
    """A child that takes one task. Made by `spawn`; whoever holds it calls `close`."""

    def __init__(
        self, process: asyncio.subprocess.Process, channel: ServerEnd, memory_limit: int, *, inside: bool
    ) -> None:
        self._process = process
        self._channel = channel
        self._memory_limit = memory_limit
        # Of bubblewrap, which tells of the child's end with its own.
        self._inside = inside
        self._stderr: deque[bytes] = deque()
        self._over_memory = False
        self._peak = 0
        self._tasks = (asyncio.create_task(self._keep_last_words()), asyncio.create_task(self._watch_memory()))
        self.versions: dict[str, str] = {}

    @classmethod
    async def spawn(cls, memory_limit: int, confinement: worker_pb2.Confinement | None = None) -> "WorkerProcess":
        """Start a child; it warms up by itself. `memory_limit` [bytes], 0: none.

        With a `confinement` it runs inside bubblewrap. Raises WorkerGoneError if that is not installed.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        command = [sys.executable, "-P", "-m", _CHILD, str(theirs.fileno())]
        try:
            environment = worker_environment(os.environ)
            if confinement is not None:
                command = await asyncio.to_thread(_inside, confinement, command)
                environment = bubblewrap.environment(os.environ)
            process = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=asyncio.subprocess.PIPE,
                env=environment,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        return cls(process, ServerEnd(ours, worker_pb2.WorkerEvent), memory_limit, inside=confinement is not None)

    @property
    def pid(self) -> int:
        """Of the child."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """It has not ended yet, as far as we know."""
        return self._process.returncode is None

    @property
    def peak_memory(self) -> int:
        """[bytes] The most it was seen to hold so far."""
        return self._peak

    @property
    def last_words(self) -> str:
        """The end of what it wrote to standard error."""
        return b"".join(self._stderr).decode(errors="replace")

    async def warm_up(self) -> None:
        """Wait until its modules are loaded. Raises WorkerGoneError."""
        try:
            async with asyncio.timeout(WARMING):
                event = await self.receive()
        except TimeoutError:
            self.kill()
            message = f"a worker was not ready within {WARMING:g} s"
            raise WorkerGoneError(Failure(FailureReason.TIMEOUT, message)) from None
        self.versions = dict(event.ready.versions)
        if event.HasField("failed"):
            self.kill()
            raise WorkerGoneError(Failure(FailureReason.INTERNAL, event.failed.message))

    async def send(self, request: worker_pb2.WorkerRequest) -> None:
        """Send a request; if the worker has gone that shows in `receive`. A worker that does not read is killed."""
        try:
            async with asyncio.timeout(_DYING):
                await self._channel.send(request)
        except TimeoutError:
            self.kill()
        except OSError:
            log.debug("worker %d has gone before it could be told", self.pid)

    async def receive(self) -> worker_pb2.WorkerEvent:
        """The next event. Raises WorkerGoneError. The caller sets a deadline."""
        event = await self._channel.receive()
        if event is None:
            raise WorkerGoneError(await self._read_end())
        assert isinstance(event, worker_pb2.WorkerEvent)
        return event

    def open_film(self, message: worker_pb2.Film) -> Film:
        """The pixels that a Film event announces. Raises ValueError if it is not what it says."""
        planes = tuple(Plane(aov.name, aov.channels, aov.offset) for aov in message.aovs)
        descriptor = self._channel.take_descriptor()
        if descriptor is None:
            raise ValueError("a film came without its memory")
        return open_film(FilmShape(message.width, message.height, planes), descriptor)

    def kill(self) -> None:
        """SIGKILL to the child and what it may have started."""
        if self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, 9)

    async def close(self) -> None:
        """Kill it if it lives, wait for its end, let go of everything."""
        self.kill()
        try:
            async with asyncio.timeout(_DYING):
                await self._process.wait()
        except TimeoutError:
            log.warning("worker %d does not die", self.pid)
        finally:
            self._channel.close()
            for task in self._tasks:
                task.cancel()

    async def _read_end(self) -> Failure:
        """What the process died of. A child that has closed its socket but lives on is killed."""
        try:
            async with asyncio.timeout(_DYING / 2):
                await self._process.wait()
        except TimeoutError:
            self.kill()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_DYING / 2):
                    await self._process.wait()
        await asyncio.wait({self._tasks[0]}, timeout=0.2)
        words = self.last_words
        if words:
            log.warning("worker %d said: %s", self.pid, words.strip()[-2000:])
        return read_exit(self._exit_code(), words, self._peak, self._memory_limit, over_memory=self._over_memory)

    def _exit_code(self) -> int:
        """As in subprocess: a signal is negative, also one that bubblewrap tells of as a shell does."""
        code = self._process.returncode
        if code is None:
            return -9
        return 128 - code if self._inside and code > 128 else code

    async def _keep_last_words(self) -> None:
        assert self._process.stderr is not None
        kept = 0
        while data := await self._process.stderr.read(4096):
            self._stderr.append(data)
            kept += len(data)
            while kept - len(self._stderr[0]) > _STDERR_KEPT:
                kept -= len(self._stderr.popleft())

    async def _watch_memory(self) -> None:
        """The second line behind the limit of address space, which does not count what is really held."""
        while self._process.returncode is None:
            held = resident_memory(self.pid)
            self._peak = max(self._peak, held)
            if self._memory_limit and held > self._memory_limit:
                self._over_memory = True
                self.kill()
                return
            await asyncio.sleep(_WATCH_PERIOD)


def _inside(confinement: worker_pb2.Confinement, inner: list[str]) -> list[str]:
    program = bubblewrap.find_program()
    if program is None:
        raise WorkerGoneError(Failure(FailureReason.INTERNAL, "bubblewrap is not installed any more"))
    return bubblewrap.command(program, confinement, inner)
