"""Something done around every handler of a server, whatever its kind."""

import inspect
from collections.abc import Awaitable, Callable
from typing import Any

import grpc

# What is called with a request, or an iterator of them, and the context.
Handler = Callable[[Any, grpc.aio.ServicerContext], Awaitable[Any]]

_KINDS = {
    "unary_unary": grpc.unary_unary_rpc_method_handler,
    "unary_stream": grpc.unary_stream_rpc_method_handler,
    "stream_unary": grpc.stream_unary_rpc_method_handler,
    "stream_stream": grpc.stream_stream_rpc_method_handler,
}


def wrapped(method: grpc.RpcMethodHandler, around: Callable[[Handler], Handler]) -> grpc.RpcMethodHandler:
    """The same method with another handler around its own."""
    for kind, make in _KINDS.items():
        inner = getattr(method, kind)
        if inner is not None:
            return make(around(_writing(inner)), method.request_deserializer, method.response_serializer)
    raise TypeError(f"{method!r} handles nothing")


def _writing(handler: Callable[..., Any]) -> Handler:
    """A handler that yields its responses, as one that writes them."""
    if not inspect.isasyncgenfunction(handler):
        return handler

    async def write(request: Any, context: grpc.aio.ServicerContext) -> None:
        async for response in handler(request, context):
            await context.write(response)

    return write
