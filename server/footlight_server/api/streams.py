"""Sending on a stream without trusting the reader."""

import asyncio
from typing import TypeVar

import grpc
from google.protobuf.message import Message

from footlight_server.sessions.errors import ViewerSilentError

M = TypeVar("M", bound=Message)

# [s] One message may take to leave; said in the protocol.
SEND_PATIENCE = 30.0
# [bytes] Of data in one message.
CHUNK_BYTES = 256 << 10


class ClientGoneError(Exception):
    """The stream is broken; there is nobody to tell."""


async def send(context: grpc.aio.ServicerContext, message: M, patience: float = SEND_PATIENCE) -> None:
    """Send a message. Raises ViewerSilentError if it is not taken, ClientGoneError if the stream is broken.

    A write that is blocked when the client goes fails with an exception of grpc's own, not with a cancellation.
    """
    try:
        async with asyncio.timeout(patience):
            await context.write(message)
    except TimeoutError:
        raise ViewerSilentError(f"nothing was read for {patience:g} s") from None
    except grpc.aio.BaseError as error:
        raise ClientGoneError from error
