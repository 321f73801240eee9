"""Uploads a stage over a connection. Once with threads, once with asyncio."""

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import grpc

from footlight.errors import FootlightError, InvalidRequestError, ServerUnavailableError, rpc_errors
from footlight.upload.bundle import Bundle, BundleRef, make_bundle
from footlight.upload.collect import collected
from footlight.upload.steps import Ask, Step, Told, Wait, Write, upload_steps
from footlight.v1 import blob_service_pb2, blob_service_pb2_grpc

Request = blob_service_pb2.WriteBlobRequest


def untold(done: int, total: int) -> None:
    """Nobody wants to hear how far it is."""


def upload_stage(channel: grpc.Channel, address: str, stage: str | os.PathLike[str], told: Told = untold) -> BundleRef:
    """Collect a stage with all it refers to, and upload what the server does not have of it.

    `told(done, total)` hears how many bytes the server has; where an upload broke it may go back. Raises CollectError
    (see footlight.upload.collect), QuotaError, ServerUnavailableError if the server stays away for half a minute.
    """
    with collected(Path(stage)) as found:
        bundle = make_bundle(found.root)
        _send(channel, address, bundle, told)
    return BundleRef(bundle.digest, found.stage_path, found.unresolved)


async def upload_stage_async(
    channel: grpc.aio.Channel, address: str, stage: str | os.PathLike[str], told: Told = untold
) -> BundleRef:
    """`upload_stage` for asyncio; what reads files does so in threads."""
    gathering = collected(Path(stage))
    found = await asyncio.to_thread(gathering.__enter__)
    try:
        bundle = await asyncio.to_thread(make_bundle, found.root)
        await _send_async(channel, address, bundle, told)
    finally:
        await asyncio.to_thread(gathering.__exit__, None, None, None)
    return BundleRef(bundle.digest, found.stage_path, found.unresolved)


def _send(channel: grpc.Channel, address: str, bundle: Bundle, told: Told) -> None:
    stub = blob_service_pb2_grpc.BlobServiceStub(channel)

    def take(step: Step) -> object:
        if isinstance(step, Wait):
            time.sleep(step.seconds)
            return None
        with _errors(address):
            if isinstance(step, Ask):
                return getattr(stub, step.method)(step.request, timeout=step.timeout)
            return stub.WriteBlob(step.requests(), timeout=step.timeout)

    steps = upload_steps(bundle, told)
    try:
        step = next(steps)
        while True:
            try:
                answer = take(step)
            except FootlightError as error:
                step = steps.throw(error)
            else:
                step = steps.send(answer)
    except StopIteration:
        return


async def _send_async(channel: grpc.aio.Channel, address: str, bundle: Bundle, told: Told) -> None:
    stub = blob_service_pb2_grpc.BlobServiceStub(channel)

    async def take(step: Step) -> object:
        if isinstance(step, Wait):
            await asyncio.sleep(step.seconds)
            return None
        with _errors(address):
            if isinstance(step, Ask):
                return await getattr(stub, step.method)(step.request, timeout=step.timeout)
            return await _write(stub, address, step)

    steps = upload_steps(bundle, told)
    try:
        step = next(steps)
        while True:
            try:
                answer = await take(step)
            except FootlightError as error:
                step = steps.throw(error)
            else:
                step = steps.send(answer)
    except StopIteration:
        return


@contextlib.contextmanager
def _errors(address: str) -> Iterator[None]:
    try:
        with rpc_errors(address):
            yield
    except FootlightError as error:
        cause = error.__cause__
        if isinstance(cause, grpc.RpcError) and cause.code() is grpc.StatusCode.UNIMPLEMENTED:
            raise InvalidRequestError(f"the server at {address} takes no uploads; a private one never does") from cause
        raise


async def _write(stub: blob_service_pb2_grpc.BlobServiceStub, address: str, step: Write) -> object:
    try:
        return await stub.WriteBlob(_off_the_loop(step.requests()), timeout=step.timeout)
    except grpc.aio.AioRpcError as error:
        # Where a write meets the end of the stream, grpc.aio may put an INTERNAL of its own, without details, in place
        # of the server's answer (https://github.com/grpc/grpc/issues/36066). Asking how far we are tells what it was.
        if error.code() is grpc.StatusCode.INTERNAL and not error.trailing_metadata():
            raise ServerUnavailableError(f"the upload to {address} broke off: {error.details()}") from error
        raise


async def _off_the_loop(requests: Iterator[Request]) -> AsyncIterator[Request]:
    """The same messages, read in threads."""
    while (request := await asyncio.to_thread(next, requests, None)) is not None:
        yield request
