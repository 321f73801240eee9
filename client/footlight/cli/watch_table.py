"""Watching at a terminal: a bar for the job and a table of what runs, by rich."""

import contextlib
from collections.abc import Iterator

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from footlight.cli.board import Board
from footlight.cli.report import visible
from footlight.cli.tables import STYLES
from footlight.cli.words import frames_of, job_word, progress_of
from footlight.names import short
from footlight.v1 import job_pb2

# [tasks] That are shown of those that run.
ROWS = 16
# [columns] At most.
TITLE = 24
BAR = 30
# [1/s]
REFRESH = 4


class LiveTable:
    """Implements WatchView."""

    def __init__(self, board: Board, live: Live) -> None:
        self._board = board
        self._live = live

    def event(self, event: job_pb2.JobEvent) -> None:
        """As WatchView."""
        for line in self._board.take(event):
            self.say(line)
        self._live.update(screen(self._board))

    def say(self, line: str) -> None:
        """As WatchView."""
        self._live.console.print(visible(line), markup=False, highlight=False)


@contextlib.contextmanager
def live_table(board: Board) -> Iterator[LiveTable]:
    """On stderr, and gone when the block ends."""
    with Live(console=Console(stderr=True), refresh_per_second=REFRESH, transient=True) as live:
        yield LiveTable(board, live)


def screen(board: Board) -> Group:
    """All of it."""
    job = board.job
    if job is None:
        return Group()
    head = Table.grid(padding=(0, 1))
    # Where there is little room the bar gives way first, and the title next.
    head.add_column(no_wrap=True, overflow="ellipsis", max_width=TITLE)
    head.add_column(no_wrap=True, min_width=len(job_word(job)))
    head.add_column(min_width=4, max_width=BAR)
    head.add_column(no_wrap=True)
    head.add_row(
        Text(visible(f"{short(job.name)} {job.spec.title}"), style="bold"),
        Text(job_word(job), style=STYLES.get(job_word(job), "")),
        ProgressBar(total=max(job.frames_total, 1), completed=job.frames_done),
        Text(board.numbers()),
    )
    rows = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("TASK", "LAYER", "FRAMES", "WORKER", "PROGRESS"):
        rows.add_column(column, no_wrap=True)
    running = sorted(board.running.values(), key=lambda task: (len(task.name), task.name))
    for task in running[:ROWS]:
        rows.add_row(
            short(task.name),
            task.layer,
            frames_of(task),
            task.last_attempt.worker,
            progress_of(task),
        )
    parts: list[RenderableType] = [head, *([rows] if running else [])]
    if len(running) > ROWS:
        parts.append(Text(f"… and {len(running) - ROWS} more", style="dim"))
    if board.last_path:
        parts.append(Text(f"newest image: {board.last_path}", style="dim", overflow="ellipsis", no_wrap=True))
    return Group(*parts)
