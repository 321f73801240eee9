"""Files that are either whole or not there: written under a temporary name, synced, renamed."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


class ImageError(ValueError):
    """An image file cannot be read or written; the message names the file and the reason."""


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that becomes `path` when the block ends well, else vanishes.

    It keeps the suffix, by which OpenImageIO chooses the format. Raises ImageError if the directory is not
    there or the file cannot be made, synced or renamed.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise ImageError(f"{path}: cannot be written: {error.strerror}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise ImageError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        temporary.unlink(missing_ok=True)


def why_not_written(path: Path, reason: str) -> str:
    """The message for a write that failed: says so if the disk is full, since codecs seldom do."""
    with contextlib.suppress(OSError):
        disk = os.statvfs(path.parent)
        free = disk.f_bavail * disk.f_frsize
        if free < 1 << 20:
            return f"{path}: cannot be written: no space left on the disk ({free} bytes free)"
    return f"{path}: cannot be written: {reason or 'the file system refused'}"
