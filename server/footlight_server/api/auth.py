"""Who calls, as a handler is told; and the gate of addresses that only this machine reaches."""

import os
import pwd
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, TypeAlias

import grpc

from footlight_server.api.intercept import Handler, wrapped
from footlight_server.farm.tokens import Scope

Details: TypeAlias = grpc.HandlerCallDetails
Continuation: TypeAlias = Callable[[Details], Awaitable[grpc.RpcMethodHandler | None]]


@dataclass(frozen=True, slots=True)
class Caller:
    """Whom a call comes from."""

    user: str
    scope: Scope

    @property
    def is_admin(self) -> bool:
        """May do everything, to what is others' too."""
        return self.scope is Scope.ADMIN


# Each call runs in a task, and so in a context, of its own.
_CALLER: ContextVar[Caller] = ContextVar("caller")


def enter_as(who: Caller) -> None:
    """The call of this task comes from `who`. For gates only."""
    _CALLER.set(who)


def caller(context: grpc.aio.ServicerContext) -> Caller:
    """Whom the call of this handler comes from. Raises LookupError outside of a call that was let in."""
    del context
    return _CALLER.get()


def local_caller() -> Caller:
    """Whoever reaches a loopback or Unix socket: the user of this process, with all rights."""
    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # containers run users that no file names
        user = f"uid{os.getuid()}"
    return Caller(user, Scope.ADMIN)


class LocalGate(grpc.aio.ServerInterceptor):  # type: ignore[misc]
    """For sockets that only this machine reaches: everybody is let in."""

    def __init__(self) -> None:
        self._caller = local_caller()

    async def intercept_service(self, continuation: Continuation, details: Details) -> grpc.RpcMethodHandler | None:
        """Say who calls."""
        method = await continuation(details)
        return None if method is None else wrapped(method, self._around)

    def _around(self, handler: Handler) -> Handler:
        async def enter(request: Any, context: grpc.aio.ServicerContext) -> Any:
            enter_as(self._caller)
            return await handler(request, context)

        return enter
