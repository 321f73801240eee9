"""Tables on stdout: aligned columns, folded at a terminal only; and JSON, for those who count on it."""

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


def write_table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Iterable[str] = ()) -> None:
    """Columns under headings in capitals. Those in `right` are numbers; states have colours. Without rows nothing."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column, justify="right" if column in right else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(visible(cell), style=STYLES.get(cell, "")) for cell in row))
    if table.row_count:
        console().print(table, soft_wrap=not sys.stdout.isatty())
