"""What has come of blobs that are on the way: appended to, resumed, checked when whole."""

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from footlight_server.blobs.digest import Digest
from footlight_server.blobs.durable import seal, settle
from footlight_server.blobs.ledger import FILE_COST, Ledger, user_folder
from footlight_server.sessions.errors import DigestMismatchError, QuotaError, WrongOffsetError

# [files] That one user may have on the way.
MOST_UPLOADS = 1000
# [bytes] After so many the disk is asked to keep up, so that the end of a large upload does not wait for all of it.
_SYNC_EVERY = 64 << 20
# [bytes] Read at a time.
_PIECE = 1 << 20


@dataclass(slots=True)
class _Upload:
    """One partial file; `size` [bytes] of it are hashed. Held with its lock."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    hashed: "hashlib._Hash" = field(default_factory=hashlib.sha256)
    size: int = 0


class Uploads:
    """Partial files, one for each user and digest. Thread-safe; blocks on the file system.

    Two clients of one user that send the same blob write the same file: what is there already is passed over, so both
    go on at the pace of whichever is ahead.
    """

    def __init__(self, root: Path, ledger: Ledger) -> None:
        self._root = root
        self._ledger = ledger
        self._lock = threading.Lock()
        # By the user's folder.
        self._uploads: dict[tuple[str, Digest], _Upload] = {}

    def size(self, user: str, digest: Digest) -> int:
        """[bytes] That have come."""
        try:
            return self._path(user_folder(user), digest).stat().st_size
        except FileNotFoundError:
            return 0

    def append(self, user: str, digest: Digest, offset: int, data: bytes) -> bool:
        """Take bytes in; True if all have come.

        Raises WrongOffsetError if bytes before `offset` are missing, DigestMismatchError if they go beyond the end,
        QuotaError, OSError; the file is then as it was.
        """
        if offset + len(data) > digest.size:
            raise DigestMismatchError(f"{offset + len(data)} bytes came for {digest}")
        folder = user_folder(user)
        with self._held(folder, digest) as upload:
            if offset > upload.size:
                raise WrongOffsetError(f"the upload stands at {upload.size}, not at {offset}")
            new = data[upload.size - offset :]
            if new or not self._path(folder, digest).exists():
                self._write(user, upload, self._path(folder, digest), new)
            return upload.size == digest.size

    def finish(self, user: str, digest: Digest, path: Path) -> None:
        """Give the blob its place `path`. Raises DigestMismatchError, and begins anew, if it is not what it should be.

        Does nothing if another client of this user has finished it.
        """
        folder = user_folder(user)
        with self._held(folder, digest) as upload:
            partial = self._path(folder, digest)
            if not partial.exists():
                return
            if upload.hashed.hexdigest() != digest.sha256 or upload.size != digest.size:
                self._drop(folder, digest)
                raise DigestMismatchError(f"the bytes that came are not those of {digest}; send them again")
            seal(partial)
            settle({partial: path})
            self._ledger.keep(user, digest)
            self._close(folder, digest)

    def drop(self, user: str, digest: Digest) -> None:
        """Forget what has come, if anything has."""
        folder = user_folder(user)
        if self._path(folder, digest).exists():
            with self._held(folder, digest):
                self._drop(folder, digest)

    def drop_older(self, before: float) -> int:
        """Forget what nobody has added to since `before` [s since 1970]; the bytes freed."""
        freed = 0
        for path in self._partials():
            with suppress(FileNotFoundError, ValueError):
                digest = Digest.from_file_name(path.name)
                if path.stat().st_mtime < before:
                    with self._held(path.parent.name, digest):
                        freed += self._drop(path.parent.name, digest)
        return freed

    def _write(self, user: str, upload: _Upload, path: Path, new: bytes) -> None:
        """Append what is new. On failure the file is as long as before."""
        begins = not path.exists()
        if begins:
            path.parent.mkdir(parents=True, exist_ok=True)
            if sum(1 for _ in path.parent.iterdir()) >= MOST_UPLOADS:
                raise QuotaError(f"{MOST_UPLOADS} files are on the way; that is the most")
        cost = len(new) + (FILE_COST if begins else 0)
        self._ledger.reserve(user, cost)
        try:
            with path.open("ab", buffering=0) as file:
                _write_all(file.fileno(), new)
                if upload.size // _SYNC_EVERY != (upload.size + len(new)) // _SYNC_EVERY:
                    os.fdatasync(file.fileno())
        except OSError:
            self._ledger.release(user, cost)
            with suppress(OSError):
                path.unlink() if begins else os.truncate(path, upload.size)
            raise
        upload.hashed.update(new)
        upload.size += len(new)

    def _drop(self, folder: str, digest: Digest) -> int:
        """Forget one that is held; the bytes freed."""
        path = self._path(folder, digest)
        size = path.stat().st_size
        path.unlink()
        self._ledger.forget_partial(folder, size)
        self._close(folder, digest)
        return size

    @contextmanager
    def _held(self, folder: str, digest: Digest) -> Iterator[_Upload]:
        """The upload, for this thread alone, with all that its file holds hashed."""
        key = (folder, digest)
        while True:
            with self._lock:
                upload = self._uploads.setdefault(key, _Upload())
            with upload.lock:
                if self._uploads.get(key) is not upload:
                    continue  # it was finished or dropped while we waited
                self._read(upload, self._path(folder, digest))
                try:
                    yield upload
                finally:
                    if not upload.size:  # nothing stays of what was refused
                        with self._lock:
                            if self._uploads.get(key) is upload:
                                del self._uploads[key]
                return

    @staticmethod
    def _read(upload: _Upload, path: Path) -> None:
        """Hash what an earlier server has left."""
        size = path.stat().st_size if path.exists() else 0
        if size == upload.size:
            return
        upload.hashed, upload.size = hashlib.sha256(), 0
        if size:
            with path.open("rb") as file:
                while piece := file.read(_PIECE):
                    upload.hashed.update(piece)
                    upload.size += len(piece)

    def _close(self, folder: str, digest: Digest) -> None:
        with self._lock:
            self._uploads.pop((folder, digest), None)

    def _path(self, folder: str, digest: Digest) -> Path:
        return self._root / folder / digest.file_name

    def _partials(self) -> list[Path]:
        with suppress(FileNotFoundError):
            return [path for folder in self._root.iterdir() if folder.is_dir() for path in folder.iterdir()]
        return []


def _write_all(handle: int, data: bytes) -> None:
    """A write may take less than it was given when the disk is nearly full."""
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]
