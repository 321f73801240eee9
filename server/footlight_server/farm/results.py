"""The steps on disk from what a worker made to what is at its place: synced, renamed, its directory synced."""

import contextlib
import errno
import hashlib
import os
import shutil
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from footlight import files
from footlight_server.blobs.durable import make_directory, sync_directory

# [bytes] Read at a time.
_CHUNK = 1 << 20


@dataclass(frozen=True, slots=True)
class Sealed:
    """A file whose bytes are on the disk: lower-case hexadecimal SHA-256, and [bytes]."""

    sha256: str
    size_bytes: int


def seal(path: Path, mode: int | None = None) -> Sealed:
    """Sync a file that a worker made and take its digest. Blocks. Raises OSError.

    `mode`: the permissions it gets; one that another user made, on another machine, stays as that user made it.
    """
    digest = hashlib.sha256()
    size = 0
    with _open_made(path) as file:
        if mode is not None:
            with contextlib.suppress(PermissionError):
                os.fchmod(file.fileno(), mode)
        while data := file.read(_CHUNK):
            digest.update(data)
            size += len(data)
        os.fsync(file.fileno())
    return Sealed(digest.hexdigest(), size)


def put_in_place(made: Path, target: Path) -> None:
    """Rename within one disk, and sync the directory, so that the name outlives a loss of power. Blocks.

    Raises OSError.
    """
    made.replace(target)
    sync_directory(target.parent)


def copy_in_place(made: Path, target: Path) -> None:
    """The same across disks, for small files: copied beside the target first. Makes its directory. Blocks."""
    make_directory(target.parent)
    with _open_made(made) as source, files.replacing(target) as temporary, temporary.open("wb") as copy:
        shutil.copyfileobj(source, copy, _CHUNK)


def _open_made(path: Path) -> BinaryIO:
    """A file of a worker that is not trusted: what is at its path has to be a file of its own, not a way to others."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink != 1:
        os.close(descriptor)
        raise OSError(errno.EINVAL, "what the worker made is no plain file", str(path))
    return os.fdopen(descriptor, "rb")


def holds(path: Path, sha256: str) -> bool:
    """The file is there and has this digest. Blocks."""
    with contextlib.suppress(OSError):
        return seal(path).sha256 == sha256
    return False


def why(error: OSError, path: Path) -> str:
    """The sentence for a result that could not be put at its path."""
    return f"{path}: cannot be written: {error.strerror or str(error) or 'the file system does not answer'}"
