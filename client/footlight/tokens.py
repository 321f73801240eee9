"""The tokens of a server: make, list, revoke. Once with threads, once with asyncio."""

from datetime import datetime
from typing import Literal

import grpc

from footlight.errors import rpc_errors
from footlight.spec import by_name
from footlight.v1 import token_service_pb2, token_service_pb2_grpc

ScopeName = Literal["read", "submit", "admin"]

SCOPES = {
    "read": token_service_pb2.SCOPE_READ,
    "submit": token_service_pb2.SCOPE_SUBMIT,
    "admin": token_service_pb2.SCOPE_ADMIN,
}


class Tokens:
    """What `Client.tokens` is. Every method raises FootlightError, DeniedError without the scope `admin`."""

    def __init__(self, channel: grpc.Channel, address: str, timeout: float) -> None:
        self._address = address
        self._timeout = timeout
        self._stub = token_service_pb2_grpc.TokenServiceStub(channel)

    def create(
        self, user: str, scope: ScopeName, *, comment: str = "", expires: datetime | None = None
    ) -> token_service_pb2.CreateTokenResponse:
        """Make a token; its secret is in the answer and nowhere else. `expires` has to know its time zone."""
        with rpc_errors(self._address):
            request = _create(user, scope, comment, expires)
            response: token_service_pb2.CreateTokenResponse = self._stub.CreateToken(request, timeout=self._timeout)
        return response

    def list(self) -> list[token_service_pb2.Token]:
        """All tokens, the revoked ones too."""
        with rpc_errors(self._address):
            return [*self._stub.ListTokens(token_service_pb2.ListTokensRequest(), timeout=self._timeout).tokens]

    def revoke(self, name: str) -> token_service_pb2.Token:
        """From now on the token `tokens/3` opens nothing. Raises TokenNotFoundError."""
        with rpc_errors(self._address):
            request = token_service_pb2.RevokeTokenRequest(name=name)
            token: token_service_pb2.Token = self._stub.RevokeToken(request, timeout=self._timeout).token
        return token


class AsyncTokens:
    """`Tokens` for asyncio: the same methods, awaited."""

    def __init__(self, channel: grpc.aio.Channel, address: str, timeout: float) -> None:
        self._address = address
        self._timeout = timeout
        self._stub = token_service_pb2_grpc.TokenServiceStub(channel)

    async def create(
        self, user: str, scope: ScopeName, *, comment: str = "", expires: datetime | None = None
    ) -> token_service_pb2.CreateTokenResponse:
        """As `Tokens.create`."""
        with rpc_errors(self._address):
            request = _create(user, scope, comment, expires)
            response: token_service_pb2.CreateTokenResponse = await self._stub.CreateToken(
                request, timeout=self._timeout
            )
        return response

    async def list(self) -> list[token_service_pb2.Token]:
        """As `Tokens.list`."""
        with rpc_errors(self._address):
            answer = await self._stub.ListTokens(token_service_pb2.ListTokensRequest(), timeout=self._timeout)
            return [*answer.tokens]

    async def revoke(self, name: str) -> token_service_pb2.Token:
        """As `Tokens.revoke`."""
        with rpc_errors(self._address):
            request = token_service_pb2.RevokeTokenRequest(name=name)
            token: token_service_pb2.Token = (await self._stub.RevokeToken(request, timeout=self._timeout)).token
        return token


def _create(
    user: str, scope: ScopeName, comment: str, expires: datetime | None
) -> token_service_pb2.CreateTokenRequest:
    request = token_service_pb2.CreateTokenRequest(user=user, scope=by_name(SCOPES, "scope", scope), comment=comment)
    if expires is not None:
        request.expire_time.FromDatetime(expires)
    return request
