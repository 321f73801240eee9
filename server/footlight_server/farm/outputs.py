"""Where the image of a frame is written: frame tokens in a path, and the directories it has to lie below."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

# `####`: as many digits as signs; `$F`, `<frame>`: as many as it takes; `$F4`: four.
_TOKEN = re.compile(r"(?P<hashes>#+)|\$F(?:(?P<digits>[0-9])(?![0-9])|(?![A-Za-z0-9_{]))|<frame>")
# What other programs would replace; written out as it stands it would be a surprise.
_FOREIGN = re.compile(r"%[0-9]*d|\$[A-Za-z_{]\w*|<\w*>|@+")
_KNOWN = "####, $F, $F4 and <frame>"
# [bytes] PATH_MAX of Linux.
_LONGEST_PATH = 4095


class OutputError(ValueError):
    """The path is none that frames can be written to."""


@dataclass(frozen=True, slots=True)
class OutputPattern:
    """A path with at most one frame token, taken apart. `digits`: at least so many; None: there is no token."""

    before: str
    digits: int | None
    after: str

    @property
    def base(self) -> Path:
        """The directory that all frames lie below."""
        return Path(self.before[: self.before.rindex("/") + 1])

    def path(self, frame: int) -> Path:
        """Where that frame goes. Negative frames keep their sign before the zeros: `-0005`."""
        if self.digits is None:
            return Path(self.before + self.after)
        sign = "-" if frame < 0 else ""
        return Path(f"{self.before}{sign}{abs(frame):0{self.digits}d}{self.after}")


def parse_output(pattern: str) -> OutputPattern:
    """The parts of an output path. Raises OutputError that says what is allowed."""
    tokens = list(_TOKEN.finditer(pattern))
    if len(tokens) > 1:
        found = ", ".join(token.group() for token in tokens)
        raise OutputError(f"{pattern!r} has {len(tokens)} frame tokens ({found}); one is allowed")
    if not tokens:
        parsed = OutputPattern(pattern, None, "")
    else:
        token = tokens[0]
        digits = len(token["hashes"] or "") or int(token["digits"] or 1)
        parsed = OutputPattern(pattern[: token.start()], digits, pattern[token.end() :])
    for part in (parsed.before, parsed.after):
        if foreign := _FOREIGN.search(part):
            raise OutputError(f"{pattern!r}: {foreign.group()} is no frame token; there are {_KNOWN}")
    _check_path(pattern)
    return parsed


def check_frames_apart(pattern: OutputPattern, frames: int) -> None:
    """Without a token all frames would be one file. Raises OutputError."""
    if pattern.digits is None and frames > 1:
        raise OutputError(f"{pattern.before!r} has no frame token for {frames} frames; write one of {_KNOWN}")


def is_below(path: Path, roots: Sequence[Path]) -> bool:
    """Whether a path lies below one of these resolved directories, links followed; any if there are none. Blocks."""
    real = Path(os.path.realpath(path))
    return not roots or any(real.is_relative_to(root) and real != root for root in roots)


def _check_path(pattern: str) -> None:
    if not pattern.startswith("/"):
        raise OutputError(f"{pattern!r} has to be absolute")
    if not pattern.isprintable():
        raise OutputError(f"{pattern!r} holds characters that cannot be printed")
    if ".." in pattern.split("/"):
        raise OutputError(f"{pattern!r} holds `..`")
    if not pattern.lower().endswith(".exr") or pattern.lower().endswith("/.exr"):
        raise OutputError(f"{pattern!r} has to end with .exr")
    if len(os.fsencode(pattern)) > _LONGEST_PATH - 16:
        raise OutputError(f"a path of {len(pattern)} characters: too long for a file")
