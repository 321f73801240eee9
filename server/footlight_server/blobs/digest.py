"""What bytes are called: their SHA-256 and their number."""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self

# [bytes] The largest blob; said in the protocol.
LARGEST_BLOB = 1 << 40
# [bytes] Read at a time.
_PIECE = 1 << 20

_SHA256 = re.compile(r"[0-9a-f]{64}", re.ASCII)
_TEXT = re.compile(r"([0-9a-f]{64})/(0|[1-9][0-9]{0,12})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Digest:
    """Names bytes; `size` [bytes]. Raises ValueError if it is not well formed, so that it can stand in a file name."""

    sha256: str
    size: int

    def __post_init__(self) -> None:
        if not _SHA256.fullmatch(self.sha256):
            raise ValueError(f"{self.sha256[:80]!r} is no SHA-256: 64 lower-case hexadecimal digits")
        if not 0 <= self.size <= LARGEST_BLOB:
            raise ValueError(f"{self.size} bytes: allowed are 0 to {LARGEST_BLOB}")

    def __str__(self) -> str:
        return f"{self.sha256}/{self.size}"

    @property
    def file_name(self) -> str:
        """As a file name."""
        return f"{self.sha256}-{self.size}"

    @classmethod
    def from_file_name(cls, name: str) -> Self:
        """The inverse of `file_name`. Raises ValueError."""
        return cls.parse(name.replace("-", "/"))

    @classmethod
    def parse(cls, text: str) -> Self:
        """From `{sha256}/{size}`. Raises ValueError."""
        found = _TEXT.fullmatch(text)
        if found is None:
            raise ValueError(f"{text[:100]!r} is no digest; write {{sha256}}/{{size}}")
        return cls(found[1], int(found[2]))


def digest_of(data: bytes) -> Digest:
    """The digest of these bytes."""
    return Digest(hashlib.sha256(data).hexdigest(), len(data))


def digest_of_file(path: Path) -> Digest:
    """The digest of what a file holds. Blocks; raises OSError."""
    state, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            state.update(piece)
            size += len(piece)
    return Digest(state.hexdigest(), size)
