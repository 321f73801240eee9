"""Uploads over gRPC: checked, resumed after any break, and each user's own."""

import asyncio
import os
import random
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from footlight.v1 import blob_service_pb2, blob_service_pb2_grpc
from footlight_server.api import auth, blob_service
from footlight_server.api.blob_service import BlobService
from footlight_server.api.server import GrpcServer, Health, Service
from footlight_server.blobs.digest import Digest, digest_of
from footlight_server.blobs.store import BlobStore
from footlight_server.farm.tokens import Scope

DATA = random.Random(2).randbytes(2_000_000)
CHUNK = 512 << 10


class NamedGate(auth.LocalGate):
    """Lets everybody in, as the user that the call says."""

    async def intercept_service(self, continuation: Any, details: grpc.HandlerCallDetails) -> Any:
        users = [value for key, value in details.invocation_metadata if key == "user"]
        gate = auth.LocalGate()
        gate._caller = auth.Caller(users[0] if users else "ann", Scope.SUBMIT)
        return await gate.intercept_service(continuation, details)


@dataclass
class Blobs:
    """What a client of uploads calls, as `user`."""

    stub: blob_service_pb2_grpc.BlobServiceStub
    store: BlobStore

    async def missing(self, *digests: Digest) -> list[str]:
        request = blob_service_pb2.FindMissingBlobsRequest(digests=[message(digest) for digest in digests])
        response = await self.stub.FindMissingBlobs(request, timeout=10)
        return [digest.sha256 for digest in response.missing]

    async def upload(self, *blobs: tuple[Digest, bytes], user: str = "ann") -> None:
        request = blob_service_pb2.UploadBlobsRequest()
        for digest, data in blobs:
            request.blobs.add(digest=message(digest), data=data)
        await self.stub.UploadBlobs(request, timeout=10, metadata=(("user", user),))

    async def write(self, requests: Iterator[blob_service_pb2.WriteBlobRequest], user: str = "ann") -> None:
        await self.stub.WriteBlob(requests, timeout=20, metadata=(("user", user),))

    async def standing(self, digest: Digest, user: str = "ann") -> tuple[int, bool]:
        request = blob_service_pb2.GetUploadRequest(digest=message(digest))
        response = await self.stub.GetUpload(request, timeout=10, metadata=(("user", user),))
        return response.offset, response.complete

    async def break_off(self, data: bytes, chunks: int, user: str = "ann") -> int:
        """Send so many pieces and vanish; where the upload stands then."""
        digest = digest_of(data)
        call = self.stub.WriteBlob(timeout=20, metadata=(("user", user),))
        for request in list(pieces(data))[: chunks + 1]:
            await call.write(request)
        async with asyncio.timeout(10):
            while (await self.standing(digest, user))[0] < chunks * CHUNK:
                await asyncio.sleep(0.01)
        call.cancel()
        return (await self.standing(digest, user))[0]


def message(digest: Digest) -> blob_service_pb2.Digest:
    return blob_service_pb2.Digest(sha256=digest.sha256, size_bytes=digest.size)


def pieces(data: bytes, offset: int = 0, size: int = CHUNK) -> Iterator[blob_service_pb2.WriteBlobRequest]:
    """The messages that upload `data` from `offset` on."""
    yield blob_service_pb2.WriteBlobRequest(digest=message(digest_of(data)), offset=offset)
    for at in range(offset, len(data), size):
        yield blob_service_pb2.WriteBlobRequest(offset=at, data=data[at : at + size])


def reason(error: grpc.aio.AioRpcError) -> str:
    """ErrorInfo's reason."""
    info = error_details_pb2.ErrorInfo()
    for detail in rpc_status.from_call(error).details:
        detail.Unpack(info)
    return str(info.reason)


@pytest.fixture
async def blobs(tmp_path: Path) -> AsyncIterator[Blobs]:
    store = BlobStore(tmp_path / "blobs", quota_bytes=10_000_000)
    add = blob_service_pb2_grpc.add_BlobServiceServicer_to_server
    service = Service("footlight.v1.BlobService", BlobService(store), add)
    server = GrpcServer([service], Health([service]), [NamedGate()])
    address = await server.start(f"unix:{tmp_path}/socket")
    try:
        async with grpc.aio.insecure_channel(address) as channel:
            yield Blobs(blob_service_pb2_grpc.BlobServiceStub(channel), store)
    finally:
        await server.stop(1)
        store.close()


