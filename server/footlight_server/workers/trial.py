"""Tries a sandbox from inside: `python -m footlight_server.workers.trial NAME INSIDE OUTSIDE` says if it holds."""

import os
import socket
import sys
from pathlib import Path

from footlight.worker.v1 import worker_pb2
from footlight_server.workers.confine import ConfinementError, confine


def main() -> None:
    """Shut this process in as a worker is, then reach for a folder, a socket and a process that it must not have."""
    name, inside, outside = sys.argv[1:]
    try:
        confine(worker_pb2.Confinement(write_paths=[inside], outside=name == "bubblewrap"))
    except ConfinementError as error:
        sys.exit(str(error))
    Path(inside, "written").write_text("by a confined process", encoding="ascii")
    for what, reach in (
        ("files", lambda: list(Path(outside).iterdir())),
        ("sockets", lambda: socket.socket().close()),
        ("processes", os.fork),
    ):
        try:
            reach()
        except OSError:
            continue
        sys.exit(f"it does not keep from {what}")
    print("confined")  # noqa: T201 - the answer


if __name__ == "__main__":
    main()
