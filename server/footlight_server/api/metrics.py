"""Every call is measured and, with --verbose, logged: method, status code, seconds."""

import asyncio
import logging
import time
from typing import Any, Protocol

import grpc

from footlight_server.api.auth import Continuation, Details
from footlight_server.api.intercept import Handler, wrapped

log = logging.getLogger(__name__)

_CODES = {code.value[0]: code for code in grpc.StatusCode}


class CallMeter(Protocol):
    """Where calls are counted."""

    def count_call(self, method: str, code: str, seconds: float) -> None:
        """A call has ended."""
        ...


class MeterGate(grpc.aio.ServerInterceptor):  # type: ignore[misc]
    """The outermost: calls that are refused count too."""

    def __init__(self, meter: CallMeter | None) -> None:
        self._meter = meter

    async def intercept_service(
        self,
        continuation: Continuation,
        details: Details,
    ) -> grpc.RpcMethodHandler | None:
        """Put a clock around the method."""
        method = await continuation(details)
        return None if method is None else wrapped(method, lambda handler: self._around(handler, details.method))

    def _around(self, handler: Handler, name: str) -> Handler:
        async def measure(request: Any, context: grpc.aio.ServicerContext) -> Any:
            begin = time.monotonic()
            code = "OK"
            try:
                return await handler(request, context)
            except asyncio.CancelledError:  # the client has gone, or the server goes
                code = "CANCELLED"
                raise
            except BaseException:
                # An abort has set the code; without one, gRPC says UNKNOWN.
                code = _name(context.code())
                raise
            finally:
                seconds = time.monotonic() - begin
                fields = {"method": name, "code": code, "seconds": seconds}
                log.debug("%s: %s after %.3f s", name, code, seconds, extra=fields)
                if self._meter is not None:
                    self._meter.count_call(name, code, seconds)

        return measure


def _name(code: Any) -> str:
    known = code if isinstance(code, grpc.StatusCode) else _CODES.get(code, grpc.StatusCode.UNKNOWN)
    return str(grpc.StatusCode.UNKNOWN.name if known is grpc.StatusCode.OK else known.name)
