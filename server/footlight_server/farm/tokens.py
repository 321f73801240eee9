"""Tokens: what they allow and what is kept of them."""

import re
from dataclasses import dataclass
from enum import StrEnum

PREFIX = "footlight_"
SECRET = re.compile(PREFIX + r"[A-Za-z0-9_-]{43}")


class Scope(StrEnum):
    """What a token allows, as in the protocol; stored by these words."""

    READ = "read"
    SUBMIT = "submit"
    ADMIN = "admin"

    def includes(self, other: "Scope") -> bool:
        """Each scope includes those before it."""
        order = list(Scope)
        return order.index(self) >= order.index(other)


@dataclass(frozen=True, slots=True)
class Token:
    """A token as it is kept: without its secret. Times are [s since 1970, UTC]; None: never."""

    number: int
    # Of the secret: SHA-256, 64 hexadecimal digits.
    hash: str
    user: str
    scope: Scope
    comment: str
    created: float
    expires: float | None = None
    revoked: float | None = None
    # To the hour.
    last_used: float | None = None

    def opens(self, now: float) -> bool:
        """It is neither revoked nor expired."""
        return self.revoked is None and (self.expires is None or now < self.expires)
