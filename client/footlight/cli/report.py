"""What is said to people, on stderr: notes, the summary, errors, and the exit code that goes with them."""

import contextlib
import re
import sys
from collections.abc import Iterator, Sequence

import typer

from footlight.cli.exits import Exit, exit_code
from footlight.errors import FootlightError, InvalidRequestError, RenderFailedError, TokenRequiredError
from footlight.v1 import render_pb2, report_pb2

# Where the command line's word is not that of the message.
OPTIONS = {
    "stage_path": "STAGE",
    "camera_path": "--camera",
    "time_code": "--frame",
    "width": "--size",
    "height": "--size",
    "aovs": "--aov",
    "png.view": "--view",
    "title": "--name",
    "name": "--layer",
    "tags": "--tag",
    "environment": "--env",
    "timeout_seconds": "--timeout",
    "stall_timeout_seconds": "--stall-timeout",
    "limits": "--limit",
}
# The part of a field's path that says in which message of a submission it is.
_PREFIX = re.compile(r"^spec\.(layers\[\d+\]\.)?(render\.)?")
# Fields of other requests, and values that are parsed here.
_OTHERS = {"job": "JOB", "task": "TASK", "token": "TOKEN", "user": "USER"}

# [lines] Of each kind of remark; `footlight explain` has them all.
FIRST = 5


def note(text: str) -> None:
    """A plain line on stderr."""
    sys.stderr.write(f"{visible(text)}\n")
    sys.stderr.flush()


def visible(text: str) -> str:
    """`text` without what a terminal would obey: titles and messages are other people's words."""
    return "".join(char if char.isprintable() or char in "\n\t" else "\N{REPLACEMENT CHARACTER}" for char in text)


@contextlib.contextmanager
def usage() -> Iterator[None]:
    """A ValueError inside is an option that is not allowed."""
    try:
        yield
    except ValueError as error:
        field, _, why = str(error).partition(": ")
        raise typer.BadParameter(why, param_hint=option_of(field)) from error


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
    if isinstance(error, InvalidRequestError) and error.fields:
        return "; ".join(f"{option_of(field)}: {why}" for field, why in error.fields)
    if text.startswith("no Footlight server answers"):
        return f"{text}; `footlight serve` starts one, --server names another"
    if isinstance(error, TokenRequiredError):
        return f"{text}; $FOOTLIGHT_TOKEN or --token says who one is"
    if isinstance(error, RenderFailedError) and error.prim_path and error.prim_path not in text:
        return f"{error.prim_path}: {text}"
    return text


def option_of(field: str) -> str:
    """The option or argument that sets a field of a request."""
    name, inside = _PREFIX.subn("", field)
    name = name.partition("[")[0]
    if inside or name in OPTIONS:
        known = OPTIONS
    else:
        known, name = _OTHERS, name.rpartition(".")[2]
    return known.get(name, f"--{name.replace('_', '-')}")


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
    text = (
        f"{output}: {partial}{render.spec.width}x{render.spec.height}, {stats.spp} spp, {duration(stats.seconds.total)}"
    )
    if stats.HasField("error_mean"):
        # Monte Carlo: half the error takes four times the samples, three times as many again.
        text += f"; error {percent(stats.error_mean)}, half of that for {duration(3 * stats.seconds.render)} more"
    fired = sum(stats.guards.values())
    return text + (f"; {fired} samples met a guard, see --stats" if fired else "")


def duration(seconds: float) -> str:
    """1.2 s, 34 s, 5:06, 1:02:03."""
    if seconds < 99.5:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def percent(ratio: float) -> str:
    """Two digits that count: 12 %, 1.2 %, 0.12 %."""
    return f"{100 * ratio:.2g} %" if ratio < 0.995 else f"{100 * ratio:.0f} %"
