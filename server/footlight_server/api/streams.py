"""Sending on a stream without trusting the reader."""

import asyncio
import os
import stat
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import BinaryIO, TypeVar

import grpc
from google.protobuf.message import Message

from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError, TimeLimitError, ViewerSilentError

M = TypeVar("M", bound=Message)
T = TypeVar("T")

# [s] One message may take to leave; said in the protocol.
SEND_PATIENCE = 30.0
# [bytes] Of data in one message.
CHUNK_BYTES = 256 << 10
# [s] For the file system to answer.
_FILE_PATIENCE = 30.0


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


async def patiently(work: Awaitable[T], patience: float = _FILE_PATIENCE) -> T:
    """What the file system answers. Raises TimeLimitError if it does not."""
    try:
        async with asyncio.timeout(patience):
            return await work
    except TimeoutError:
        raise TimeLimitError(f"the file system did not answer for {patience:g} s") from None


async def send_file(
    context: grpc.aio.ServicerContext, path: Path, offset: int, piece: Callable[[int, int, bytes], M]
) -> None:
    """Send the file from `offset` [bytes] on; `piece(total, offset, data)` makes the messages.

    Raises FileNotFoundError before anything is sent, also for a link or what is no file, and InvalidFieldsError for an
    offset beyond the end.
    """
    file = await patiently(asyncio.to_thread(_open, path))
    try:
        total = os.fstat(file.fileno()).st_size
        if offset > total:
            raise InvalidFieldsError([FieldViolation("offset", f"{offset}: the file has {total} bytes")])
        await patiently(asyncio.to_thread(file.seek, offset))
        while data := await patiently(asyncio.to_thread(file.read, CHUNK_BYTES)):
            await send(context, piece(total, offset, data))
            offset += len(data)
    finally:
        file.close()


def _open(path: Path) -> BinaryIO:
    """A regular file, whatever stands at its path by now: a link could lead anywhere, a pipe would never answer."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise FileNotFoundError(f"{path}: {error.strerror}") from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise FileNotFoundError(f"{path}: not a file")
    return os.fdopen(descriptor, "rb")
