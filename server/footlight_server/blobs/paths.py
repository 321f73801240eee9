"""Which relative paths a bundle may hold."""

import re
import unicodedata
from collections.abc import Iterable

# Said in the protocol: [bytes] of a path, and of a part of it; [parts] of a path; [directories] of a bundle.
LONGEST_PATH = 1024
LONGEST_PART = 255
MOST_PARTS = 64
MOST_DIRECTORIES = 10_000

# Unicode's categories of control characters and of what breaks lines.
_CONTROL = {"Cc", "Zl", "Zp"}
_DRIVE = re.compile(r"[A-Za-z]:")
# Names that are devices on Windows, with any suffix.
_DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³]|conin\$|conout\$)\s*(\..*)?", re.IGNORECASE | re.DOTALL)


def path_fault(path: str) -> str | None:
    """What is wrong with a path, or None."""
    parts = path.split("/")
    faults = (
        (f"longer than {LONGEST_PATH} bytes", len(path.encode()) > LONGEST_PATH),
        ("not relative", path.startswith("/") or _DRIVE.match(path) is not None),
        ("holds a backslash", "\\" in path),
        ("holds a control character", any(unicodedata.category(letter) in _CONTROL for letter in path)),
        (f"more than {MOST_PARTS} directories deep", len(parts) > MOST_PARTS),
    )
    whole = next((fault for fault, found in faults if found), None)
    return whole or next((fault for part in parts if (fault := _part_fault(part))), None)


def bundle_fault(paths: Iterable[str]) -> str | None:
    """What is wrong with the first of these paths that is not allowed, alone or beside the others, or None."""
    files: dict[str, str] = {}
    directories: dict[str, str] = {}
    for path in paths:
        fault = path_fault(path)
        if fault:
            return f"{path[:200]!r}: {fault}"
        folded = _folded(path)
        if folded in files:
            return f"{path!r}: the same as {files[folded]!r}" + (", but for case" if path != files[folded] else "")
        files[folded] = path
        parts = folded.split("/")
        for count in range(len(parts) - 1, 0, -1):
            above = "/".join(parts[:count])
            if above in directories:
                break
            directories[above] = path
        if len(directories) > MOST_DIRECTORIES:
            return f"{path!r}: more than {MOST_DIRECTORIES} directories"
    both = next((folded for folded in files if folded in directories), None)
    return None if both is None else f"{files[both]!r}: a file, and a directory for {directories[both]!r}"


def _part_fault(part: str) -> str | None:
    if part in {"", ".", ".."}:
        return f"holds the part {part!r}"
    if len(part.encode()) > LONGEST_PART:
        return f"holds a part longer than {LONGEST_PART} bytes"
    if _DEVICE.fullmatch(part):
        return f"{part!r} is a device on some systems"
    return None


def _folded(path: str) -> str:
    """The same for paths that some file system takes for the same."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", path).casefold())
