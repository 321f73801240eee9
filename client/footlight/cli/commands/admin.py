"""Running a farm: `footlight limits`, `token create|list|revoke`, `cluster up|join|status`."""

from typing import Annotated, Literal, Optional

import typer

from footlight.cli.options import AsJson, Connection


def limits(
    connection: Connection,
    *,
    name: Annotated[str, typer.Argument(metavar="NAME", help="A limit to make or change.", show_default=False)] = "",
    most: Annotated[
        Optional[int],  # noqa: UP045 typer reads it at run time
        typer.Argument(metavar="MOST", min=0, help="How many may run at the same time.", show_default=False),
    ] = None,
    per: Annotated[
        Optional[Literal["task", "host"]],  # noqa: UP045 typer reads it at run time
        typer.Option(
            help="What counts: running tasks, or hosts that run any. Default: as it was, of a new limit tasks."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the limits on what runs at the same time, or set one: `footlight limits houdini 5 --per host`."""
    from footlight.cli.limits import run_limits  # noqa: PLC0415

    if name and most is None:
        raise typer.BadParameter(f"say how many: footlight limits {name} N", param_hint="MOST")
    run_limits(connection, name, most, per, as_json=as_json)


def create(
    user: Annotated[str, typer.Argument(metavar="USER", help="Whose it is: jobs and quotas count by user.")],
    connection: Connection,
    *,
    scope: Annotated[
        Literal["read", "submit", "admin"],
        typer.Option(help="read: look at everything; submit: besides, jobs of one's own; admin: everything."),
    ] = "submit",
    comment: Annotated[str, typer.Option(metavar="TEXT", help="For people.")] = "",
    expires: Annotated[str, typer.Option(metavar="TIME", help="From now on: 12h, 90d.", show_default="never")] = "",
    as_json: AsJson = False,
) -> None:
    """Make a token. Its secret comes on stdout, this once: the server keeps a hash."""
    from footlight.cli.token import run_create  # noqa: PLC0415

    run_create(connection, user, scope, comment, expires, as_json=as_json)


def list_tokens(connection: Connection, *, as_json: AsJson = False) -> None:
    """List all tokens, the revoked ones too, without their secrets."""
    from footlight.cli.token import run_list  # noqa: PLC0415

    run_list(connection, as_json=as_json)


def revoke(
    names: Annotated[list[str], typer.Argument(metavar="TOKEN", help="Tokens: 3 or tokens/3.")],
    connection: Connection,
    *,
    as_json: AsJson = False,
) -> None:
    """From now on these tokens open nothing."""
    from footlight.cli.token import run_revoke  # noqa: PLC0415

    run_revoke(connection, names, as_json=as_json)


def up(context: typer.Context) -> None:
    """Start the head of a Ray cluster on this machine, with a token. `footlight cluster up --help` says how."""
    _cluster("up", context)


def join(context: typer.Context) -> None:
    """Make this machine a node of a cluster. `footlight cluster join --help` says how."""
    _cluster("join", context)


def status(context: typer.Context) -> None:
    """Say which nodes a cluster has."""
    _cluster("status", context)


def _cluster(action: str, context: typer.Context) -> None:
    from footlight.cli.cluster import run_cluster  # noqa: PLC0415

    run_cluster(action, context.args)