async def test_small_blobs_go_in_one_call(blobs: Blobs) -> None:
    wanted = [(digest_of(data), data) for data in (b"a", b"b", b"", b"x" * 700_000)]
    assert len(await blobs.missing(*(digest for digest, _ in wanted))) == 4
    await blobs.upload(*wanted)
    await blobs.upload(*wanted)
    assert await blobs.missing(*(digest for digest, _ in wanted)) == []
    for digest, data in wanted:
        assert await blobs.store.read(digest) == data


async def test_a_large_blob_comes_in_pieces(blobs: Blobs) -> None:
    await blobs.write(pieces(DATA))
    assert await blobs.standing(digest_of(DATA)) == (len(DATA), True)
    assert await blobs.store.read(digest_of(DATA)) == DATA


@pytest.mark.parametrize("chunks", [1, 3])
async def test_an_upload_goes_on_where_the_stream_broke(blobs: Blobs, chunks: int) -> None:
    offset = await blobs.break_off(DATA, chunks)
    assert offset == chunks * CHUNK
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await blobs.write(pieces(DATA, offset + 1))
    assert (caught.value.code(), reason(caught.value)) == (grpc.StatusCode.OUT_OF_RANGE, "WRONG_OFFSET")
    await blobs.write(pieces(DATA, offset))
    assert await blobs.store.read(digest_of(DATA)) == DATA


async def test_a_stream_that_ends_early_is_told_where_it_stands(blobs: Blobs) -> None:
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await blobs.write(iter(list(pieces(DATA))[:2]))
    assert reason(caught.value) == "WRONG_OFFSET"
    assert await blobs.standing(digest_of(DATA)) == (CHUNK, False)


async def test_writers_at_the_same_time_all_end_well(blobs: Blobs) -> None:
    users = ("ann", "ann", "bob", "cid")
    await asyncio.gather(*(blobs.write(pieces(DATA, size=100_000 + 9999 * i), user) for i, user in enumerate(users)))
    assert await blobs.store.read(digest_of(DATA)) == DATA


async def test_whoever_is_second_is_answered_at_once(blobs: Blobs) -> None:
    call = blobs.stub.WriteBlob(timeout=20, metadata=(("user", "bob"),))
    for request in list(pieces(DATA))[:2]:
        await call.write(request)
    await blobs.write(pieces(DATA))
    await call.write(list(pieces(DATA))[2])
    async with asyncio.timeout(5):
        await call  # it has not closed its half


async def test_uploads_are_each_users_own(blobs: Blobs) -> None:
    await blobs.break_off(DATA, 2)
    assert await blobs.standing(digest_of(DATA), "eve") == (0, False)
    spoiled = blob_service_pb2.WriteBlobRequest(digest=message(digest_of(DATA)), data=b"?" * CHUNK)
    with pytest.raises(grpc.aio.AioRpcError):
        await blobs.write(iter([spoiled]), "eve")
    await blobs.write(pieces(DATA, 2 * CHUNK))
    assert await blobs.store.read(digest_of(DATA)) == DATA


async def test_what_is_not_what_it_says_is_refused(blobs: Blobs) -> None:
    digest = digest_of(DATA)
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await blobs.upload((digest_of(b"a"), b"a"), (digest_of(b"b"), b"c"))
    assert (caught.value.code(), reason(caught.value)) == (grpc.StatusCode.INVALID_ARGUMENT, "DIGEST_MISMATCH")
    spoiled = DATA[:-1] + bytes([DATA[-1] ^ 1])
    requests = [blob_service_pb2.WriteBlobRequest(digest=message(digest)), *list(pieces(spoiled))[1:]]
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await blobs.write(iter(requests))
    assert reason(caught.value) == "DIGEST_MISMATCH"
    assert await blobs.standing(digest) == (0, False)
    await blobs.write(pieces(DATA))


