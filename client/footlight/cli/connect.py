"""The server of a command: the one that was named, or a private one."""

import contextlib
from collections.abc import Iterator

from footlight.client import Client
from footlight.private import private_server


@contextlib.contextmanager
def connect(server: str) -> Iterator[Client]:
    """A client of `server`, or if that is empty of a server started for the length of the block."""
    with contextlib.ExitStack() as stack:
        address = server or stack.enter_context(private_server())
        yield stack.enter_context(Client(address))
