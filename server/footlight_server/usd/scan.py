"""A look at layer files before USD's parser sees them: size, bracket depth, the assets they name.

The parser recurses for every bracket and dies on a few megabytes of them (a stack overflow, no error to catch), so
files that nest deeper than any real stage are refused here.
"""

import re
import zipfile
from pathlib import Path

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


def _scan_layer(path: Path, max_text_bytes: int) -> set[Path]:
    try:
        with path.open("rb") as file:
            head = file.read(8)
            if head.startswith(b"PK"):
                _scan_package(path, max_text_bytes)
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


def _scan_package(path: Path, max_text_bytes: int) -> None:
    try:
        with zipfile.ZipFile(path) as package:
            for member in package.infolist():
                if member.compress_type != zipfile.ZIP_STORED:
                    raise StageMalformedError(f"{path}: {member.filename} is compressed, usdz stores its files")
                if not member.filename.endswith((".usd", ".usda")):
                    continue
                if member.file_size > max_text_bytes:
                    raise StageLimitError(
                        f"{path}: {member.filename} has {member.file_size} bytes, allowed are {max_text_bytes}"
                    )
                text = package.read(member)
                if is_text(text[:8]):
                    check_text(f"{path}[{member.filename}]", text)
    except zipfile.BadZipFile as error:
        raise StageMalformedError(f"{path}: not a usdz package: {error}") from error
