"""Framed protobuf over the socket pair between server and worker; a frame may carry one file descriptor."""

import array
import asyncio
import contextlib
import os
import socket
import struct
from collections import deque
from typing import TypeVar

from google.protobuf.message import DecodeError, Message

M = TypeVar("M", bound=Message)

_LENGTH = struct.Struct("<I")
# [bytes] Reports of large stages are the longest messages; more is a fault of the sender.
MAX_FRAME = 64 << 20
_READ = 1 << 18
# [descriptors] That may wait to be taken; each is one of the server's own.
_MOST_DESCRIPTORS = 4


class BrokenFrameError(Exception):
    """The other side sent what is no frame."""


class Frames:
    """Takes bytes as they come, gives whole messages."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> None:
        """Add what was read."""
        self._buffer += data

    @property
    def ready(self) -> bool:
        """`take` has something to say."""
        if len(self._buffer) < _LENGTH.size:
            return False
        length: int = _LENGTH.unpack_from(self._buffer)[0]
        return length > MAX_FRAME or len(self._buffer) >= _LENGTH.size + length

    def take(self, kind: type[M]) -> M | None:
        """The next whole message, or None if it is not all there yet. Raises BrokenFrameError."""
        if len(self._buffer) < _LENGTH.size:
            return None
        (length,) = _LENGTH.unpack_from(self._buffer)
        if length > MAX_FRAME:
            raise BrokenFrameError(f"a frame of {length} bytes; at most {MAX_FRAME} are allowed")
        end = _LENGTH.size + length
        if len(self._buffer) < end:
            return None
        try:
            message: M = kind.FromString(bytes(self._buffer[_LENGTH.size : end]))
        except DecodeError as error:
            raise BrokenFrameError(f"a frame that is no {kind.DESCRIPTOR.name}: {error}") from error
        del self._buffer[:end]
        return message


def frame(message: Message) -> bytes:
    """The bytes of one message on the wire."""
    data: bytes = message.SerializeToString()
    return _LENGTH.pack(len(data)) + data


class WorkerEnd:
    """The worker's end: blocking, one reader thread, any writer under the caller's lock."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._frames = Frames()

    def send(self, message: Message, descriptor: int | None = None) -> None:
        """Send one message, and with it a descriptor, of which the receiver gets a duplicate."""
        data = frame(message)
        if descriptor is not None:
            sent = socket.send_fds(self._socket, [data], [descriptor])
            data = data[sent:]
        self._socket.sendall(data)

    def receive(self, kind: type[M]) -> M | None:
        """The next message; None when the server has gone."""
        while True:
            message = self._frames.take(kind)
            if message is not None:
                return message
            data = self._socket.recv(_READ)
            if not data:
                return None
            self._frames.feed(data)


class ServerEnd:
    """The server's end: on the event loop, never blocking, and never ahead of who receives.

    The other side may be a worker that a hostile stage has taken over: what it sends waits in its own socket.
    """

    def __init__(self, connection: socket.socket, kind: type[M]) -> None:
        connection.setblocking(False)
        self._socket = connection
        self._kind = kind
        self._frames = Frames()
        self._descriptors: deque[int] = deque()
        self._news = asyncio.Event()
        self._closed = False
        self._loop = asyncio.get_running_loop()
        self._reading = False
        self._read_on()

    async def send(self, message: Message) -> None:
        """Send one message. Raises OSError if the worker has gone. The caller sets a deadline."""
        await self._loop.sock_sendall(self._socket, frame(message))

    async def receive(self) -> Message | None:
        """The next message; None once the worker has closed its end. The caller sets a deadline."""
        await asyncio.sleep(0)  # others have their turn, however fast this side talks
        while True:
            try:
                message = self._frames.take(self._kind)
            except BrokenFrameError:
                self._stop()
                return None
            if message is not None:
                return message
            if self._closed:
                return None
            self._news.clear()
            self._read_on()
            await self._news.wait()

    def take_descriptor(self) -> int | None:
        """The oldest descriptor that came along; the caller owns it."""
        return self._descriptors.popleft() if self._descriptors else None

    def close(self) -> None:
        """Let go of the socket and of descriptors nobody took."""
        self._stop()
        self._socket.close()
        while self._descriptors:
            os.close(self._descriptors.popleft())

    def _on_readable(self) -> None:
        try:
            data, ancillary, _, _ = self._socket.recvmsg(_READ, socket.CMSG_SPACE(4), socket.MSG_CMSG_CLOEXEC)
            self._keep_descriptors(ancillary)
            self._frames.feed(data)
        except BlockingIOError:
            return
        except (OSError, BrokenFrameError):
            data = b""
        if not data:
            self._stop()
        elif self._frames.ready:
            self._pause()
            self._news.set()

    def _read_on(self) -> None:
        if not self._reading and not self._closed:
            self._loop.add_reader(self._socket.fileno(), self._on_readable)
            self._reading = True

    def _pause(self) -> None:
        if self._reading:
            self._reading = False
            with contextlib.suppress(ValueError, OSError):
                self._loop.remove_reader(self._socket.fileno())

    def _keep_descriptors(self, ancillary: list[tuple[int, int, bytes]]) -> None:
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
                descriptors = array.array("i")
                descriptors.frombytes(data[: len(data) - len(data) % descriptors.itemsize])
                self._descriptors.extend(descriptors)
        if len(self._descriptors) > _MOST_DESCRIPTORS:
            raise BrokenFrameError(f"{len(self._descriptors)} descriptors that nobody takes")

    def _stop(self) -> None:
        if not self._closed:
            self._closed = True
            self._pause()
            self._news.set()
