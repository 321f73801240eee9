"""The server's end of the bridge: starts the process, sorts what it says by conversation, and says when it is gone."""

import asyncio
import contextlib
import logging
import os
import socket
import sys
from itertools import count
from typing import Protocol

from footlight.worker.v1 import bridge_pb2
from footlight_server.farm.ray.environment import Access, ray_environment
from footlight_server.workers.channel import ServerEnd

log = logging.getLogger(__name__)

# [s] For a request to leave; for the process to end.
_SENDING = 5.0
_DYING = 5.0


class Listener(Protocol):
    """One conversation's end here."""

    def hear(self, event: bridge_pb2.BridgeEvent) -> None:
        """What came; `gone` is the last."""
        ...

    def lose(self, why: str) -> None:
        """The bridge is gone, and nothing more will come."""
        ...


class Lanes(Protocol):
    """Is told which lanes there are."""

    def update(self, lanes: bridge_pb2.Lanes) -> None:
        """All of them, as of now."""
        ...


class BridgeLink:
    """One bridge process. Made by `start`; `run` lasts as long as the process; whoever made it calls `close`."""

    def __init__(self, process: asyncio.subprocess.Process, channel: ServerEnd, lanes: Lanes) -> None:
        self._process = process
        self._channel = channel
        self._lanes = lanes
        self._listeners: dict[int, Listener] = {}
        self._numbers = count(1)
        self._sending = asyncio.Lock()
        self._lost = ""

    @classmethod
    async def start(cls, address: str, access: Access, lanes: Lanes) -> "BridgeLink":
        """Start a bridge to the cluster at `address`."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-P",
                "-m",
                "footlight_server.farm.ray.bridge",
                str(theirs.fileno()),
                address,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                env=ray_environment(access, os.environ),
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        return cls(process, ServerEnd(ours, bridge_pb2.BridgeEvent), lanes)

    async def run(self, patience: float) -> None:
        """Hear it until it ends or is silent for `patience` [s]; then every conversation is lost."""
        why = "the bridge to the Ray cluster has ended"
        try:
            while True:
                async with asyncio.timeout(patience):
                    event = await self._channel.receive()
                if event is None:
                    log.warning("%s", why)
                    return
                assert isinstance(event, bridge_pb2.BridgeEvent)
                if event.HasField("lanes"):
                    self._lanes.update(event.lanes)
                elif event.call in self._listeners:
                    self._listeners[event.call].hear(event)
        except TimeoutError:
            why = f"the bridge to the Ray cluster said nothing for {patience:g} s"
            log.warning("%s", why)
        finally:
            self._lost = why
            for listener in list(self._listeners.values()):
                listener.lose(why)

    def open(self, listener: Listener) -> int:
        """The number of a new conversation. One with a bridge that is gone is lost at once."""
        call = next(self._numbers)
        self._listeners[call] = listener
        if self._lost:
            listener.lose(self._lost)
        return call

    def forget(self, call: int) -> None:
        """Nobody listens to this conversation any more."""
        self._listeners.pop(call, None)

    async def send(self, request: bridge_pb2.BridgeRequest) -> None:
        """Send a request; that the bridge is gone shows elsewhere."""
        with contextlib.suppress(OSError, TimeoutError):
            async with asyncio.timeout(_SENDING), self._sending:
                await self._channel.send(request)

    async def close(self) -> None:
        """End the process."""
        self._channel.close()
        try:
            async with asyncio.timeout(_DYING):
                await self._process.wait()
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, 9)
            await self._process.wait()
