"""Something done around every handler of a server, whatever its kind."""

import asyncio
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable
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


def unwaiting(method: grpc.RpcMethodHandler, seconds: float) -> grpc.RpcMethodHandler:
    """The same method, whose one request has to come within so many seconds [s].

    As a stream: for a method with one request gRPC itself waits, without end and before any handler is called, and such
    calls would take up all that a server has. Methods with a stream of requests look after that themselves.
    """
    inner = method.unary_unary or method.unary_stream
    if inner is None:
        return method
    writing = _writing(inner)

    async def take_one(requests: AsyncIterator[Any], context: grpc.aio.ServicerContext) -> None:
        try:
            async with asyncio.timeout(seconds):
                request = await anext(requests)
        except TimeoutError:
            await context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, f"no request came within {seconds:g} s")
        except StopAsyncIteration:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "no request came")
        response = await writing(request, context)
        if method.unary_unary is not None:
            await context.write(response)

    return grpc.stream_stream_rpc_method_handler(take_one, method.request_deserializer, method.response_serializer)


def _writing(handler: Callable[..., Any]) -> Handler:
    """A handler that yields its responses, as one that writes them."""
    if not inspect.isasyncgenfunction(handler):
        return handler

    async def write(request: Any, context: grpc.aio.ServicerContext) -> None:
        async for response in handler(request, context):
            await context.write(response)

    return write
