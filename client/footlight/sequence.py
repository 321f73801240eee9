"""File names of sequences: where in a name the frame's number stands."""

import re

# `####` as many digits as signs; `$F4`, `$F`; `<frame>`. As for LayerSpec.output.
_TOKEN = re.compile(r"#+|\$F\d?|<frame>")


def has_frame(pattern: str) -> bool:
    """The pattern names a different file for each frame."""
    return _TOKEN.search(pattern) is not None


def frame_path(pattern: str, frame: int, layer: str = "") -> str:
    """The name of a frame's file: every frame token by the number, with leading zeros; `<layer>` by the layer."""

    def number(token: re.Match[str]) -> str:
        text = token[0]
        digits = len(text) if text.startswith("#") else int(text[2:] or 1) if text.startswith("$") else 1
        return str(frame).zfill(digits)

    return _TOKEN.sub(number, pattern).replace("<layer>", layer)
