"""The server of a command: the one that was named, or a private one; and its files as this machine sees them."""

import contextlib
import os
from collections.abc import Iterator

from footlight.cli.options import Connection, MappedConnection
from footlight.client import AsyncClient, Client
from footlight.paths import PathMap
from footlight.private import private_server


@contextlib.contextmanager
def connect(connection: Connection) -> Iterator[Client]:
    """A client of the server, or if none is named of one started for the length of the block."""
    with contextlib.ExitStack() as stack:
        address = connection.server or stack.enter_context(private_server())
        client = Client(
            address, token=connection.token, ca=connection.ca, certificate=connection.cert, key=connection.key
        )
        yield stack.enter_context(client)


def connect_async(connection: Connection) -> AsyncClient:
    """A client for the running loop, of the server that is named."""
    return AsyncClient(
        connection.server, token=connection.token, ca=connection.ca, certificate=connection.cert, key=connection.key
    )


def path_map(connection: MappedConnection) -> PathMap:
    """Of the options, and after them of $FOOTLIGHT_PATH_MAP. A private server sees what we see. Raises ValueError."""
    if not connection.server:
        return PathMap()
    more = os.environ.get("FOOTLIGHT_PATH_MAP", "").split(";")
    return PathMap.of([*(connection.path_map or ()), *filter(None, more)])
