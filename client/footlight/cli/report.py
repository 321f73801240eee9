"""What is said to people, on stderr: notes, the summary, errors, and the exit code that goes with them."""

import contextlib
import sys
from collections.abc import Iterator, Sequence

import typer

from footlight.cli.exits import Exit, exit_code
from footlight.errors import FootlightError, RenderFailedError
from footlight.v1 import render_pb2, report_pb2

# [lines] Of each kind of remark; `footlight explain` has them all.
FIRST = 5


def note(text: str) -> None:
    """A plain line on stderr."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


@contextlib.contextmanager
def usage() -> Iterator[None]:
    """A ValueError inside is an option that is not allowed."""
    try:
        yield
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


@contextlib.contextmanager
def reporting() -> Iterator[None]:
    """Turn an exception of Footlight or the file system into a message and its exit code."""
    try:
        yield
    except KeyboardInterrupt:
        note("cancelled")
        raise typer.Exit(Exit.CANCELLED) from None
    except FootlightError as error:
        note(f"error: {_text(error)}")
        raise typer.Exit(exit_code(error)) from None
    except OSError as error:
        note(f"error: {error.filename or 'stdout'}: cannot be written: {error.strerror}")
        raise typer.Exit(exit_code(error)) from None


def _text(error: FootlightError) -> str:
    text = str(error)
    if isinstance(error, RenderFailedError) and error.prim_path and error.prim_path not in text:
        return f"{error.prim_path}: {text}"
    return text


def remarks(report: report_pb2.StageReport) -> list[str]:
    """What a user should know about the image: assumptions, what is left out, what looks wrong."""
    return [
        *(f"assumed: {item.what}: {item.reason}" for item in report.assumed),
        *_first([f"left out: {item.prim_path}: {item.what}: {item.reason}" for item in report.left_out]),
        *_first([f"remark: {item.prim_path or 'stage'}: {item.message}" for item in report.remarks]),
    ]


def _first(lines: Sequence[str]) -> list[str]:
    more = len(lines) - FIRST
    return [*lines[:FIRST], *([f"… and {more} more; `footlight explain` lists them"] if more > 0 else [])]


def summary(output: str, render: render_pb2.Render) -> str:
    """What was written, how wrong it still is, and what half of that would cost."""
    stats = render.stats
    partial = "partial image, " if render.state == render_pb2.RENDER_STATE_CANCELLED else ""
    text = f"{output}: {partial}{render.spec.width}x{render.spec.height}, {stats.spp} spp, {stats.seconds.total:.1f} s"
    if stats.HasField("error_mean"):
        # Monte Carlo: half the error takes four times the samples, three times as many again.
        text += f"; error {percent(stats.error_mean)}, half of that for {3 * stats.seconds.render:.1f} s more"
    fired = sum(stats.guards.values())
    return text + (f"; {fired} samples met a guard, see --stats" if fired else "")


def percent(ratio: float) -> str:
    """Two digits that count: 12 %, 1.2 %, 0.12 %."""
    return f"{100 * ratio:.2g} %" if ratio < 0.995 else f"{100 * ratio:.0f} %"
