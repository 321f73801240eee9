"""A look at layer files before USD's parser sees them: size, bracket depth, the assets they name.

The parser recurses for every bracket and dies on a few megabytes of them (a stack overflow, no error to catch), so
files that nest deeper than any real stage are refused here.
"""

import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from footlight_server.usd.errors import StageLimitError, StageMalformedError

MAX_DEPTH = 1000  # brackets; real stages stay below 50, the parser survives 5000

# Comments, strings and asset paths, as usda knows them: brackets in these do not nest.
_QUOTED = re.compile(
    rb'"""[\s\S]*?(?:"""|\Z)'
    rb"|'''[\s\S]*?(?:'''|\Z)"
    rb'|"(?:[^"\\\n]|\\.)*+"?'
    rb"|'(?:[^'\\\n]|\\.)*+'?"
    rb"|@@@[\s\S]*?(?:@@@|\Z)"
    rb"|@[^@\n]*+@?"
    rb"|#[^\n]*+"
    rb"|//[^\n]*+"
    rb"|/\*[\s\S]*?(?:\*/|\Z)"
)
_ASSET = re.compile(rb"@([^@\n]+)@")
_NOT_BRACKETS = bytes(sorted(set(range(256)) - set(b"()[]{}")))
_STEP = np.zeros(256, np.int8)
_STEP[list(b"([{")] = 1
_STEP[list(b")]}")] = -1
_TEXT_MAGIC = b"#usda"
_OLD_TEXT_MAGIC = b"#sdf"
_PACKAGE_MAGIC = b"PK"
# The header before a file in a zip archive (PKWARE's APPNOTE 4.3.7): magic, version, flags, method, time, date, CRC,
# size, size when unpacked, sizes of name and extra field.
_HEADER = struct.Struct("<4s5H3I2H")
_MEMBER_MAGIC = b"PK\3\4"
_MAX_PACKAGES = 8  # one in the other


def bracket_depth(text: bytes) -> int:
    """The deepest nesting of brackets outside comments, strings and asset paths."""
    brackets = _QUOTED.sub(b"", text).translate(None, _NOT_BRACKETS)
    deepest, depth, chunk = 0, 0, 1 << 24
    for begin in range(0, len(brackets), chunk):
        steps = _STEP[np.frombuffer(brackets, np.uint8, min(chunk, len(brackets) - begin), begin)]
        heights = np.cumsum(steps, dtype=np.int64) + depth
        deepest, depth = max(deepest, int(heights.max())), int(heights[-1])
    return deepest


def is_text(head: bytes) -> bool:
    """Whether a file that begins like this is a usda text layer."""
    return head.startswith((_TEXT_MAGIC, _OLD_TEXT_MAGIC))


def check_text(name: str, text: bytes) -> None:
    """Refuses text that the parser would not survive."""
    depth = bracket_depth(text)
    if depth > MAX_DEPTH:
        raise StageMalformedError(f"{name}: brackets nest {depth} deep, allowed are {MAX_DEPTH}")


def scan_layers(root: Path, *, max_text_bytes: int, max_layers: int) -> None:
    """Checks the root layer and every layer that text layers name literally, before any of them is opened."""
    todo, seen = [root], {root}
    while todo:
        for asset in _scan_layer(todo.pop(), max_text_bytes):
            if asset not in seen and asset.is_file():
                seen.add(asset)
                todo.append(asset)
        if len(seen) > max_layers:
            raise StageLimitError(f"{root}: names more than {max_layers} layers")


def scan_folder(folder: Path, *, max_text_bytes: int) -> None:
    """Checks every layer below a folder, however it may be referred to. Does not follow links."""
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            if path.is_file() and not path.is_symlink():
                _scan_layer(path, max_text_bytes)


def _scan_layer(path: Path, max_text_bytes: int) -> set[Path]:
    """The assets that a text layer names; nothing for other files."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
            if head.startswith(_PACKAGE_MAGIC):
                if path.suffix.lower() == ".usdz":
                    _scan_package(str(path), file, 0, path.stat().st_size, max_text_bytes)
                return set()
            if not is_text(head):
                return set()
            size = path.stat().st_size
            if size > max_text_bytes:
                raise StageLimitError(f"{path}: {size} bytes of text, allowed are {max_text_bytes}")
            text = head + file.read()
    except OSError:
        return set()  # USD reports it where it is used
    check_text(str(path), text)
    return {
        path.parent / name
        for name in (match.decode(errors="replace") for match in set(_ASSET.findall(text)))
        if name.endswith((".usd", ".usda", ".usdc", ".usdz")) and "\0" not in name
    }


def _scan_package(name: str, file: BinaryIO, begin: int, end: int, max_text_bytes: int, nesting: int = 0) -> None:
    """Checks the package that lies in [begin, end) of a file."""
    members = list(package_members(file, begin, end))
    if not members or nesting > _MAX_PACKAGES:
        raise StageMalformedError(f"{name}: not a usdz package")
    for member in members:
        if member.packed:
            raise StageMalformedError(f"{name}: {member.name} is compressed or encrypted, usdz stores its files")
        inner = f"{name}[{member.name}]"
        file.seek(member.begin)
        head = file.read(min(8, member.size))
        if head.startswith(_PACKAGE_MAGIC) and member.name.lower().endswith(".usdz"):
            _scan_package(inner, file, member.begin, member.begin + member.size, max_text_bytes, nesting + 1)
        if is_text(head):
            if member.size > max_text_bytes:
                raise StageLimitError(f"{inner}: {member.size} bytes of text, allowed are {max_text_bytes}")
            check_text(inner, head + file.read(member.size - len(head)))


@dataclass(frozen=True, slots=True)
class PackageMember:
    """A file in a usdz package: where it lies in the package's own file [bytes], and whether it is compressed."""

    name: str
    begin: int
    size: int
    packed: bool


def package_members(file: BinaryIO, begin: int, end: int) -> Iterator[PackageMember]:
    """The files of the package in [begin, end) as USD finds them (sdf/zipFile.cpp): each after its own header.

    Other programs go by the directory at the end, which may name other files.
    """
    at = begin
    while at + _HEADER.size <= end:
        file.seek(at)
        magic, _, flags, method, _, _, _, size, _, name_size, extra_size = _HEADER.unpack(file.read(_HEADER.size))
        if magic != _MEMBER_MAGIC:
            return
        name = file.read(name_size).decode(errors="replace")
        at += _HEADER.size + name_size + extra_size
        yield PackageMember(name, at, max(0, min(size, end - at)), packed=method != 0 or bool(flags & 1))
        at += size
