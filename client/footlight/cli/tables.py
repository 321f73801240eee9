"""Tables on stdout: aligned columns, narrower at a terminal only; and JSON, for those who count on it."""

import json
import sys
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from footlight.cli.report import visible
from footlight.plain import Plain

# [columns] Where stdout is no terminal.
PLAIN_WIDTH = 1000

# [columns] That are left of one that gives way.
LEAST = 10

STYLES = {
    "running": "cyan",
    "succeeded": "green",
    "failed": "bold red",
    "cancelled": "magenta",
    "cancelling": "magenta",
    "paused": "yellow",
    "blocked": "dim",
    "skipped": "dim",
}


def write_json(value: Plain | Sequence[Plain]) -> None:
    """One document on stdout."""
    sys.stdout.write(json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def write_json_line(value: Plain) -> None:
    """One line on stdout, at once."""
    sys.stdout.write(json.dumps(value, ensure_ascii=False) + "\n")
    sys.stdout.flush()


def console() -> Console:
    """Stdout, where markup means nothing."""
    return Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def write_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: Iterable[str] = (),
    cut: Iterable[str] = (),
    fold: Iterable[str] = (),
) -> None:
    """Columns under headings in capitals. Those in `right` are numbers; states have colours. Without rows nothing.

    Where a terminal has too little room, columns in `cut` lose their ends and those in `fold` take several lines; a
    terminal is not shown columns that hold nothing.
    """
    table = Table(box=None, pad_edge=False, header_style="bold")
    rows = list(rows)
    if sys.stdout.isatty():
        columns, rows = _filled(columns, rows)
    give = {*cut, *fold}
    for column, cells in zip(columns, zip(*rows, strict=True), strict=True) if rows else ():
        longest = max(map(len, (column, *cells)))
        table.add_column(
            column,
            justify="right" if column in right else "left",
            overflow="fold" if column in fold else "ellipsis",
            no_wrap=column not in give,
            min_width=min(LEAST, longest) if column in give else None,
        )
    for row in rows:
        table.add_row(*(_cell(cell, cut=column in cut) for column, cell in zip(columns, row, strict=True)))
    if table.row_count:
        console().print(table, soft_wrap=not sys.stdout.isatty())


def _filled(columns: Sequence[str], rows: list[Sequence[str]]) -> tuple[Sequence[str], list[Sequence[str]]]:
    """Without the columns that hold nothing."""
    kept = [index for index in range(len(columns)) if any(row[index] for row in rows)]
    return [columns[index] for index in kept], [[row[index] for index in kept] for row in rows]


def _cell(text: str, *, cut: bool) -> Text:
    style = STYLES.get(text, "")
    return Text(visible(text), style, no_wrap=True, overflow="ellipsis") if cut else Text(visible(text), style)
