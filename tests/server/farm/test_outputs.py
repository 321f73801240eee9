"""An output path names one file for each frame, and says so when it does not."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight_server.farm.outputs import OutputError, check_frames_apart, is_below, parse_output


@pytest.mark.parametrize(
    ("pattern", "frame", "path"),
    [
        ("/o/shot.####.exr", 7, "/o/shot.0007.exr"),
        ("/o/shot.#.exr", 1001, "/o/shot.1001.exr"),
        ("/o/shot.####.exr", 123456, "/o/shot.123456.exr"),
        ("/o/shot.####.exr", -5, "/o/shot.-0005.exr"),
        ("/o/shot.$F.exr", 7, "/o/shot.7.exr"),
        ("/o/shot.$F4.exr", 7, "/o/shot.0007.exr"),
        ("/o/shot_$F4_beauty.exr", 7, "/o/shot_0007_beauty.exr"),
        ("/o/<frame>/beauty.EXR", 12, "/o/12/beauty.EXR"),
        ("/o/still.exr", 0, "/o/still.exr"),
    ],
)
def test_tokens_become_frame_numbers(pattern: str, frame: int, path: str) -> None:
    assert parse_output(pattern).path(frame) == Path(path)


@given(st.sampled_from(["#", "####", "$F", "$F4", "<frame>"]), st.integers(-(2**31), 2**31 - 1), st.integers(-99, 99))
def test_different_frames_are_different_files(token: str, frame: int, other: int) -> None:
    pattern = parse_output(f"/o/a{token}.exr")
    assert (pattern.path(frame) == pattern.path(other)) == (frame == other)


@pytest.mark.parametrize(
    ("pattern", "why"),
    [
        ("o/shot.####.exr", "absolute"),
        ("/o/shot.####.png", "end with .exr"),
        ("/o/.exr", "end with .exr"),
        ("/o/../shot.####.exr", "`..`"),
        ("/o/####/shot.####.exr", "2 frame tokens"),
        ("/o/shot.####.<frame>.exr", "2 frame tokens"),
        ("/o/shot.%04d.exr", "%04d is no frame token"),
        ("/o/shot.$F44.exr", "$F44 is no frame token"),
        ("/o/$JOB/shot.####.exr", "$JOB is no frame token"),
        ("/o/$FOO.exr", "$FOO is no frame token"),
        ("/o/<layer>.####.exr", "<layer> is no frame token"),
        ("/o/shot.@@@@.exr", "@@@@ is no frame token"),
        ("/o/shot\n.####.exr", "cannot be printed"),
        ("/o/shot\0.####.exr", "cannot be printed"),
        ("/" + "o" * 5000 + "####.exr", "too long"),
    ],
)
def test_what_is_no_output_is_refused(pattern: str, why: str) -> None:
    with pytest.raises(OutputError) as caught:
        parse_output(pattern)
    assert why in str(caught.value)


def test_several_frames_need_a_token() -> None:
    check_frames_apart(parse_output("/o/still.exr"), 1)
    check_frames_apart(parse_output("/o/####.exr"), 50)
    with pytest.raises(OutputError, match="no frame token for 50 frames"):
        check_frames_apart(parse_output("/o/still.exr"), 50)


def test_below_a_root_means_where_links_lead(tmp_path: Path) -> None:
    root, outside = tmp_path / "root", tmp_path / "outside"
    root.mkdir()
    outside.mkdir()
    (root / "link").symlink_to(outside)
    (outside / "back").symlink_to(root)
    roots = (root.resolve(),)
    assert is_below(root / "a.exr", roots)
    assert is_below(root / "not" / "there" / "a.exr", roots)
    assert is_below(outside / "back" / "a.exr", roots)
    assert not is_below(root / "link" / "a.exr", roots)
    assert not is_below(outside / "a.exr", roots)
    assert not is_below(Path(f"{root}er") / "a.exr", roots)
    assert not is_below(Path(os.path.join(root, "..", "outside", "a.exr")), roots)  # noqa: PTH118
    assert is_below(outside / "a.exr", ())
