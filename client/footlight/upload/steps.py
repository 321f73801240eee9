"""What an upload says to the server, step by step, also when a step fails. Knows no connection and no clock."""

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any

from footlight.errors import (
    DeadlineError,
    DigestMismatchError,
    FootlightError,
    ServerUnavailableError,
    WrongOffsetError,
)
from footlight.upload.bundle import LARGEST_SMALL, Blob, Bundle, batches, groups
from footlight.v1 import blob_service_pb2

# [digests] In one question; [bytes] in one message: what the protocol allows.
_MOST_DIGESTS = 10_000
_CHUNK = 512 << 10
# [tries] Of one step that gets nothing further, and the pauses between them [s]: a server is away for half a minute.
_TRIES = 16
_FIRST_PAUSE = 0.1
_LONGEST_PAUSE = 3.0
# [bytes / s] A slower line is as good as none. [s] For a step that sends next to nothing.
_SLOWEST = 64 << 10
_SHORTEST = 60.0

# [bytes] That the server has, and that there are.
Told = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Ask:
    """Call a method with one message; the answer is the response."""

    method: str
    request: Any
    timeout: float = _SHORTEST


@dataclass(frozen=True, slots=True)
class Write:
    """Send a blob from `offset` [bytes] on."""

    blob: Blob
    offset: int
    told: Callable[[int], None]

    @property
    def timeout(self) -> float:
        """[s] That this may take."""
        return _SHORTEST + (self.blob.size - self.offset) / _SLOWEST

    def requests(self) -> Iterator[blob_service_pb2.WriteBlobRequest]:
        """The messages; after each that was taken `told` hears where the upload stands [bytes]."""
        offset = self.offset
        yield blob_service_pb2.WriteBlobRequest(digest=self.blob.digest, offset=offset)
        for piece in self.blob.pieces(offset, _CHUNK):
            yield blob_service_pb2.WriteBlobRequest(offset=offset, data=piece)
            offset += len(piece)
            self.told(offset)


@dataclass(frozen=True, slots=True)
class Wait:
    """Do nothing for so long [s]."""

    seconds: float


Step = Ask | Write | Wait
# Is sent the answers, has the errors thrown into it.
Steps = Generator[Step, Any, None]


def upload_steps(bundle: Bundle, told: Told) -> Steps:
    """Bring to the server what it does not have of a bundle. Raises FootlightError if that cannot be done.

    A server that does not answer at first is not waited for; one that goes away later is, for half a minute.
    """
    blobs = [*bundle.blobs, bundle.blob]
    total = sum(blob.size for blob in blobs)
    missing: set[str] = set()
    for count, group in enumerate(groups(blobs, _MOST_DIGESTS)):
        ask = Ask(
            "FindMissingBlobs",
            blob_service_pb2.FindMissingBlobsRequest(digests=[blob.digest for blob in group]),
        )
        answer = yield from (_persistently(ask) if count else _once(ask))
        missing.update(digest.sha256 for digest in answer.missing)
    done = sum(blob.size for blob in blobs if blob.sha256 not in missing)
    told(done, total)
    wanted = [blob for blob in blobs if blob.sha256 in missing]
    for batch in batches(blob for blob in wanted if blob.size <= LARGEST_SMALL):
        request = blob_service_pb2.UploadBlobsRequest()
        for blob in batch:
            request.blobs.add(digest=blob.digest, data=blob.read())
        yield from _persistently(Ask("UploadBlobs", request))
        done += sum(blob.size for blob in batch)
        told(done, total)
    for blob in wanted:
        if blob.size > LARGEST_SMALL:
            base = done
            yield from _write(blob, lambda offset, base=base: told(base + offset, total))  # type: ignore[misc]
            done += blob.size
            told(done, total)


def _write(blob: Blob, told: Callable[[int], None]) -> Steps:
    """Send one large blob, from wherever an earlier try has left it."""
    ask = Ask("GetUpload", blob_service_pb2.GetUploadRequest(digest=blob.digest))
    failures, furthest, damaged = 0, 0, False
    while True:
        standing = yield from _persistently(ask)
        if standing.complete:
            return
        if standing.offset > furthest:
            failures, furthest = 0, standing.offset
        try:
            yield Write(blob, standing.offset, told)
        except DigestMismatchError:
            if damaged:
                raise
            damaged, furthest = True, 0  # once it may be the line, or what an earlier try has left
        except (ServerUnavailableError, DeadlineError, WrongOffsetError) as error:
            failures += 1
            yield Wait(_pause(failures, error))
        else:
            return


def _once(ask: Ask) -> Generator[Step, Any, Any]:
    return (yield ask)


def _persistently(ask: Ask) -> Generator[Step, Any, Any]:
    """The answer, although the server may be away for a while."""
    failures = 0
    while True:
        try:
            return (yield ask)
        except (ServerUnavailableError, DeadlineError) as error:
            failures += 1
            pause = _pause(failures, error)
        yield Wait(pause)


def _pause(failures: int, error: FootlightError) -> float:
    """[s] Before the next try. Raises the error if there is none."""
    if failures >= _TRIES:
        raise error
    return float(min(_FIRST_PAUSE * 2 ** (failures - 1), _LONGEST_PAUSE))
