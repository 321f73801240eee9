"""The book of tokens: makes secrets, keeps their hashes, and says which token a secret belongs to."""

import asyncio
import base64
import hashlib
import hmac
import logging
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from footlight_server.farm.tokens import PREFIX, SECRET, Scope, Token

log = logging.getLogger(__name__)

# [bytes] 32 of them are 43 characters of base64.
_SECRET_BYTES = 32
# [s] Last use is kept to the hour: a write per call would cost more than the call.
USE_PERIOD = 3600.0
# [s] For writing it down.
_TOUCHING = 10.0


def new_secret() -> str:
    """`footlight_` and 43 characters: 256 random bits."""
    return PREFIX + base64.urlsafe_b64encode(secrets.token_bytes(_SECRET_BYTES)).rstrip(b"=").decode("ascii")


def hashed(secret: str) -> str:
    """What is kept of a secret: 64 hexadecimal digits.

    Plain SHA-256. A slow hash is for passwords, which can be guessed; nobody guesses 256 random bits, and a slow hash
    would let strangers spend the server's time.
    """
    return hashlib.sha256(secret.encode()).hexdigest()


class TokenStore(Protocol):
    """Where tokens are kept."""

    async def create_token(
        self, token_hash: str, user: str, scope: Scope, comment: str = "", expires: float | None = None
    ) -> Token:
        """Keep a new one."""
        ...

    async def tokens(self) -> Sequence[Token]:
        """All, the revoked ones too."""
        ...

    async def revoke_token(self, number: int) -> Token:
        """It opens nothing from now on. Idempotent. Raises TokenNotFoundError."""
        ...

    async def touch_token(self, number: int, used: float) -> None:
        """It was used."""
        ...


class TokenBook:
    """The tokens of a server, in memory: nobody else changes them, and a call should not wait for a disk."""

    def __init__(self, store: TokenStore, clock: Callable[[], float] = time.time) -> None:
        self._store = store
        self._clock = clock
        self._tokens: dict[int, Token] = {}
        # hash -> number
        self._numbers: dict[str, int] = {}
        self._touches: set[asyncio.Task[None]] = set()

    async def load(self) -> None:
        """Read all that are kept. To be called once, before anything else."""
        for token in await self._store.tokens():
            self._keep(token)

    def all(self) -> list[Token]:
        """In the order of their numbers."""
        return sorted(self._tokens.values(), key=lambda token: token.number)

    def find(self, secret: str) -> Token | None:
        """The token of this secret, if it opens anything; its use is noted."""
        if not SECRET.fullmatch(secret):
            return None
        digest = hashed(secret)
        token = self._tokens.get(self._numbers.get(digest, 0))
        now = self._clock()
        if token is None or not hmac.compare_digest(token.hash, digest) or not token.opens(now):
            return None
        self._note_use(token, now)
        return token

    def opens(self, number: int) -> bool:
        """A token opens something still."""
        return self._tokens[number].opens(self._clock())

    def seconds_left(self, number: int) -> float | None:
        """[s] Until a token opens nothing any more, as far as is known; None: it has no end."""
        expires = self._tokens[number].expires
        return None if expires is None else expires - self._clock()

    async def create(self, user: str, scope: Scope, comment: str, expires: float | None) -> tuple[Token, str]:
        """A new token, and its secret, which is kept nowhere."""
        secret = new_secret()
        token = await self._store.create_token(hashed(secret), user, scope, comment, expires)
        self._keep(token)
        return token, secret

    async def revoke(self, number: int) -> Token:
        """From now on it opens nothing. Raises TokenNotFoundError."""
        token = await self._store.revoke_token(number)
        self._keep(token)
        return token

    async def close(self) -> None:
        """Wait, not long, for what is still being written down."""
        if self._touches:
            await asyncio.wait(self._touches, timeout=_TOUCHING)

    def _keep(self, token: Token) -> None:
        self._tokens[token.number] = token
        self._numbers[token.hash] = token.number

    def _note_use(self, token: Token, now: float) -> None:
        hour = now // USE_PERIOD * USE_PERIOD
        if token.last_used is not None and token.last_used >= hour:
            return
        self._keep(replace(token, last_used=hour))
        touch = asyncio.create_task(self._touch(token.number, hour))
        self._touches.add(touch)
        touch.add_done_callback(self._touches.discard)

    async def _touch(self, number: int, hour: float) -> None:
        try:
            async with asyncio.timeout(_TOUCHING):
                await self._store.touch_token(number, hour)
        except Exception as error:  # noqa: BLE001 - a call does not fail because its time could not be written down
            log.warning("the last use of token %d could not be kept: %s", number, error)
