"""The server process: `python -m footlight_server --listen 127.0.0.1:PORT`."""

import argparse
import asyncio
import logging
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

# Before grpc is imported: workers are spawned, never forked, so its fork handlers only cost.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")

from footlight_server.api.address import AddressError, check_address
from footlight_server.api.server import GrpcServer
from footlight_server.sessions.machine import Patience
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings
from footlight_server.workers.limits import physical_memory

log = logging.getLogger("footlight_server")

DEFAULT_ADDRESS = "127.0.0.1:50051"
# [1] Of the machine's memory, for one worker.
_MEMORY_SHARE = 0.8
# [s] For open calls when the server stops; for everything.
_GRACE = 2.0
_LONGEST_STOP = 10.0


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """The command line. Exits with a message if it is wrong."""
    parser = argparse.ArgumentParser(prog="footlight-server", description="Renders USD stages as a service.")
    parser.add_argument("--listen", default=DEFAULT_ADDRESS, metavar="ADDR", help="HOST:PORT on loopback, or unix:PATH")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="renders at the same time")
    parser.add_argument(
        "--root", action="append", default=[], type=Path, metavar="DIR", help="stages have to lie below one of these"
    )
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="where results are kept while the server runs")
    parser.add_argument("--worker-memory", type=float, metavar="GB", help="that one worker may hold; 0: no limit")
    parser.add_argument("--open-seconds", type=float, default=300.0, metavar="S", help="limit for opening a stage")
    parser.add_argument("--private", action="store_true", help="stop when standard input is closed")
    parser.add_argument("--verbose", action="store_true", help="log more")
    return parser.parse_args(arguments)


def check_settings(options: argparse.Namespace, scratch: Path) -> Settings:
    """The settings. Raises ValueError naming the option, its value and what is allowed."""
    if not 1 <= options.workers <= 256:
        raise ValueError(f"--workers {options.workers}: allowed are 1 to 256")
    if not 0 < options.open_seconds <= 86400:
        raise ValueError(f"--open-seconds {options.open_seconds:g}: allowed is over 0 to 86400")
    memory = physical_memory() * _MEMORY_SHARE if options.worker_memory is None else options.worker_memory * 2**30
    if not 0 <= memory < 2**60:
        raise ValueError(f"--worker-memory {options.worker_memory:g}: allowed is 0 and up")
    for root in options.root:
        if not root.is_dir():
            raise ValueError(f"--root {root}: not a directory")
    return Settings(
        workers=options.workers,
        roots=tuple(root.resolve() for root in options.root),
        scratch=scratch,
        worker_memory=int(memory),
        patience=Patience(opening=options.open_seconds),
        private=options.private,
    )


async def serve(address: str, settings: Settings) -> None:
    """Serve until SIGTERM, SIGINT or, for a private server, the end of stdin; then stop in bounded time."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    if settings.private:
        _stop_at_end_of_input(loop, stop)
    sessions = Sessions(settings)
    server = GrpcServer(sessions, settings)
    try:
        sessions.warm_up()
        bound = await server.start(address)
        print(f"listening on {bound}", flush=True)  # noqa: T201 - the line that whoever started us reads
        await stop.wait()
    finally:
        log.info("stopping")
        async with asyncio.timeout(_LONGEST_STOP):
            await server.drain()
            await sessions.close()
            await server.stop(_GRACE)


def _stop_at_end_of_input(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> None:
    descriptor = sys.stdin.fileno()

    def read() -> None:
        if not os.read(descriptor, 4096):
            loop.remove_reader(descriptor)
            stop.set()

    loop.add_reader(descriptor, read)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the server; leaves the process with status 2 if it cannot start."""
    options = parse_arguments(sys.argv[1:] if arguments is None else arguments)
    logging.basicConfig(
        level=logging.DEBUG if options.verbose else logging.INFO if not options.private else logging.WARNING,
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
    )
    os.umask(0o077)
    scratch: Path | None = None
    try:
        address = check_address(options.listen)
        scratch = Path(tempfile.mkdtemp(prefix="footlight-", dir=options.scratch))
        asyncio.run(serve(address, check_settings(options, scratch)))
    except (AddressError, ValueError, OSError, RuntimeError) as error:
        print(f"footlight-server: {error}", file=sys.stderr)  # noqa: T201 - for whoever started us
        sys.exit(2)
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)


if __name__ == "__main__":
    main()