@pytest.mark.parametrize(
    ("sha256", "size"), [("", 0), ("A" * 64, 1), ("0" * 63, 1), ("../" * 21 + "0", 1), ("0" * 64, 1 << 41)]
)
async def test_fields_at_fault_are_named(blobs: Blobs, sha256: str, size: int) -> None:
    wrong = blob_service_pb2.Digest(sha256=sha256, size_bytes=size)
    find = blob_service_pb2.FindMissingBlobsRequest(digests=[message(digest_of(b"")), wrong])
    upload = blob_service_pb2.UploadBlobsRequest(blobs=[blob_service_pb2.UploadedBlob(digest=wrong)])
    calls = {
        "digests[1]": blobs.stub.FindMissingBlobs(find, timeout=10),
        "blobs[0].digest": blobs.stub.UploadBlobs(upload, timeout=10),
        "digest": blobs.stub.GetUpload(blob_service_pb2.GetUploadRequest(digest=wrong), timeout=10),
    }
    for field, call in calls.items():
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await call
        assert reason(caught.value) == "INVALID_FIELD"
        assert caught.value.details().startswith(f"{field}: ")
    with pytest.raises(grpc.aio.AioRpcError, match="digest: "):
        await blobs.write(iter([blob_service_pb2.WriteBlobRequest(digest=wrong)]))


async def test_huge_requests_are_refused(blobs: Blobs) -> None:
    many = [message(digest_of(b""))] * 10_001
    with pytest.raises(grpc.aio.AioRpcError, match="at most 10000"):
        await blobs.stub.FindMissingBlobs(blob_service_pb2.FindMissingBlobsRequest(digests=many), timeout=10)
    largest = message(Digest("0" * 64, 1 << 40))
    request = blob_service_pb2.FindMissingBlobsRequest(digests=[largest] * 10_000)
    assert request.ByteSize() < 1 << 20, "the largest question that is allowed is a message that is allowed"
    assert len((await blobs.stub.FindMissingBlobs(request, timeout=10)).missing) == 10_000
    with pytest.raises(grpc.aio.AioRpcError, match="at most 1000"):
        await blobs.upload(*[(digest_of(b""), b"")] * 1001)
    large = bytes(500_000)
    with pytest.raises(grpc.aio.AioRpcError, match="921600"):
        await blobs.upload((digest_of(large), large), (digest_of(large[1:]), large[1:]))
    with pytest.raises(grpc.aio.AioRpcError, match="at most 524288"):
        await blobs.write(pieces(DATA, size=CHUNK + 1))


async def test_a_stream_has_to_begin_with_a_digest(blobs: Blobs) -> None:
    for requests in ([], [blob_service_pb2.WriteBlobRequest(data=b"a")]):
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await blobs.write(iter(requests))
        assert reason(caught.value) == "INVALID_FIELD"


async def test_a_silent_stream_is_cut_off(blobs: Blobs, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blob_service, "_PATIENCE", 0.2)
    call = blobs.stub.WriteBlob(timeout=20)
    await call.write(next(pieces(DATA)))
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await call
    assert reason(caught.value) == "TIME_LIMIT"


async def test_more_than_the_quota_is_refused(blobs: Blobs) -> None:
    large = Digest("0" * 64, 20_000_000)
    request = blob_service_pb2.WriteBlobRequest(digest=message(large), data=b"the first of many")
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await blobs.write(iter([request]))
    assert (caught.value.code(), reason(caught.value)) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "QUOTA")


async def test_the_loop_is_free_while_a_slow_disk_writes(blobs: Blobs, monkeypatch: pytest.MonkeyPatch) -> None:
    longest, slow = 0.0, 0.5
    monkeypatch.setattr(os, "fsync", lambda _: time.sleep(slow))

    async def watch() -> None:
        nonlocal longest
        loop = asyncio.get_running_loop()
        while True:
            before = loop.time()
            await asyncio.sleep(0.005)
            longest = max(longest, loop.time() - before)

    watching = asyncio.create_task(watch())
    await asyncio.gather(*(blobs.write(pieces(DATA[i:])) for i in range(3)))
    watching.cancel()
    assert longest < slow
