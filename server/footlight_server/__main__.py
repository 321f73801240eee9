"""The server process: `python -m footlight_server --listen 127.0.0.1:PORT`."""

import asyncio
import logging
import os
import sys
import threading
from collections.abc import Sequence

# Before grpc is imported: workers are spawned, never forked, so its fork handlers only cost.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")

from footlight_server import logs
from footlight_server.farm.folder import own_folder
from footlight_server.options import Launch, check_launch, parse_arguments
from footlight_server.scratch import scratch_folder
from footlight_server.serving import serve
from footlight_server.sessions.errors import DatabaseRefusedError, StorageError

# [s] For threads that still wait for a file system when all else has ended.
_LEAVING = 10.0


async def _serve(launch: Launch) -> None:
    try:
        await serve(launch)
    finally:
        # Python would wait for them without end.
        leaving = threading.Timer(_LEAVING, os._exit, (1,))
        leaving.daemon = True
        leaving.start()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the server; leaves the process with status 2 if it cannot start."""
    options = parse_arguments(sys.argv[1:] if arguments is None else arguments)
    usual = logging.WARNING if options.private else logging.INFO
    logs.configure(options.log_format, logging.DEBUG if options.verbose else usual)
    umask = os.umask(0o077)
    try:
        with scratch_folder(options.scratch) as scratch:
            launch = check_launch(options, scratch, umask)
            if not launch.settings.private:
                own_folder(launch.settings.data)
            asyncio.run(_serve(launch))
    except (DatabaseRefusedError, StorageError, ValueError, OSError, RuntimeError) as error:
        print(f"footlight-server: {_said(error)}", file=sys.stderr)  # noqa: T201 - for whoever started us
        sys.exit(2)


def _said(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__


if __name__ == "__main__":
    main()
