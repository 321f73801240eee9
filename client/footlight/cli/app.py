"""The command line: every command, in the order that --help shows them."""

from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from footlight.cli import exits
from footlight.cli.command import command
from footlight.cli.commands import admin, look, render, serve, steer, submit

EPILOG = "\n".join(["Exit codes", *(f"{code.value:<5}{text}" for code, text in exits.HELP.items())])

_HELP = {"help_option_names": ["-h", "--help"]}
# The module that is called has its own --help.
_PASSED_ON = {"help_option_names": [], "ignore_unknown_options": True, "allow_extra_args": True}

# Heading in --help -> commands.
COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "One image": (render.render, render.explain),
    "The farm queue": (submit.submit, look.jobs, look.job, look.tasks, look.log, look.watch, look.why, look.fetch),
    "Steering": (steer.pause, steer.resume, steer.cancel, steer.retry, steer.skip, steer.prune),
    "The server": (serve.serve, look.workers, admin.limits),
}


class _Command(TyperCommand):
    """Its --help shows no type behind a flag, which takes no value."""

    def get_params(self, ctx: Any) -> Any:
        return _untyped(super().get_params(ctx))


class _Group(TyperGroup):
    """As _Command."""

    def get_params(self, ctx: Any) -> Any:
        return _untyped(super().get_params(ctx))


def _untyped(params: Any) -> Any:
    for param in params:
        if getattr(param, "is_flag", False):
            param.metavar = ""
    return params


def _app(name: str, text: str) -> typer.Typer:
    return typer.Typer(
        name=name,
        cls=_Group,
        help=text,
        epilog=EPILOG,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings=_HELP,
    )


app = _app(
    "footlight",
    "Render USD stages and watch them converge, one image at a time or by a farm queue. "
    "Progress goes to stderr, results to files or stdout.",
)
_token = _app("token", "Who may do what from beyond this machine.")
_cluster = _app("cluster", "Nodes of a Ray cluster, started safely. Needs footlight-server with its extra `ray`.")


def _version(asked: bool) -> None:
    if asked:
        from footlight import __version__  # noqa: PLC0415

        typer.echo(f"footlight {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    del version


for _panel, _functions in COMMANDS.items():
    for _function in _functions:
        app.command(cls=_Command, epilog=EPILOG, rich_help_panel=_panel)(command(_function))
for _function, _name in ((admin.create, "create"), (admin.list_tokens, "list"), (admin.revoke, "revoke")):
    _token.command(_name, cls=_Command, epilog=EPILOG)(command(_function))
for _function in (admin.up, admin.join, admin.status):
    _cluster.command(cls=_Command, context_settings=_PASSED_ON)(command(_function))
app.add_typer(_token, rich_help_panel="The server")
app.add_typer(_cluster, rich_help_panel="The server")


def main() -> None:
    """Entry point of the `footlight` script."""
    app(prog_name="footlight")
