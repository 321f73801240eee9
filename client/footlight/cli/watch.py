"""`footlight watch`: follow a job to its end."""

import asyncio
import signal

import typer

from footlight.cli import parse
from footlight.cli.board import Board
from footlight.cli.connect import connect_async, path_map
from footlight.cli.exits import Exit
from footlight.cli.options import MappedConnection
from footlight.cli.report import note, usage
from footlight.cli.watch_view import WatchView, watch_view
from footlight.errors import FootlightError, JobCancelledError, JobFailedError, ServerUnavailableError
from footlight.job_calls import ended, outcome
from footlight.jobs import PATIENCE, AsyncJob
from footlight.live import LiveFrames
from footlight.names import job_name, short
from footlight.resume import Patience
from footlight.tev import TevViewer
from footlight.v1 import job_pb2


def run_watch(connection: MappedConnection, name: str, *, tev: str, after: int, as_json: bool) -> None:
    """Show what happens until the job has ended. Raises typer.Exit with the job's own code."""
    with usage():
        name, paths = job_name(name), path_map(connection)
    viewer = TevViewer(*parse.host_and_port(tev, "--tev")) if tev else None
    # As Ctrl-C, so that the terminal is left in order.
    before = signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        job = asyncio.run(_watch(connection, name, Board(paths), viewer, after, as_json=as_json))
    except KeyboardInterrupt:
        note(f"not watching any more; the job goes on, and `footlight watch {short(name)}` comes back to it")
        raise typer.Exit(Exit.CANCELLED) from None
    finally:
        signal.signal(signal.SIGTERM, before)
    try:
        outcome(job)
    except JobFailedError:
        note(f"`footlight job {short(name)}` shows what failed, `footlight retry {short(name)}` tries it again")
        raise typer.Exit(Exit.FAILED) from None
    except JobCancelledError:
        raise typer.Exit(Exit.CANCELLED) from None


async def _watch(
    connection: MappedConnection, name: str, board: Board, viewer: TevViewer | None, after: int, *, as_json: bool
) -> job_pb2.Job:
    async with connect_async(connection) as client:
        job = client.farm.job(name)
        with watch_view(board, as_json=as_json) as view:
            if viewer is None:
                return await _follow(job, board, view, None, after, from_start=as_json)
            async with LiveFrames(client, viewer, view.say) as live:
                return await _follow(job, board, view, live, after, from_start=as_json)


async def _follow(
    job: AsyncJob, board: Board, view: WatchView, live: LiveFrames | None, after: int, *, from_start: bool
) -> job_pb2.Job:
    """Tell the view what happens, and return the job when it has ended."""

    def broken(error: FootlightError) -> None:
        view.say(f"{error}; trying again for {PATIENCE / 60:.0f} minutes")

    first = True
    events = job.events(after=after, only_new=not from_start, patience=Patience(PATIENCE, broken))
    async for event in events:
        view.event(event)
        if live is not None:
            live.event(event)
        if first and not from_start:
            # What runs already has had its event; what changes from here on will have one.
            for running in await _running(job):
                view.event(running)
                if live is not None:
                    live.event(running)
        first = False
    return ended(job.name, board.job)


async def _running(job: AsyncJob) -> list[job_pb2.JobEvent]:
    """The tasks that run now, as events; none if the server has just gone, which the stream of events will notice."""
    try:
        return [job_pb2.JobEvent(task=task) async for task in job.tasks(states=["running"])]
    except ServerUnavailableError:
        return []
