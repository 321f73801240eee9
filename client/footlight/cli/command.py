"""A function as a command: its options may come in groups, and what it raises becomes a message and an exit code."""

import inspect
import os
from collections.abc import Callable
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from typing import Annotated, Any, get_args, get_type_hints

from typer.models import OptionInfo


def command(function: Callable[..., None]) -> Callable[..., None]:
    """`function` as typer wants it. A parameter whose type is a dataclass becomes an option for each of its fields.

    So what several commands have in common is declared once. Field types are as typer reads them; a group's PANEL is
    the heading over its options in --help. Raises ValueError if two groups have a field of the same name.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(function).parameters.items():
        single = inspect.Parameter(name, _KEYWORD, default=parameter.default, annotation=hints[name])
        parameters += _members(groups[name]) if name in groups else [single]

    def run(**values: Any) -> None:
        # What gRPC would write on stderr by itself comes again in what is raised. It reads this while it is loaded.
        os.environ.setdefault("GRPC_VERBOSITY", "NONE")
        from footlight.cli.report import reporting  # noqa: PLC0415 loads gRPC

        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        with reporting():
            function(**values)

    run.__name__, run.__doc__ = function.__name__, _reflowed(function.__doc__ or "")
    # Refuses a name that is there twice.
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def _reflowed(text: str) -> str:
    """Paragraphs without the line breaks of the source, which --help would keep."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


_KEYWORD = inspect.Parameter.KEYWORD_ONLY


def _members(group: Any) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            _KEYWORD,
            default=inspect.Parameter.empty if field.default is MISSING else field.default,
            annotation=_under(getattr(group, "PANEL", None), hints[field.name]),
        )
        for field in fields(group)
    ]


def _under(panel: str | None, hint: Any) -> Any:
    kind, info = get_args(hint)
    if panel and isinstance(info, OptionInfo):
        info = copy(info)
        info.rich_help_panel = panel
    return Annotated[kind, info]
