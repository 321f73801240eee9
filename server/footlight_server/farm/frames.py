"""Frame ranges as the industry writes them, parsed by fileseq: `1001-1100x2`, `1-10y3`, `1-100:4`, `1,5,9-12`."""

import re
from collections.abc import Sequence

import fileseq

# [frames] Of one range; said in the protocol.
MOST_FRAMES = 1_000_000
# [characters] Of a range; a list of a thousand single frames is shorter.
_LONGEST_TEXT = 16_384
# [1] What an int32 holds, because the protocol numbers frames so.
_LOWEST, _HIGHEST = -(2**31), 2**31 - 1
# fileseq drops `#`, `@` and spaces, and takes fractions and digits of other scripts; here these are mistakes.
_PART = re.compile(r"(-?[0-9]{1,10})(?:-(-?[0-9]{1,10})(?:([xy:])(-?[0-9]{1,10}))?)?", re.ASCII)
# [frames] Listed in a note before it is cut short. [parts] That are explained.
_SHOWN = 6
_EXPLAINED = 4


class FramesError(ValueError):
    """The text is no range of frames, or one that is too long."""


def parse_frames(text: str) -> tuple[int, ...]:
    """The frames of a range in the order they are to be rendered, none twice; none for an empty text.

    Raises FramesError that names the part at fault and what is allowed.
    """
    text = text.strip()
    if not text:
        return ()
    if len(text) > _LONGEST_TEXT:
        raise FramesError(f"{len(text)} characters: at most {_LONGEST_TEXT} are allowed")
    if sum(_length(part) for part in text.split(",")) > MOST_FRAMES:
        raise FramesError(f"{_quoted(text)}: more than {MOST_FRAMES} frames")
    try:
        frames = tuple(int(frame) for frame in fileseq.FrameSet(text))
    except fileseq.FileSeqException as error:
        raise FramesError(f"{_quoted(text)}: {str(error).splitlines()[0]}") from None
    if not frames:
        raise FramesError(f"{_quoted(text)} leaves no frame over")
    return frames


def explain_frames(text: str, frames: Sequence[int]) -> list[str]:
    """What a range comes to, for people: `frames: 1001-1100x2 (50)`, and what its interleaved parts mean."""
    if not frames:
        return ["frames: one, at the stage's own time"]
    notes = [f"frames: {_shortened(text)} ({len(frames)})"]
    interleaved = [part.strip() for part in text.split(",") if ":" in part]
    for part in interleaved[:_EXPLAINED]:
        order = frames if part == text.strip() else parse_frames(part)
        first = ", ".join(str(frame) for frame in order[:_SHOWN])
        notes.append(
            f"{part} is interleaved: all {len(order)} frames, coarse first: {first}"
            f"{', …' if len(order) > _SHOWN else ''}; for a step write {part.replace(':', 'x')}"
        )
    return notes


def _length(part: str) -> int:
    """[frames] At most, of one part of a range; looked at before anything of that size is made."""
    part = part.strip()
    match = _PART.fullmatch(part)
    if match is None:
        raise FramesError(
            f"{_quoted(part)} is no range of whole frames; write 1001, 1001-1100, 1-100x2 (every second), "
            "1-100y3 (all but every third), 1-100:4 (all, interleaved) or several with commas"
        )
    first, last, kind, step = match.groups()
    begin, end, stride = int(first), int(last or first), int(step or 1)
    if min(begin, end) < _LOWEST or max(begin, end) > _HIGHEST:
        raise FramesError(f"{_quoted(part)}: frames are numbers from {_LOWEST} to {_HIGHEST}")
    if stride == 0 or (stride < 0 and begin < end):
        raise FramesError(f"{_quoted(part)}: a step of {stride} does not lead from {begin} to {end}")
    return abs(end - begin) // (abs(stride) if kind == "x" else 1) + 1


def _quoted(text: str) -> str:
    return repr(_shortened(text))


def _shortened(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:77]}…"
