"""A frame range means what the industry says it means; what is none is refused with the part at fault."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight_server.farm.frames import MOST_FRAMES, FramesError, explain_frames, parse_frames


def naive(first: int, last: int, kind: str, step: int) -> list[int]:
    """The meaning of one part, from its definition."""
    way = 1 if last >= first else -1
    every = list(range(first, last + way, way))
    stepped = every[::step]
    if kind == "x":
        return stepped
    if kind == "y":
        return [frame for frame in every if frame not in stepped]
    order: list[int] = []
    for stride in range(step, 0, -1):
        order += [frame for frame in every[::stride] if frame not in order]
    return order


numbers = st.integers(-60, 60)
parts = st.tuples(numbers, numbers, st.sampled_from("xy:"), st.integers(1, 12))


@given(st.lists(parts, min_size=1, max_size=4))
def test_a_range_is_the_union_of_its_parts_in_order(chosen: list[tuple[int, int, str, int]]) -> None:
    text = ",".join(f"{first}-{last}{kind}{step}" for first, last, kind, step in chosen)
    expected = list(dict.fromkeys(frame for part in chosen for frame in naive(*part)))
    if not expected:
        with pytest.raises(FramesError, match="no frame"):
            parse_frames(text)
        return
    assert list(parse_frames(text)) == expected


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("", ()),
        ("  ", ()),
        ("7", (7,)),
        ("-3", (-3,)),
        ("1,5,9-12", (1, 5, 9, 10, 11, 12)),
        ("1, 5", (1, 5)),
        ("-2-2", (-2, -1, 0, 1, 2)),
        ("10-1x-3", (10, 7, 4, 1)),
        ("1-3,2-4", (1, 2, 3, 4)),
        ("2147483647", (2147483647,)),
    ],
)
def test_ranges_as_people_write_them(text: str, frames: tuple[int, ...]) -> None:
    assert parse_frames(text) == frames


WRONG = ("abc", "1-", "1-10x", "1-10x0", "1-10x-2", "0x10", "1--", "1;5", "1-2147483648")
# fileseq by itself takes these: it drops signs of padding and spaces, reads fractions and digits of other scripts.
TAKEN_ELSEWHERE = ("1-5,", "1-3@", "1-5####", "1 - 5", "1.5-3x0.5", "１-５", "1 0")  # noqa: RUF001


@pytest.mark.parametrize("text", WRONG + TAKEN_ELSEWHERE)
def test_what_is_no_range_is_refused_with_the_part_at_fault(text: str) -> None:
    with pytest.raises(FramesError) as caught:
        parse_frames(f"1001-1003,{text}")
    assert repr(text.rpartition(",")[2].strip()) in str(caught.value)


def test_a_range_has_an_end_and_too_long_a_one_costs_no_time() -> None:
    assert len(parse_frames(f"1-{MOST_FRAMES}")) == MOST_FRAMES
    before = time.process_time()
    for text in (f"0-{MOST_FRAMES}", "1-2000000000", ",".join(["1-900000"] * 1000), "1," * 20_000):
        with pytest.raises(FramesError):
            parse_frames(text)
    assert time.process_time() - before < 0.1


def test_an_interleaved_range_is_explained_because_elsewhere_it_is_a_step() -> None:
    frames = parse_frames("1-100:4")
    assert sorted(frames) == list(range(1, 101))
    notes = explain_frames("1-100:4", frames)
    assert notes[0] == "frames: 1-100:4 (100)"
    assert notes[1].startswith("1-100:4 is interleaved: all 100 frames, coarse first: 1, 5, 9, 13, 17, 21, …")
    assert notes[1].endswith("1-100x4")
    assert explain_frames("1-100x4", parse_frames("1-100x4")) == ["frames: 1-100x4 (25)"]
