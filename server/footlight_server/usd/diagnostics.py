"""What USD says, without what nobody may know: the source text that it quotes, and what is outside the roots."""

import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pxr import UsdUtils

from footlight_server.usd.roots import OUTSIDE, file_of, is_below

# Parse errors quote the line they fell over; it may come from a file the caller is not allowed to read.
_QUOTED_SOURCE = re.compile(r"\s*(?:\(at sub-part[^)]*\)\s*)?\bat '.*?'(?= in <|\s*$)", re.DOTALL | re.MULTILINE)
# As USD tells of a layer that it could not open; the reason follows.
_UNOPENED = re.compile(
    r"Could not (?:open asset|load sublayer) @(?P<path>[^@]*)@ (?:for \w+ introduced by|of layer) @[^@]*@(?:<[^>]*>)?"
)
# [lines] That are passed on, and [characters] of each.
_MOST_LINES = 100
_LONGEST_LINE = 500


def plain(message: str, roots: Sequence[Path]) -> str:
    """A USD message in one line, without the source text that it quotes.

    Of a file outside the roots it does not say whether it is there, nor what it is.
    """
    unopened = _UNOPENED.search(message)
    if unopened is not None and not is_below(file_of(unopened["path"]), roots):
        message = f"{message[: unopened.end()]}: it is missing, or {OUTSIDE}"
    return " ".join(_QUOTED_SOURCE.sub("", message).split())


@contextmanager
def plain_diagnostics(roots: Sequence[Path]) -> Iterator[None]:
    """Within, USD's warnings are collected; when it ends they go to standard error, one line each."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    finally:
        items = delegate.TakeUncoalescedDiagnostics()
        for item in items[:_MOST_LINES]:
            print(f"USD: {plain(item.commentary, roots)[:_LONGEST_LINE]}", file=sys.stderr)  # noqa: T201 - for the log
        if len(items) > _MOST_LINES:
            print(f"USD: and {len(items) - _MOST_LINES} lines more", file=sys.stderr)  # noqa: T201
