"""The life of a server process: start, serve until it is told to stop, drain, stop in bounded time."""

import asyncio
import logging
import resource
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from functools import partial
from typing import TYPE_CHECKING

from footlight_server.api.address import is_local, split_address
from footlight_server.api.auth import LocalGate
from footlight_server.api.metrics import MeterGate
from footlight_server.api.server import GrpcServer, Health
from footlight_server.api.tls import server_credentials
from footlight_server.assembly import Parts, private_parts
from footlight_server.closing import closing
from footlight_server.options import Launch
from footlight_server.settings import Settings
from footlight_server.signals import Stop, unless

if TYPE_CHECKING:
    from footlight_server.metrics import Metrics

log = logging.getLogger(__name__)

# [s] For open calls when the server stops.
_GRACE = 2.0
# [s] For each part to end; the farm waits for its workers, and writes down what became of their tasks.
_ENDING = 8.0
_FARM_ENDING = 20.0
# [files] Sockets among them; enough for all who connect, few enough to be looked through.
_OPEN_FILES = 65536
# [threads] For files.
_FILE_THREADS = 64


async def serve(launch: Launch) -> None:
    """Serve until SIGTERM, SIGINT or, for a private server, the end of stdin.

    Then, in this order: health says NOT_SERVING and renders are refused; no task is given out any more, and those that
    run may go on for `drain` seconds, unless a second signal hurries; what still runs is stopped, to be taken up by the
    next server; renders end, those who watch jobs are told, calls end, the database is closed.
    """
    settings = launch.settings
    _raise_open_files()
    # Calls to file systems that hang keep their threads; the usual handful would soon be gone.
    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(_FILE_THREADS, "files"))
    stop = Stop(private=settings.private)
    async with AsyncExitStack() as stack:
        metrics = _start_metrics(launch.metrics, stack)
        parts = await _assemble(settings, stack, metrics)
        health = Health(parts.services)
        servers: list[GrpcServer] = []
        stack.push_async_callback(closing, "calls", lambda: _stop_all(servers), _ENDING)
        if parts.jobs is not None:
            stack.push_async_callback(closing, "those who watch jobs", parts.jobs.close, _ENDING)
        stack.push_async_callback(closing, "renders", parts.sessions.close, _ENDING)
        if parts.farm is not None:
            stack.push_async_callback(closing, "the farm", parts.farm.close, _FARM_ENDING)
            if not await unless(stop.asked, parts.farm.start()):  # joining a cluster takes its time
                return
        parts.sessions.warm_up()
        for address in launch.addresses:
            servers.append(_server(address, parts, health, metrics))
            print(f"listening on {await _listen(servers[-1], address, launch)}", flush=True)  # noqa: T201
        await health.serving()
        await stop.asked.wait()
        log.info("stopping")
        await health.draining()
        parts.sessions.drain()
        if parts.farm is not None:
            if running := len(parts.farm.running()):
                log.info("tasks that run: %d; they have %g s, or until a second signal", running, settings.drain)
            draining = partial(parts.farm.drain, settings.drain)
            await unless(stop.hurried, closing("what runs", draining, settings.drain + _FARM_ENDING))


def _raise_open_files() -> None:
    """Programs begin with 1024, which a few hundred clients that forget they are connected would use up."""
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _OPEN_FILES if most == resource.RLIM_INFINITY else min(_OPEN_FILES, most)
    if resource.RLIM_INFINITY != now < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


async def _assemble(settings: Settings, stack: AsyncExitStack, metrics: "Metrics | None") -> Parts:
    if settings.private:
        return private_parts(settings)
    from footlight_server.farm_assembly import farm_parts  # noqa: PLC0415 a private server starts without SQLAlchemy

    return await farm_parts(settings, stack, metrics)


def _start_metrics(address: str, stack: AsyncExitStack) -> "Metrics | None":
    """Answer Prometheus at that address, if there is one."""
    if not address:
        return None
    from footlight_server.metrics import Metrics  # noqa: PLC0415 not everybody is watched

    metrics = Metrics()
    host, port = split_address(address)
    try:
        exposition = metrics.serve(host, port)
    except OSError as error:
        raise OSError(f"--metrics {address}: {error.strerror}") from error
    stack.callback(exposition.server_close)
    stack.push_async_callback(asyncio.to_thread, exposition.shutdown)
    log.info("metrics at http://%s:%d/metrics", address.rpartition(":")[0], exposition.server_port)
    return metrics


def _server(address: str, parts: Parts, health: Health, metrics: "Metrics | None") -> GrpcServer:
    gate = LocalGate() if is_local(address) else parts.gate
    assert gate is not None  # a private server has no such address
    return GrpcServer(parts.services, health, (MeterGate(metrics), gate))


async def _listen(server: GrpcServer, address: str, launch: Launch) -> str:
    if is_local(address):
        return await server.start(address)
    assert launch.tls is not None
    if not launch.settings.roots:
        log.warning("--listen %s without --root: whoever has a token of scope submit can open any file", address)
    if not launch.settings.output_roots:
        log.warning(
            "--listen %s without --output-root: whoever has a token of scope submit can write anywhere", address
        )
    return await server.start(address, await asyncio.to_thread(server_credentials, launch.tls))


async def _stop_all(servers: Sequence[GrpcServer]) -> None:
    await asyncio.gather(*(server.stop(_GRACE) for server in servers))
