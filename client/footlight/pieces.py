"""A file that comes in pieces: sees that they are in order and complete."""

from typing import Protocol

from footlight.errors import ProtocolError


class Piece(Protocol):
    """GetResultResponse, GetFrameResponse. [bytes] `offset` is where `data` belongs, `total_bytes` the whole file."""

    offset: int
    data: bytes
    total_bytes: int


class Pieces:
    """`offset` [bytes] is where the next piece has to begin."""

    def __init__(self) -> None:
        self.offset = 0
        self._total = 0

    def __call__(self, piece: Piece) -> bytes:
        """The piece's data. Raises ProtocolError for one that is out of order."""
        if piece.offset != self.offset:
            raise ProtocolError(f"a piece of the image at byte {piece.offset} instead of {self.offset}")
        self.offset += len(piece.data)
        self._total = piece.total_bytes
        return piece.data

    def check(self) -> None:
        """Raises ProtocolError if something is missing."""
        if self.offset != self._total:
            raise ProtocolError(f"the image ended after {self.offset} of {self._total} bytes")
