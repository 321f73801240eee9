"""BlobService: the handlers of uploads; each checks, asks the store, answers."""

import asyncio
from collections.abc import AsyncIterator, Iterator, Sequence

import grpc

from footlight.v1 import blob_service_pb2, blob_service_pb2_grpc
from footlight_server.api.auth import caller
from footlight_server.api.errors import told
from footlight_server.blobs.digest import Digest
from footlight_server.blobs.store import BlobStore
from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError, TimeLimitError, WrongOffsetError

# As the protocol says: [digests] in one question; [blobs] in one call, and [bytes] of them; [bytes] in one message.
_MOST_DIGESTS = 10_000
_MOST_BLOBS = 1000
_MOST_BYTES = 900 << 10
_LARGEST_CHUNK = 512 << 10
# [s] Without a message in WriteBlob.
_PATIENCE = 30.0


class BlobService(blob_service_pb2_grpc.BlobServiceServicer):  # type: ignore[misc]
    """Knows gRPC and the store. Uploads are their caller's: nobody else can go on with them or spoil them."""

    def __init__(self, blobs: BlobStore) -> None:
        self._blobs = blobs

    @told
    async def FindMissingBlobs(
        self, request: blob_service_pb2.FindMissingBlobsRequest, context: grpc.aio.ServicerContext
    ) -> blob_service_pb2.FindMissingBlobsResponse:
        """Those that have to be uploaded."""
        missing = await self._blobs.missing(list(_digests(request.digests)))
        return blob_service_pb2.FindMissingBlobsResponse(missing=[_message(digest) for digest in missing])

    @told
    async def UploadBlobs(
        self, request: blob_service_pb2.UploadBlobsRequest, context: grpc.aio.ServicerContext
    ) -> blob_service_pb2.UploadBlobsResponse:
        """Keep small ones."""
        total = sum(len(blob.data) for blob in request.blobs)
        if len(request.blobs) > _MOST_BLOBS or total > _MOST_BYTES:
            most = f"at most {_MOST_BLOBS} of {_MOST_BYTES} bytes together are allowed"
            raise _invalid("blobs", f"{len(request.blobs)} of {total} bytes: {most}")
        user = caller(context).user
        digests = [_digest(blob.digest, f"blobs[{index}].digest") for index, blob in enumerate(request.blobs)]
        await self._blobs.write(user, *zip(digests, (blob.data for blob in request.blobs), strict=True))
        return blob_service_pb2.UploadBlobsResponse()

    @told
    async def WriteBlob(
        self, requests: AsyncIterator[blob_service_pb2.WriteBlobRequest], context: grpc.aio.ServicerContext
    ) -> blob_service_pb2.WriteBlobResponse:
        """Take a large one in, piece by piece."""
        user = caller(context).user
        request = await _next(requests)
        if request is None or not request.HasField("digest"):
            raise _invalid("digest", "has to come first")
        digest = _digest(request.digest, "digest")
        stands = request.offset
        while request is not None:
            if len(request.data) > _LARGEST_CHUNK:
                raise _invalid("data", f"{len(request.data)} bytes: at most {_LARGEST_CHUNK} are allowed")
            if await self._blobs.append(user, digest, request.offset, request.data):
                return blob_service_pb2.WriteBlobResponse()
            stands = request.offset + len(request.data)
            request = await _next(requests)
        raise WrongOffsetError(f"the stream ended at {stands} of {digest.size} bytes")

    @told
    async def GetUpload(
        self, request: blob_service_pb2.GetUploadRequest, context: grpc.aio.ServicerContext
    ) -> blob_service_pb2.GetUploadResponse:
        """Where to go on."""
        standing = await self._blobs.resume(caller(context).user, _digest(request.digest, "digest"))
        return blob_service_pb2.GetUploadResponse(offset=standing.offset, complete=standing.complete)


async def _next(requests: AsyncIterator[blob_service_pb2.WriteBlobRequest]) -> blob_service_pb2.WriteBlobRequest | None:
    """The next message, None at the end."""
    try:
        async with asyncio.timeout(_PATIENCE):
            return await anext(requests, None)
    except TimeoutError:
        raise TimeLimitError(f"nothing came for {_PATIENCE:g} s") from None


def _digests(messages: Sequence[blob_service_pb2.Digest]) -> Iterator[Digest]:
    if len(messages) > _MOST_DIGESTS:
        raise _invalid("digests", f"{len(messages)}: at most {_MOST_DIGESTS} are allowed")
    for index, message in enumerate(messages):
        yield _digest(message, f"digests[{index}]")


def _digest(message: blob_service_pb2.Digest, field: str) -> Digest:
    try:
        return Digest(message.sha256, message.size_bytes)
    except ValueError as error:
        raise _invalid(field, str(error)) from None


def _message(digest: Digest) -> blob_service_pb2.Digest:
    return blob_service_pb2.Digest(sha256=digest.sha256, size_bytes=digest.size)


def _invalid(field: str, description: str) -> InvalidFieldsError:
    return InvalidFieldsError([FieldViolation(field, description)])
