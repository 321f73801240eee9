"""The gate of addresses that others reach: tokens are looked at before a message is read, and while the call lasts."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Iterator, Sequence
from typing import Any

import grpc

from footlight_server.api.auth import Caller, Continuation, Details, enter_as
from footlight_server.api.errors import status_of
from footlight_server.api.intercept import Handler, unwaiting, wrapped
from footlight_server.api.scopes import SCOPES
from footlight_server.farm.token_book import TokenBook
from footlight_server.farm.tokens import Token
from footlight_server.sessions.errors import QuotaError, ScopeRequiredError, ServiceError, TokenRequiredError

log = logging.getLogger(__name__)

# [s] For the first message of a call that is refused.
_FIRST_MESSAGE = 0.5
# [s] For that of a call without a token, and of one with a token.
_STRANGERS_MESSAGE, _MESSAGE = 5.0, 30.0

# [calls] That one token may have open: some of the server's are left for everybody else.
_MOST_CALLS = 250

Metadata = Sequence[tuple[str, str | bytes]]


class TokenGate(grpc.aio.ServerInterceptor):  # type: ignore[misc]
    """For sockets that others reach: a call needs a token of the scope that its method asks for."""

    def __init__(self, book: TokenBook) -> None:
        self._book = book
        # Token number -> the calls that go on in its name.
        self._open: dict[int, set[asyncio.Timeout]] = {}

    async def intercept_service(self, continuation: Continuation, details: Details) -> grpc.RpcMethodHandler | None:
        """Let in, or refuse."""
        method = await continuation(details)
        if method is None:
            return None
        needed = SCOPES[details.method]
        if needed is None:
            return unwaiting(method, _STRANGERS_MESSAGE)
        try:
            token = self._token(details.invocation_metadata)
            if not token.scope.includes(needed):
                raise ScopeRequiredError(f"this takes a token of scope {needed}; yours has scope {token.scope}")
            if len(self._open.get(token.number, ())) >= _MOST_CALLS:
                raise QuotaError(f"your token has {_MOST_CALLS} calls open; that is the most")
        except ServiceError as error:
            return _refusal(details.method, error)
        return wrapped(unwaiting(method, _MESSAGE), lambda handler: self._around(handler, token))

    def cut(self, number: int) -> None:
        """End all calls in the name of a token."""
        now = asyncio.get_running_loop().time()
        for limit in self._open.get(number, ()):
            if not limit.expired():
                limit.reschedule(now)

    def _token(self, metadata: Metadata) -> Token:
        given = [value for key, value in metadata if key == "authorization"]
        scheme, _, secret = given[0].partition(" ") if len(given) == 1 and isinstance(given[0], str) else ("", "", "")
        if scheme.lower() != "bearer":
            raise TokenRequiredError("this address takes calls with a token only (authorization: Bearer …)")
        token = self._book.find(secret.strip())
        if token is None:
            raise TokenRequiredError("the token is unknown, revoked or out of date")
        return token

    def _around(self, handler: Handler, token: Token) -> Handler:
        async def enter(request: Any, context: grpc.aio.ServicerContext) -> Any:
            enter_as(Caller(token.user, token.scope))
            with self._holding(token) as limit:
                # Since the headers came, and until the message did, the token may have been revoked.
                if self._book.opens(token.number):
                    try:
                        async with limit:
                            return await handler(request, context)
                    except TimeoutError:
                        if not limit.expired():
                            raise
            return await context.abort_with_status(status_of(TokenRequiredError("the token opens nothing any more")))

        return enter

    @contextlib.contextmanager
    def _holding(self, token: Token) -> Iterator[asyncio.Timeout]:
        """The time that a call in the name of the token has; `cut` ends it."""
        limit = asyncio.timeout(self._book.seconds_left(token.number))
        calls = self._open.setdefault(token.number, set())
        calls.add(limit)
        try:
            yield limit
        finally:
            calls.discard(limit)
            if not calls:
                self._open.pop(token.number, None)


def _refusal(name: str, error: ServiceError) -> grpc.RpcMethodHandler:
    """A method that ends a call soon.

    As a stream, whatever the method's kind: gRPC then does not wait for a message that a stranger may never send. Not
    at once, though: a client that still writes when its call ends sees INTERNAL instead of what it was told.
    """

    async def refuse(requests: AsyncIterator[object], context: grpc.aio.ServicerContext) -> None:
        fields = {"method": name, "peer": context.peer()}
        log.info("refused %s from %s: %s", name, context.peer(), error, extra=fields)
        with contextlib.suppress(TimeoutError, StopAsyncIteration):
            async with asyncio.timeout(_FIRST_MESSAGE):
                await anext(requests)
        await context.abort_with_status(status_of(error))

    return grpc.stream_stream_rpc_method_handler(refuse)
