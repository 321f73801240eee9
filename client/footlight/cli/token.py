"""`footlight token`: make, list, revoke."""

import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from footlight.cli.connect import connect
from footlight.cli.options import Connection
from footlight.cli.parse import duration
from footlight.cli.report import note, usage
from footlight.cli.tables import write_json, write_table
from footlight.cli.words import moment, scope_word, when
from footlight.names import short, token_name
from footlight.plain import plain
from footlight.tokens import ScopeName
from footlight.v1 import token_service_pb2

COLUMNS = ("TOKEN", "USER", "SCOPE", "STATE", "CREATED", "EXPIRES", "LAST USED", "COMMENT")


def run_create(
    connection: Connection, user: str, scope: ScopeName, comment: str, expires: str, *, as_json: bool
) -> None:
    """Make a token and print its secret."""
    seconds = duration(expires, "--expires")
    end = datetime.now(UTC) + timedelta(seconds=seconds) if expires else None
    with connect(connection) as client:
        answer = client.tokens.create(user, scope, comment=comment, expires=end)
    if as_json:
        write_json(plain(answer))
        return
    sys.stdout.write(f"{answer.secret}\n")
    ends = moment(answer.token, "expire_time")
    note(
        f"{answer.token.name} of {user}, scope {scope}, {f'until {ends}' if ends else 'without an end'}; "
        "the secret is shown this once, use it as $FOOTLIGHT_TOKEN"
    )


def run_list(connection: Connection, *, as_json: bool) -> None:
    """Print all tokens."""
    with connect(connection) as client:
        tokens = client.tokens.list()
    if as_json:
        write_json([plain(token) for token in tokens])
        return
    rows = [
        (
            short(token.name),
            token.user,
            scope_word(token.scope),
            _state(token),
            moment(token, "create_time"),
            moment(token, "expire_time") or "never",
            _hour(token) or "never",
            token.comment,
        )
        for token in tokens
    ]
    write_table(COLUMNS, rows, cut=("COMMENT",))
    if not tokens:
        note("no tokens; `footlight token create USER` makes one")


def run_revoke(connection: Connection, names: Sequence[str], *, as_json: bool) -> None:
    """Revoke them in order; the first that is not there ends it."""
    with usage():
        names = [token_name(name) for name in names]
    with connect(connection) as client:
        tokens: list[token_service_pb2.Token] = []
        try:
            tokens.extend(client.tokens.revoke(name) for name in names)
        finally:
            if as_json:
                write_json([plain(token) for token in tokens])
            else:
                sys.stdout.writelines(f"{token.name} of {token.user}: revoked\n" for token in tokens)


def _hour(token: token_service_pb2.Token) -> str:
    """Of the last use, which is kept to the hour: `2026-11-22 14h`."""
    time = when(token, "last_use_time")
    return time.astimezone().strftime("%Y-%m-%d %Hh") if time else ""


def _state(token: token_service_pb2.Token) -> str:
    if token.HasField("revoke_time"):
        return "revoked"
    expired = token.HasField("expire_time") and token.expire_time.ToDatetime(UTC) < datetime.now(UTC)
    return "expired" if expired else "valid"
