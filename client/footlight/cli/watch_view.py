"""How watching looks: a table at a terminal, plain lines elsewhere, or JSON."""

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Protocol

from footlight.cli.board import Board
from footlight.cli.report import note
from footlight.cli.tables import write_json_line
from footlight.plain import plain
from footlight.v1 import job_pb2

# [s] Between plain lines about numbers.
LINE_INTERVAL = 2.0


class WatchView(Protocol):
    """Is told what happens."""

    def event(self, event: job_pb2.JobEvent) -> None:
        """Something happened to the job."""

    def say(self, line: str) -> None:
        """Something happened to the watching."""


@contextlib.contextmanager
def watch_view(board: Board, *, as_json: bool) -> Iterator[WatchView]:
    """The view that suits stderr, or with `as_json` a line on stdout for each event."""
    if as_json:
        yield Json(board)
        return
    if sys.stderr.isatty():
        from footlight.cli.watch_table import live_table  # noqa: PLC0415 rich takes a while to import

        with live_table(board) as view:
            yield view
    else:
        yield Lines(board)
    if board.summary():
        note(board.summary())


class Json:
    """The events as they are."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def event(self, event: job_pb2.JobEvent) -> None:
        """As WatchView."""
        self._board.take(event)
        write_json_line(plain(event))

    def say(self, line: str) -> None:
        """As WatchView."""
        note(line)


class Lines:
    """What is worth a line, and the numbers every few seconds if they have changed."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._said = ""
        self._last = -LINE_INTERVAL

    def event(self, event: job_pb2.JobEvent) -> None:
        """As WatchView."""
        for line in self._board.take(event):
            note(line)
        numbers = "" if self._board.summary() else self._board.numbers()
        if numbers and numbers != self._said and time.monotonic() - self._last >= LINE_INTERVAL:
            self._said, self._last = numbers, time.monotonic()
            note(numbers)

    def say(self, line: str) -> None:
        """As WatchView."""
        note(line)
