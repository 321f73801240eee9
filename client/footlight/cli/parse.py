"""Values of options, from what people type. What is not allowed is refused by name, with what is."""

import os
import re
from collections.abc import Iterable

import typer

from footlight.names import job_name

_UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*([smhd]?)")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def size(text: str) -> tuple[int, int] | None:
    """(width, height) [pixels] of `1920x1080`; None of nothing."""
    if not text:
        return None
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and int(width) > 0 and int(height) > 0):
        raise typer.BadParameter(f"{text!r} is not WIDTHxHEIGHT in pixels, as in 1920x1080", param_hint="--size")
    return int(width), int(height)


def duration(text: str, option: str) -> float:
    """[s] Of `90`, `90s`, `15m`, `2h`, `7d`; 0 of nothing."""
    if not text:
        return 0.0
    found = _DURATION.fullmatch(text)
    if found is None:
        raise typer.BadParameter(f"{text!r} is not a time; write 90s, 15m, 2h or 7d", param_hint=option)
    return float(found[1]) * _UNITS[found[2]]


def jobs(texts: Iterable[str], option: str) -> list[str]:
    """Names of jobs, from `12` or `jobs/12`."""
    try:
        return [job_name(text) for text in texts]
    except ValueError as error:
        raise typer.BadParameter(str(error).partition(": ")[2], param_hint=option) from error


def environment(rules: Iterable[str]) -> dict[str, str]:
    """Variables of `NAME=VALUE`, or `NAME` for its value here."""
    found = {}
    for rule in rules:
        name, equals, value = rule.partition("=")
        if not _NAME.fullmatch(name):
            raise typer.BadParameter(f"{rule!r} is not NAME=VALUE", param_hint="--env")
        if not equals and name not in os.environ:
            raise typer.BadParameter(f"{name} has no value here; write {name}=VALUE", param_hint="--env")
        found[name] = value if equals else os.environ[name]
    return found


def host_and_port(text: str, option: str) -> tuple[str, int]:
    """Of `HOST:PORT`."""
    host, colon, port = text.rpartition(":")
    if not (colon and host and port.isdecimal() and 0 < int(port) < 65536):
        raise typer.BadParameter(f"{text!r} is not HOST:PORT, as in localhost:14158", param_hint=option)
    return host.strip("[]"), int(port)
