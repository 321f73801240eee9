"""Files by content, and the bundle that they make up."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from footlight.v1 import blob_service_pb2, render_pb2

# [bytes] Read at a time.
_PIECE = 1 << 20
# What the protocol allows in one UploadBlobs: [blobs], and [bytes] together, less what it takes to say so.
_MOST_BLOBS = 1000
_MOST_BYTES = 700 << 10
# [bytes] Beyond this a blob is sent alone, in pieces, and an upload that breaks is taken up where it broke.
LARGEST_SMALL = 256 << 10


@dataclass(frozen=True, slots=True)
class BundleRef:
    """An uploaded stage. `digest` and `stage_path` are for the fields of a RenderSpec.

    `unresolved` are the references of the stage that led nowhere; the render will report them.
    """

    digest: str
    stage_path: str
    unresolved: tuple[str, ...] = ()

    def into(self, spec: render_pb2.RenderSpec) -> None:
        """Have the spec mean the uploaded stage."""
        spec.bundle = self.digest
        spec.stage_path = self.stage_path


@dataclass(frozen=True, slots=True)
class Blob:
    """Bytes under their name, in a file or at hand; `size` [bytes]."""

    sha256: str
    size: int
    source: Path | bytes

    @property
    def digest(self) -> blob_service_pb2.Digest:
        """As the protocol names it."""
        return blob_service_pb2.Digest(sha256=self.sha256, size_bytes=self.size)

    def read(self) -> bytes:
        """All of it. Raises OSError."""
        return self.source if isinstance(self.source, bytes) else self.source.read_bytes()

    def pieces(self, offset: int, size: int) -> Iterator[bytes]:
        """From `offset` [bytes] on, in pieces of at most `size` [bytes]. Raises OSError."""
        if isinstance(self.source, bytes):
            yield from (self.source[at : at + size] for at in range(offset, self.size, size))
            return
        with self.source.open("rb") as file:
            file.seek(offset)
            while piece := file.read(size):
                yield piece


@dataclass(frozen=True, slots=True)
class Bundle:
    """`blob` lists the files; `blobs` are their contents, each once."""

    blob: Blob
    blobs: tuple[Blob, ...]

    @property
    def digest(self) -> str:
        """As in RenderSpec.bundle."""
        return f"{self.blob.sha256}/{self.blob.size}"


def make_bundle(root: Path) -> Bundle:
    """The bundle of all files below a directory; the same files make the same bundle. Raises OSError."""
    message = blob_service_pb2.Bundle()
    blobs: dict[str, Blob] = {}
    for path in sorted(path for path in root.rglob("*") if path.is_file()):
        blob = _blob_of_file(path)
        blobs.setdefault(blob.sha256, blob)
        message.files.add(path=path.relative_to(root).as_posix(), digest=blob.digest)
    data = message.SerializeToString(deterministic=True)
    return Bundle(Blob(hashlib.sha256(data).hexdigest(), len(data), data), tuple(blobs.values()))


def batches(blobs: Iterable[Blob]) -> Iterator[list[Blob]]:
    """Small blobs in groups that fit into one UploadBlobs."""
    batch: list[Blob] = []
    size = 0
    for blob in blobs:
        if batch and (len(batch) == _MOST_BLOBS or size + blob.size > _MOST_BYTES):
            yield batch
            batch, size = [], 0
        batch.append(blob)
        size += blob.size
    if batch:
        yield batch


def groups(blobs: Sequence[Blob], size: int) -> Iterator[list[Blob]]:
    """At most `size` blobs at a time."""
    rest = iter(blobs)
    while group := list(islice(rest, size)):
        yield group


def _blob_of_file(path: Path) -> Blob:
    state, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            state.update(piece)
            size += len(piece)
    return Blob(state.hexdigest(), size, path)
