"""How far the render is, on stderr: a bar at a terminal, plain lines elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from footlight.cli.report import duration, note, percent, remarks
from footlight.v1 import render_pb2

# [s] Between plain lines.
LINE_INTERVAL = 2.0

_WORDS = {
    render_pb2.RENDER_STATE_QUEUED: "waiting",
    render_pb2.RENDER_STATE_OPENING: "opening",
    render_pb2.RENDER_STATE_RENDERING: "rendering",
    render_pb2.RENDER_STATE_WRITING: "writing",
}


class ProgressView(Protocol):
    """Is told what happens."""

    def state(self, render: render_pb2.Render) -> None:
        """A new state."""

    def progress(self, progress: render_pb2.Progress) -> None:
        """More samples."""


@contextlib.contextmanager
def progress_view() -> Iterator[ProgressView]:
    """The view that suits stderr."""
    if not sys.stderr.isatty():
        yield Lines()
        return
    from footlight.cli.bar import bar  # noqa: PLC0415 rich takes a while to import

    with bar() as view:
        yield view


@contextlib.contextmanager
def transfer_view(what: str) -> Iterator[Callable[[int, int], None]]:
    """Is told how many bytes of how many are over; shown at a terminal only."""
    if not sys.stderr.isatty():
        yield lambda _done, _total: None
        return
    from footlight.cli.bar import transfer_bar  # noqa: PLC0415 rich takes a while to import

    with transfer_bar(what) as told:
        yield told


class Remarks:
    """Says once what the report holds, as soon as it is there."""

    def __init__(self) -> None:
        self._said = False

    def __call__(self, render: render_pb2.Render) -> list[str]:
        """The lines, the first time."""
        if self._said or not render.HasField("report"):
            return []
        self._said = True
        return remarks(render.report)


class Lines:
    """A line for every state, and one every few seconds in between."""

    def __init__(self) -> None:
        self._remarks = Remarks()
        self._last = time.monotonic()

    def state(self, render: render_pb2.Render) -> None:
        """As ProgressView."""
        for line in self._remarks(render):
            note(line)
        if render.state in _WORDS:
            note(word(render))

    def progress(self, progress: render_pb2.Progress) -> None:
        """As ProgressView."""
        if time.monotonic() - self._last >= LINE_INTERVAL:
            self._last = time.monotonic()
            note(f"rendering {describe(progress)}")


def word(render: render_pb2.Render) -> str:
    """The state in a word."""
    return _WORDS.get(render.state, "")


def describe(progress: render_pb2.Progress) -> str:
    """Samples, error and time that remains, as far as they are known."""
    parts = [f"{progress.samples_done:.0f}/{progress.samples_total:.0f} spp"]
    if progress.HasField("error_mean"):
        parts.append(f"error {percent(progress.error_mean)}")
    if progress.HasField("seconds_remaining"):
        parts.append(f"{duration(progress.seconds_remaining)} left")
    return ", ".join(parts)
