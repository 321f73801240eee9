"""Sending to who does not read."""

import asyncio

import grpc
import pytest

from footlight.v1 import render_service_pb2
from footlight_server.api.streams import ClientGoneError, send
from footlight_server.sessions.errors import ViewerSilentError

MESSAGE = render_service_pb2.GetResultResponse(data=bytes(256 << 10))


async def serve(context: grpc.aio.ServicerContext, ends: asyncio.Queue[Exception]) -> None:
    try:
        while True:
            await send(context, MESSAGE, patience=0.5)
    except (ViewerSilentError, ClientGoneError) as error:
        ends.put_nowait(error)


@pytest.mark.parametrize(("vanish", "kind"), [(False, ViewerSilentError), (True, ClientGoneError)])
async def test_a_write_that_nobody_takes_ends(vanish: bool, kind: type[Exception]) -> None:
    """A client that keeps the stream but reads nothing, and one that goes while a write is blocked."""
    ends: asyncio.Queue[Exception] = asyncio.Queue()

    async def handler(_: object, context: grpc.aio.ServicerContext) -> None:
        await serve(context, ends)

    server = grpc.aio.server()
    methods = {
        "Read": grpc.unary_stream_rpc_method_handler(
            handler, response_serializer=render_service_pb2.GetResultResponse.SerializeToString
        )
    }
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test", methods),))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    try:
        async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
            call = channel.unary_stream("/test/Read")(b"")
            await call.read()
            if vanish:
                await asyncio.sleep(0.2)
                call.cancel()
            async with asyncio.timeout(10):
                assert isinstance(await ends.get(), kind)
            call.cancel()
    finally:
        await server.stop(0)
