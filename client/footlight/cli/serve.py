"""`footlight serve`: the server of footlight-server, in this process."""

import os
import sys
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from footlight.private import NoServerError


def run_serve(*groups: Any) -> None:
    """Become the server with the options of these dataclasses. Raises NoServerError if it is not installed."""
    if find_spec("footlight_server") is None:
        raise NoServerError(
            "footlight-server is not installed in this Python; install it with: pip install footlight-server"
        )
    become("footlight_server", [flag for group in groups for flag in flags(group)])


def flags(group: Any) -> list[str]:
    """A dataclass as command line: `--name=value` for each field that is set."""
    found = []
    for field in fields(group):
        option, value = f"--{field.name.replace('_', '-')}", getattr(group, field.name)
        if value is None or value is False or value == "":  # 0 is said
            continue
        found += [option] if value is True else [f"{option}={_text(one)}" for one in _several(value)]
    return found


def become(module: str, arguments: list[str]) -> None:
    """Replace this process by `python -m module`."""
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])  # noqa: S606 no shell is meant


def _several(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _text(value: Any) -> str:
    return str(value.absolute()) if isinstance(value, Path) else str(value)
