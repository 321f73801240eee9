"""Files that survive a power failure once they have their name."""

import os
from collections.abc import Mapping
from pathlib import Path

# For everybody to read and nobody to change.
READ_ONLY = 0o444


def sync_directory(path: Path) -> None:
    """Have the names in a directory on disk."""
    handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_directory(path: Path) -> None:
    """A directory and its parents, whose names are on disk."""
    if path.is_dir():
        return
    make_directory(path.parent)
    path.mkdir(exist_ok=True)
    sync_directory(path.parent)


def seal(temporary: Path) -> None:
    """A finished file is read-only, and what it holds is on disk."""
    handle = os.open(temporary, os.O_RDONLY)
    try:
        os.fchmod(handle, READ_ONLY)
        os.fsync(handle)
    finally:
        os.close(handle)


def settle(files: Mapping[Path, Path]) -> None:
    """Give sealed files, by where they are, their names, and have those on disk. Replaces what has a name."""
    directories = {path.parent for path in files.values()}
    for directory in directories:
        make_directory(directory)
    for temporary, path in files.items():
        temporary.replace(path)
    for directory in directories:
        sync_directory(directory)
