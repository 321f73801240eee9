"""The file of a part: a mark, the length of the head, the head, and the film's state compressed and checked."""

import os
import struct
from pathlib import Path

import zstandard
from google.protobuf.message import DecodeError

from footlight.worker.v1 import worker_pb2
from footlight_server.images.files import replacing

_MARK = b"FLPART1\n"
_LENGTH = struct.Struct("<I")
# zstd level: most of a film's low words are zero, which the fastest finds as well.
_LEVEL = 1


class PartError(ValueError):
    """The file is no part, or a damaged one; the message names it."""


def write_part(path: Path, head: worker_pb2.Part, film: bytes) -> None:
    """Whole or not at all; fills in `head.film_bytes`. Raises ImageError naming the file."""
    head.film_bytes = len(film)
    data = head.SerializeToString()
    compressor = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(_MARK + _LENGTH.pack(len(data)) + data)
        with compressor.stream_writer(file, size=len(film), closefd=False) as stream:
            stream.write(film)


def read_head(path: Path) -> worker_pb2.Part:
    """All but the film. Raises PartError."""
    return _read(path)[0]


def read_part(path: Path) -> tuple[worker_pb2.Part, bytes]:
    """The head, and the film's state. Raises PartError."""
    head, offset = _read(path)
    film = bytearray()
    try:
        with path.open("rb") as file:
            file.seek(offset)
            for piece in zstandard.ZstdDecompressor().read_to_iter(file):
                film += piece
                if len(film) > head.film_bytes:
                    break
    except (OSError, zstandard.ZstdError) as error:
        raise PartError(f"{path}: cannot be read: {error}") from error
    if len(film) != head.film_bytes:
        raise PartError(f"{path}: the film is not of {head.film_bytes} bytes, as its head says")
    return head, bytes(film)


def _read(path: Path) -> tuple[worker_pb2.Part, int]:
    """The head, and [bytes] where the film begins."""
    try:
        with path.open("rb") as file:
            start = file.read(len(_MARK) + _LENGTH.size)
            if len(start) < len(_MARK) + _LENGTH.size or not start.startswith(_MARK):
                raise PartError(f"{path}: not a part of a film")
            (length,) = _LENGTH.unpack_from(start, len(_MARK))
            data = file.read(min(length, os.fstat(file.fileno()).st_size))
    except OSError as error:
        raise PartError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        return worker_pb2.Part.FromString(data), len(start) + length
    except DecodeError as error:
        raise PartError(f"{path}: its head is damaged") from error
