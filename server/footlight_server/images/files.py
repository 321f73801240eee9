"""What can go wrong with an image file, in words that name it."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from footlight import files


class ImageError(ValueError):
    """An image file cannot be read or written; the message names the file and the reason."""


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """As footlight.files.replacing, but raises ImageError."""
    try:
        with files.replacing(path) as temporary:
            yield temporary
    except OSError as error:
        raise ImageError(f"{path}: cannot be written: {error.strerror}") from error


def why_not_written(path: Path, reason: str) -> str:
    """The message for a write that failed: says so if the disk is full, since codecs seldom do."""
    with contextlib.suppress(OSError):
        disk = os.statvfs(path.parent)
        free = disk.f_bavail * disk.f_frsize
        if free < 1 << 20:
            return f"{path}: cannot be written: no space left on the disk ({free} bytes free)"
    return f"{path}: cannot be written: {reason or 'the file system refused'}"
