"""A second name for a file's bytes, as cheaply as the file system allows."""

import errno
import fcntl
import os
import shutil
from contextlib import suppress
from pathlib import Path

from footlight_server.blobs.durable import seal

# ioctl(2) FICLONE: _IOW(0x94, 9, int), linux/fs.h.
_FICLONE = 0x40049409
# What a file system answers that cannot link, or not this file: too many links, another device, not its kind or right.
_NO_LINK = {errno.EMLINK, errno.EXDEV, errno.ENOTSUP, errno.EPERM, errno.EACCES, errno.ENOSYS}
# What it answers when the trouble is another.
_TROUBLE = {errno.ENOSPC, errno.EDQUOT, errno.ENOENT, errno.EEXIST, errno.EIO}


class Placer:
    """Makes read-only regular files that hold what others hold: sharing their blocks, or the file itself, or copied.

    Never symbolic links: asset resolvers take those for the file that they point to. A file system that shares no
    blocks is asked once. Blocks; raises OSError.
    """

    def __init__(self) -> None:
        self._clones = True
        # By file: the copy made of it when it had too many names. It takes the next ones, so that a file that is named
        # a hundred thousand times is not there thousands of times.
        self._copies: dict[Path, Path] = {}

    def place(self, source: Path, path: Path) -> None:
        """Make `path`, which is not there yet."""
        self._clones = self._clones and _clone(source, path)
        if not self._clones and not _link(self._copies.get(source, source), path):
            with source.open("rb") as original, path.open("xb") as copy:
                shutil.copyfileobj(original, copy)
            seal(path)
            self._copies[source] = path


def _clone(source: Path, path: Path) -> bool:
    try:
        with source.open("rb") as original, path.open("xb") as copy:
            fcntl.ioctl(copy.fileno(), _FICLONE, original.fileno())
        seal(path)
    except OSError as error:
        if error.errno in _TROUBLE:
            raise
        with suppress(FileNotFoundError):
            path.unlink()
        return False
    return True


def _link(source: Path, path: Path) -> bool:
    try:
        os.link(source, path)
    except OSError as error:
        if error.errno not in _NO_LINK:
            raise
        return False
    return True
