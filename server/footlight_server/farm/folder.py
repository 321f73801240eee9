"""The data folder: there, and nobody else's to look into."""

import os
import stat
from pathlib import Path


def own_folder(path: Path) -> None:
    """Make the folder if it is not there. Raises ValueError if others can reach into it, OSError if it cannot be made.

    A folder that is there already is refused and not mended: `--data /tmp` is a slip, not a wish.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.is_dir():
        raise ValueError(f"--data {path}: not a directory")
    path.mkdir(mode=0o700, exist_ok=True)
    found = path.stat()
    if found.st_uid != os.getuid():
        raise ValueError(f"--data {path}: belongs to user {found.st_uid}, and the server runs as {os.getuid()}")
    if found.st_mode & 0o077:
        raise ValueError(
            f"--data {path}: others can look into it (its mode is {stat.S_IMODE(found.st_mode):04o}); chmod 700 it, "
            "or name one that is not there yet"
        )
    if not os.access(path, os.W_OK | os.X_OK):
        raise ValueError(f"--data {path}: cannot be written to")
