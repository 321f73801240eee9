"""The progress bar at a terminal, by rich."""

import contextlib
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TransferSpeedColumn,
)

from footlight.cli.progress import Remarks, describe, word
from footlight.v1 import render_pb2


class Bar:
    """Implements ProgressView."""

    def __init__(self, display: Progress, task: TaskID) -> None:
        self._display = display
        self._task = task
        self._remarks = Remarks()

    def state(self, render: render_pb2.Render) -> None:
        """As ProgressView."""
        for line in self._remarks(render):
            self._display.console.print(line, markup=False, highlight=False)
        self._display.update(self._task, description=word(render))

    def progress(self, progress: render_pb2.Progress) -> None:
        """As ProgressView."""
        self._display.update(
            self._task,
            completed=progress.samples_done,
            total=progress.samples_total,
            detail=describe(progress),
        )


@contextlib.contextmanager
def bar() -> Iterator[Bar]:
    """A bar on stderr that goes when the block ends."""
    columns = (
        TextColumn("{task.description:9}"),
        BarColumn(),
        TextColumn("{task.fields[detail]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as display:
        yield Bar(display, display.add_task("", total=None, detail=""))


@contextlib.contextmanager
def transfer_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar for bytes on stderr that goes when the block ends."""
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as display:
        task = display.add_task(what, total=None)
        yield lambda done, total: display.update(task, completed=done, total=total)
