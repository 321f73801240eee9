"""Tokens as they are kept; what they allow, and how secrets are hashed, is in farm/tokens.py."""

from typing import Any

from sqlalchemy import Connection, Row, insert, or_, select, update

from footlight_server.farm.sql.schema import token as table
from footlight_server.farm.sql.transaction import Transaction
from footlight_server.farm.tokens import Scope, Token
from footlight_server.sessions.errors import TokenNotFoundError


def create_token(
    transaction: Transaction, token_hash: str, user: str, scope: Scope, comment: str, expires: float | None
) -> Token:
    """See Queue.create_token."""
    number = transaction.connection.execute(
        insert(table).returning(table.c.number),
        {
            "hash": token_hash,
            "user": user,
            "scope": scope.value,
            "comment": comment,
            "created": transaction.now,
            "expires": expires,
        },
    ).scalar_one()
    return _numbered(transaction.connection, number)


def tokens(connection: Connection) -> list[Token]:
    """See Queue.tokens."""
    return [_token_of(row) for row in connection.execute(select(table).order_by(table.c.number))]


def token_by_hash(connection: Connection, token_hash: str) -> Token | None:
    """See Queue.token_by_hash."""
    row = connection.execute(select(table).where(table.c.hash == token_hash)).one_or_none()
    return None if row is None else _token_of(row)


def revoke_token(transaction: Transaction, number: int) -> Token:
    """See Queue.revoke_token."""
    transaction.connection.execute(
        update(table).where(table.c.number == number, table.c.revoked.is_(None)).values(revoked=transaction.now)
    )
    return _numbered(transaction.connection, number)


def touch_token(transaction: Transaction, number: int, used: float) -> None:
    """See Queue.touch_token."""
    earlier = or_(table.c.last_used.is_(None), table.c.last_used < used)
    transaction.connection.execute(update(table).where(table.c.number == number, earlier).values(last_used=used))


def _numbered(connection: Connection, number: int) -> Token:
    row = connection.execute(select(table).where(table.c.number == number)).one_or_none()
    if row is None:
        raise TokenNotFoundError(f"no token tokens/{number}")
    return _token_of(row)


def _token_of(row: Row[*tuple[Any, ...]]) -> Token:
    return Token(
        number=row.number,
        hash=row.hash,
        user=row.user,
        scope=Scope(row.scope),
        comment=row.comment,
        created=row.created,
        expires=row.expires,
        revoked=row.revoked,
        last_used=row.last_used,
    )
