"""TokenService: the handlers for making, listing and revoking tokens."""

import re
from collections.abc import Callable, Sequence
from typing import Protocol

import grpc
from google.protobuf.timestamp_pb2 import Timestamp

from footlight.v1 import token_service_pb2, token_service_pb2_grpc
from footlight_server.api.errors import told
from footlight_server.farm.token_book import TokenBook
from footlight_server.farm.tokens import Scope, Token
from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError, TokenNotFoundError

_USER = re.compile(r"[A-Za-z0-9_.@-]{1,64}")
_LONGEST_COMMENT = 4096
# [s since 1970] The last second that a Timestamp may say: the year 9999.
_LATEST = 253_402_300_799.0
_NAME = re.compile(r"tokens/([0-9]{1,18})")

_SCOPES = {
    token_service_pb2.SCOPE_READ: Scope.READ,
    token_service_pb2.SCOPE_SUBMIT: Scope.SUBMIT,
    token_service_pb2.SCOPE_ADMIN: Scope.ADMIN,
}
_SCOPE_VALUES = {scope: value for value, scope in _SCOPES.items()}


class Gate(Protocol):
    """What lets calls in by their tokens."""

    def cut(self, number: int) -> None:
        """End all calls in the name of a token."""
        ...


class TokenService(token_service_pb2_grpc.TokenServiceServicer):  # type: ignore[misc]
    """Knows the book of tokens, and the gate whose open calls end when a token is revoked."""

    def __init__(self, book: TokenBook, gate: Gate, clock: Callable[[], float]) -> None:
        self._book = book
        self._gate = gate
        self._clock = clock

    @told
    async def CreateToken(
        self, request: token_service_pb2.CreateTokenRequest, context: grpc.aio.ServicerContext
    ) -> token_service_pb2.CreateTokenResponse:
        """Make one; the answer is the only place that ever holds its secret."""
        violations = _violations(request, self._clock())
        if violations:
            raise InvalidFieldsError(violations)
        expires = _seconds(request.expire_time) if request.HasField("expire_time") else None
        token, secret = await self._book.create(request.user, _SCOPES[request.scope], request.comment, expires)
        return token_service_pb2.CreateTokenResponse(token=_message(token), secret=secret)

    @told
    async def ListTokens(
        self, request: token_service_pb2.ListTokensRequest, context: grpc.aio.ServicerContext
    ) -> token_service_pb2.ListTokensResponse:
        """All of them, without secrets."""
        return token_service_pb2.ListTokensResponse(tokens=[_message(token) for token in self._book.all()])

    @told
    async def RevokeToken(
        self, request: token_service_pb2.RevokeTokenRequest, context: grpc.aio.ServicerContext
    ) -> token_service_pb2.RevokeTokenResponse:
        """Once it is on disk that the token is revoked, its calls end."""
        found = _NAME.fullmatch(request.name)
        if found is None:
            raise TokenNotFoundError(f"no token {request.name!r}")
        token = await self._book.revoke(int(found[1]))
        self._gate.cut(token.number)
        return token_service_pb2.RevokeTokenResponse(token=_message(token))


def _violations(request: token_service_pb2.CreateTokenRequest, now: float) -> Sequence[FieldViolation]:
    violations = []
    if not _USER.fullmatch(request.user):
        violations.append(FieldViolation("user", f"{request.user!r}: 1 to 64 of A-Z a-z 0-9 _ . @ -"))
    if request.scope not in _SCOPES:
        violations.append(FieldViolation("scope", f"{request.scope}: not a Scope of this server"))
    if len(request.comment) > _LONGEST_COMMENT:
        violations.append(FieldViolation("comment", f"longer than {_LONGEST_COMMENT} characters"))
    if request.HasField("expire_time") and not now < _seconds(request.expire_time) < _LATEST:
        violations.append(FieldViolation("expire_time", "has passed already, or is no time"))
    return violations


def _message(token: Token) -> token_service_pb2.Token:
    return token_service_pb2.Token(
        name=f"tokens/{token.number}",
        user=token.user,
        scope=_SCOPE_VALUES[token.scope],
        comment=token.comment,
        create_time=_timestamp(token.created),
        expire_time=_timestamp(token.expires),
        revoke_time=_timestamp(token.revoked),
        last_use_time=_timestamp(token.last_used),
    )


def _seconds(timestamp: Timestamp) -> float:
    """As [s since 1970]."""
    return float(timestamp.seconds + timestamp.nanos / 1e9)


def _timestamp(seconds: float | None) -> Timestamp | None:
    if seconds is None:
        return None
    timestamp = Timestamp()
    timestamp.FromNanoseconds(int(seconds * 1e9))
    return timestamp
