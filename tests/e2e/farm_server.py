"""A server with a farm queue as a real process, which can be killed and started again; and a line that can be cut."""

import contextlib
import os
import re
import select
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.e2e.conftest import FOOTLIGHT


class FarmServer:
    """`footlight serve --data` below `directory`, on a Unix socket there, and with `tcp` on loopback besides."""

    def __init__(
        self, directory: Path, *arguments: object, tcp: bool = False, program: Sequence[object] = (FOOTLIGHT, "serve")
    ) -> None:
        self.address = f"unix:{directory}/socket"
        self.tcp = ""  # known when it listens
        self.data = directory / "data"
        self._log = directory / "log"
        self._command = [*map(str, program), "--listen", self.address, "--data", str(self.data)]
        self._command += [*(["--listen", "127.0.0.1:0"] if tcp else []), *map(str, arguments)]
        self._lines = 2 if tcp else 1
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Until it listens."""
        with self._log.open("a") as log:
            self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, stderr=log)
        assert self._process.stdout is not None
        said = b""
        while said.count(b"\n") < self._lines:
            assert select.select([self._process.stdout], [], [], 60)[0], self.said()
            more = os.read(self._process.stdout.fileno(), 4096)
            assert more, self.said()
            said += more
        addresses = re.findall(r"listening on (\S+)\n", said.decode())
        self.tcp = addresses[-1]

    @property
    def pid(self) -> int:
        """Of the process, while it runs."""
        assert self._process is not None
        return self._process.pid

    def kill(self) -> None:
        """Kill -9."""
        self._end(signal.SIGKILL)

    def stop(self) -> int:
        """As `systemctl stop` does. The exit code."""
        return self._end(signal.SIGTERM)

    def _end(self, number: signal.Signals) -> int:
        assert self._process is not None
        process, self._process = self._process, None
        process.send_signal(number)
        try:
            return process.wait(60)
        finally:
            process.kill()
            process.communicate()

    @property
    def running(self) -> bool:
        """It was started and not ended by us."""
        return self._process is not None

    def said(self) -> str:
        """Its log."""
        return self._log.read_text()

    def close(self) -> None:
        """Stop it if it runs."""
        if self._process is not None:
            self._end(signal.SIGTERM)


@contextlib.contextmanager
def farm_server(
    directory: Path, *arguments: object, tcp: bool = False, program: Sequence[object] = (FOOTLIGHT, "serve")
) -> Iterator[FarmServer]:
    """A server that listens, for the length of the block."""
    server = FarmServer(directory, *arguments, tcp=tcp, program=program)
    server.start()
    try:
        yield server
    finally:
        server.close()


class Wire:
    """Passes TCP connections on to `address`, until it is cut."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._target = host, int(port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._open: list[socket.socket] = []
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self.connections = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Every connection breaks; new ones are passed on as before."""
        while self._open:
            _shut(self._open.pop())

    def close(self) -> None:
        """No more connections."""
        _shut(self._listener)
        self.cut()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            far = socket.create_connection(self._target)
            self._open += [near, far]
            for source, target in ((near, far), (far, near)):
                threading.Thread(target=_copy, args=(source, target), daemon=True).start()


def _copy(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(1 << 16):
            target.sendall(data)
    for end in (source, target):
        _shut(end)


def _shut(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)
    end.close()
