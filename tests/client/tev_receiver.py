"""A viewer for tests: listens on TCP and takes tev's packets apart, as its Ipc.cpp reads them."""

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

CLOSE, CREATE, UPDATE_V3 = 2, 4, 6


class Reader:
    """Values from a packet's payload, in order."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def number(self, code: str) -> int:
        (value,) = struct.unpack_from(f"<{code}", self.data, self.at)
        self.at += struct.calcsize(f"<{code}")
        return int(value)

    def text(self) -> str:
        end = self.data.index(0, self.at)
        value = self.data[self.at : end].decode()
        self.at = end + 1
        return value


@dataclass
class TevReceiver:
    """`images[name]` is (H, W, C) float32; `created` and `closed` are names in order; `updates` counts packets."""

    port: int
    images: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    channels: dict[str, list[str]] = field(default_factory=dict)
    created: list[str] = field(default_factory=list)
    closed: list[str] = field(default_factory=list)
    updates: int = 0
    faults: list[str] = field(default_factory=list)

    def take(self, packet: bytes) -> None:
        """One packet without its length."""
        reader = Reader(packet)
        kind = reader.number("b")
        if kind == CREATE:
            reader.number("b")  # grab focus
            name, width, height = reader.text(), reader.number("i"), reader.number("i")
            self.channels[name] = [reader.text() for _ in range(reader.number("i"))]
            self.images[name] = np.zeros((height, width, len(self.channels[name])), np.float32)
            self.created.append(name)
        elif kind == UPDATE_V3:
            self._update(reader)
        elif kind == CLOSE:
            self.closed.append(reader.text())
        else:
            raise ValueError(f"packet of type {kind}")
        if reader.at != len(packet):
            raise ValueError(f"{len(packet) - reader.at} bytes too many in a packet of type {kind}")

    def _update(self, reader: Reader) -> None:
        reader.number("b")
        name = reader.text()
        names = [reader.text() for _ in range(reader.number("i"))]
        x, y, width, height = (reader.number("i") for _ in range(4))
        offsets = [reader.number("q") for _ in names]
        strides = [reader.number("q") for _ in names]
        image = self.images[name]
        if x < 0 or y < 0 or x + width > image.shape[1] or y + height > image.shape[0]:
            raise ValueError(f"{width}x{height} at {x},{y} is outside {name}")
        values = np.frombuffer(reader.data, "<f4", offset=reader.at)
        for channel, offset, stride in zip(names, offsets, strides, strict=True):
            plane = values[offset::stride][: width * height].reshape(height, width)
            image[y : y + height, x : x + width, self.channels[name].index(channel)] = plane
        reader.at = len(reader.data)
        self.updates += 1

    def serve(self, listener: socket.socket) -> None:
        """Until the listener is closed: connections, one after the other."""
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            try:
                with connection, connection.makefile("rb") as stream:
                    while head := stream.read(4):
                        (length,) = struct.unpack("<I", head)  # with itself
                        self.take(stream.read(length - 4))
            except (ValueError, OSError, struct.error) as error:
                self.faults.append(str(error))


@contextmanager
def tev_receiver() -> Iterator[TevReceiver]:
    """Listening for the length of the block."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        receiver = TevReceiver(listener.getsockname()[1])
        thread = threading.Thread(target=receiver.serve, args=(listener,), daemon=True)
        thread.start()
        yield receiver
        listener.shutdown(socket.SHUT_RDWR)
    thread.join(10)
