"""Blobs: bytes that are kept under their digest."""

import asyncio
import os
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from footlight_server.blobs.digest import Digest, digest_of
from footlight_server.blobs.durable import seal, settle
from footlight_server.blobs.ledger import FILE_COST, Ledger
from footlight_server.blobs.uploads import Uploads
from footlight_server.sessions.errors import (
    BlobsMissingError,
    DigestMismatchError,
    StorageError,
    TimeLimitError,
    WrongOffsetError,
)

T = TypeVar("T")

# [threads] For files, so that nothing else waits for them.
_THREADS = 4
# [threads] For small files that are written at the same time.
_WRITERS = 8
# [s] For one step; the longest is to hash again what came before the server was started anew.
PATIENCE = 600.0


@dataclass(frozen=True, slots=True)
class Standing:
    """How far an upload has come. `offset` [bytes]."""

    offset: int
    complete: bool


class BlobStore:
    """The blobs below `root`, which has to be one file system. One process has them.

    `quota_bytes` is what one user may have here, 0 for no limit. `clock` [s since 1970] says when a blob was last asked
    for. The coroutines run in threads of the store's own; methods that block say so.

    What is accepted is on disk before it is said so. Raises StorageError if the disk is full or fails.
    """

    def __init__(self, root: Path, quota_bytes: int = 0, clock: Callable[[], float] = time.time) -> None:
        self._objects = root / "objects"
        self._temporary = root / "temporary"
        self._clock = clock
        self._ledger = Ledger(root / "charges", root / "uploads", quota_bytes)
        self._uploads = Uploads(root / "uploads", self._ledger)
        self._threads = ThreadPoolExecutor(_THREADS, "blobs")
        # For those threads, which wait for it.
        self._disk = ThreadPoolExecutor(_WRITERS, "blob writer")
        # Between a look at when a blob was last asked for and its removal nobody may ask for it.
        self._removal = threading.Lock()

    # --- for clients ---

    async def missing(self, digests: Sequence[Digest]) -> list[Digest]:
        """Those that are not here; those that are, are kept for a day at least from now on."""
        return await self.run(self.missing_now, digests)

    async def write(self, user: str, *blobs: tuple[Digest, bytes]) -> None:
        """Keep whole blobs, all or none. Raises DigestMismatchError, QuotaError."""
        await self.run(self._write, user, blobs)

    async def append(self, user: str, digest: Digest, offset: int, data: bytes) -> bool:
        """Take in a piece of a blob; True if the blob is now whole, checked and kept.

        Bytes that are here already are passed over. Raises WrongOffsetError if some before `offset` [bytes] are not,
        DigestMismatchError if the whole is not what the digest says (what has come is then forgotten), QuotaError.
        """
        return await self.run(self._append, user, digest, offset, data)

    async def resume(self, user: str, digest: Digest) -> Standing:
        """How far this user's upload has come."""
        return await self.run(self._standing, user, digest)

    async def total_bytes(self) -> int:
        """[bytes] Of all blobs."""
        return await self.run(lambda: sum(digest.size for digest in self._kept()))

    # --- for bundles ---

    async def read(self, digest: Digest) -> bytes:
        """What a blob holds. Raises BlobsMissingError."""
        return await self.run(self.read_now, digest)

    def missing_now(self, digests: Sequence[Digest]) -> list[Digest]:
        """As `missing`. Blocks."""
        return [digest for digest in digests if not self._touch(digest)]

    def read_now(self, digest: Digest) -> bytes:
        """As `read`. Blocks."""
        try:
            return self.path(digest).read_bytes()
        except FileNotFoundError:
            raise BlobsMissingError(f"blob {digest} is not here", [str(digest)]) from None

    def path(self, digest: Digest) -> Path:
        """Where a blob is, if it is here: a read-only file."""
        return self._objects / digest.sha256[:2] / digest.file_name

    # --- for the sweep ---

    def remove_unless(self, needed: AbstractSet[Digest], before: float) -> int:
        """Remove blobs that are not needed and were last asked for before [s since 1970]; the bytes freed. Blocks."""
        freed = 0
        for digest in self._kept():
            if digest not in needed:
                freed += self._remove(digest, before)
        return freed

    def remove_damaged(self, digest: Digest) -> None:
        """The blob is not what its digest says any more: away with it, it has to come again. Blocks."""
        self.path(digest).unlink(missing_ok=True)
        self._ledger.forget(digest)

    def drop_partials(self, before: float) -> int:
        """Forget uploads that nobody has added to since [s since 1970]; the bytes freed. Blocks."""
        for path in self._temporary.iterdir() if self._temporary.is_dir() else ():
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < before:
                    path.unlink()
        return self._uploads.drop_older(before)

    # --- its threads ---

    async def run(self, work: Callable[..., T], *arguments: object, patience: float = PATIENCE) -> T:
        """What the work answers, done in a thread of ours. Raises TimeLimitError after `patience` [s]; StorageError."""
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(patience):
                return await loop.run_in_executor(self._threads, lambda: work(*arguments))
        except TimeoutError:
            raise TimeLimitError(f"the file system did not answer for {patience:g} s") from None
        except OSError as error:
            # The words of the system without the path, which is nobody's business.
            raise StorageError(f"the server cannot keep files: {error.strerror or 'its disk failed'}") from error

    def close(self) -> None:
        """Take up no more work."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._disk.shutdown(wait=False)

    # --- blocking ---

    def _has(self, digest: Digest) -> bool:
        try:
            return self.path(digest).stat().st_size == digest.size
        except FileNotFoundError:
            return False

    def _touch(self, digest: Digest) -> bool:
        """The blob is here, and was asked for just now."""
        now = self._clock()
        with self._removal:
            if not self._has(digest):
                return False
            os.utime(self.path(digest), (now, now))
            return True

    def _write(self, user: str, blobs: Sequence[tuple[Digest, bytes]]) -> None:
        for digest, data in blobs:
            if digest_of(data) != digest:
                raise DigestMismatchError(f"{len(data)} bytes came that are not those of {digest}")
        new = {digest: data for digest, data in blobs if not self._touch(digest)}
        cost = sum(digest.size + FILE_COST for digest in new)
        self._ledger.reserve(user, cost)
        self._temporary.mkdir(parents=True, exist_ok=True)
        files = {digest: self._temporary / uuid.uuid4().hex for digest in new}
        try:
            # At the same time, since a file system puts many on disk as fast as one.
            list(self._disk.map(_write_sealed, files.values(), new.values()))
            settle({files[digest]: self.path(digest) for digest in new})
            for digest in new:
                self._ledger.keep(user, digest)
                self._touch(digest)
        except OSError:
            self._ledger.release(user, cost)
            raise
        finally:
            for temporary in files.values():
                temporary.unlink(missing_ok=True)

    def _append(self, user: str, digest: Digest, offset: int, data: bytes) -> bool:
        if self._touch(digest):
            self._uploads.drop(user, digest)
            return True
        if offset == 0:
            self._ledger.check(user, digest.size - self._uploads.size(user, digest))
        try:
            whole = self._uploads.append(user, digest, offset, data)
        except WrongOffsetError:
            if self._touch(digest):  # another client has finished it since we looked
                return True
            raise
        if not whole:
            return False
        self._uploads.finish(user, digest, self.path(digest))
        self._touch(digest)
        return True

    def _standing(self, user: str, digest: Digest) -> Standing:
        if self._touch(digest):
            return Standing(digest.size, complete=True)
        return Standing(self._uploads.size(user, digest), complete=False)

    def _kept(self) -> Iterator[Digest]:
        for folder in sorted(self._objects.iterdir()) if self._objects.is_dir() else ():
            for path in sorted(folder.iterdir()):
                with suppress(ValueError):
                    yield Digest.from_file_name(path.name)

    def _remove(self, digest: Digest, before: float) -> int:
        path = self.path(digest)
        with self._removal, suppress(FileNotFoundError):
            if path.stat().st_mtime >= before:
                return 0
            path.unlink()
        self._ledger.forget(digest)
        return digest.size


def _write_sealed(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    seal(path)
