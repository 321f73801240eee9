"""`footlight render`: submit, follow, fetch, and cancel on Ctrl-C."""

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from footlight.cli.connect import connect, path_map
from footlight.cli.exits import Exit
from footlight.cli.interrupt import cancelling
from footlight.cli.options import OwnConnection
from footlight.cli.progress import progress_view
from footlight.cli.report import note, summary, usage
from footlight.cli.stage import place
from footlight.errors import RenderCancelledError
from footlight.files import replacing
from footlight.plain import plain
from footlight.session import Session, outcome
from footlight.spec import render_spec
from footlight.v1 import render_pb2

STDOUT = Path("-")


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where the results go. `exr` may be `-` for stdout."""

    exr: Path
    png: Path | None
    stats: Path | None

    def check(self) -> None:
        """Find before the render what would fail after it. Raises typer.BadParameter, OSError naming the file."""
        for option, path, suffix in (
            ("--output", self.exr, ".exr"),
            ("--png", self.png, ".png"),
            ("--stats", self.stats, ".json"),
        ):
            if path is None or path == STDOUT:
                continue
            if path.suffix.lower() != suffix:
                raise typer.BadParameter(f"{str(path)!r} has to end in {suffix}", param_hint=option)
            if path.is_dir():
                raise IsADirectoryError(21, "it is a directory", str(path))
            if not path.parent.is_dir():
                raise FileNotFoundError(2, f"{path.parent} is not a directory", str(path))
            if not os.access(path.parent, os.W_OK):
                raise PermissionError(13, f"{path.parent} is not writable", str(path))
        if self.exr == STDOUT and sys.stdout.isatty():
            raise typer.BadParameter("an EXR is not for the terminal; redirect stdout", param_hint="--output")

    def fetch(self, session: Session, render: render_pb2.Render) -> None:
        """Write all of it. Raises OSError naming the file, FootlightError."""
        if self.exr == STDOUT:
            for piece in session.pieces():
                sys.stdout.buffer.write(piece)
            sys.stdout.buffer.flush()
        else:
            session.save(self.exr)
        if self.png is not None:
            session.save(self.png, "png")
        if self.stats is not None:
            with replacing(self.stats) as temporary:
                temporary.write_text(json.dumps(plain(render.stats), indent=2) + "\n")


def run_render(
    outputs: Outputs, connection: OwnConnection, options: dict[str, Any], *, upload: bool, keep_partial: bool
) -> None:
    """Render and write `outputs`; `options` are those of render_spec."""
    if upload and not connection.server:
        raise typer.BadParameter("a private server keeps no uploads; name one with --server", param_hint="--upload")
    with usage():
        spec, paths = render_spec(**options), path_map(connection)
    outputs.check()
    with connect(connection) as client:
        place(client, spec, options["stage"], paths, upload=upload)
        session = client.submit(spec)
        with cancelling(session, keep_partial=keep_partial):
            render = _follow(session)
        try:
            outcome(render)
        except RenderCancelledError:
            if not render.has_result:
                note("cancelled; nothing is written")
                raise typer.Exit(Exit.CANCELLED) from None
        outputs.fetch(session, render)
    note(summary(str(outputs.exr), render))
    if render.state == render_pb2.RENDER_STATE_CANCELLED:
        raise typer.Exit(Exit.CANCELLED)


def _follow(session: Session) -> render_pb2.Render:
    """Show progress until the render ends, and return it."""
    last = render_pb2.Render()
    with progress_view() as view:
        for event in session.events(()):
            if isinstance(event, render_pb2.Render):
                view.state(event)
                last = event
            elif isinstance(event, render_pb2.Progress):
                view.progress(event)
    return last
