"""No bundle writes outside its directory, over another of its files, or under a name that some system knows better."""

import unicodedata
from pathlib import Path, PurePosixPath, PureWindowsPath

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from footlight_server.blobs.paths import MOST_DIRECTORIES, MOST_PARTS, bundle_fault, path_fault

PARTS = st.one_of(
    st.sampled_from(["", ".", "..", "...", "~", "a", "A", "con", "NUL.txt", "C:", "\\", "..\\", "\0", "\n", "ä", "ä"]),
    st.text(max_size=8),
)
PATHS = st.one_of(st.lists(PARTS, max_size=8).map("/".join), st.text(max_size=40))


@pytest.mark.parametrize(
    "path",
    ["", "/", "c:", "C:/x", "a:b", "/etc/passwd", "//host/share",
     "..", "../x", "a/../../x", "a/..", ".", "./a", "a//b", "a/", "a\\b", "..\\x",
     "a\0b", "a\nb", "a\x7f", "a\u2028b", "con", "CON", "a/Nul.usda", "lpt1", "com¹.txt", "aux .png", "x" * 256,
     "/".join(["a"] * (MOST_PARTS + 1)), "/".join(["x" * 200] * 6), "ö" * 128],
)  # fmt: skip
def test_paths_that_are_refused(path: str) -> None:
    assert path_fault(path)
    assert bundle_fault(["fine.usda", path])


@pytest.mark.parametrize(
    "path",
    ["a", "stage.usda", "a/b/c.exr", "wood.<UDIM>.exr", "...", ".hidden", "a b/ü.png", "console", "x" * 255, "ab:",
     "/".join(["a"] * MOST_PARTS), "ö" * 127],
)  # fmt: skip
def test_paths_that_are_allowed(path: str) -> None:
    assert path_fault(path) is None
    assert bundle_fault([path]) is None


@given(PATHS)
@example("C:/Windows")
@example("C:x")
def test_what_is_allowed_stays_below_and_is_what_it_says(path: str) -> None:
    if path_fault(path) is not None:
        return
    root = Path("/data/bundle")
    assert (root / path).relative_to(root).as_posix() == path
    assert not {"", ".", ".."} & set(path.split("/"))
    assert not PurePosixPath(path).is_absolute()
    assert not PureWindowsPath(path).is_absolute()
    assert ".." not in PureWindowsPath(path).parts
    # The parser of Windows knows its devices.
    assert not any(PureWindowsPath(part).is_reserved() for part in path.split("/"))


@given(st.lists(PATHS, max_size=6))
def test_allowed_bundles_hold_different_files(paths: list[str]) -> None:
    if bundle_fault(paths) is not None:
        return
    folded = [unicodedata.normalize("NFD", path).casefold() for path in paths]
    assert len(set(folded)) == len(paths)
    for path in folded:
        assert not any(str(above) in folded for above in PurePosixPath(path).parents)


@pytest.mark.parametrize(
    "paths",
    [["a", "a"], ["a/b", "A/B"], ["straße", "STRASSE"], ["\u00e4", "a\u0308"], ["a", "a/b"], ["a/b/c", "A/b"]],
)
@pytest.mark.parametrize("turned", [False, True])
def test_files_that_some_system_takes_for_the_same_are_refused(paths: list[str], *, turned: bool) -> None:
    assert bundle_fault(reversed(paths) if turned else paths)


def test_directories_that_differ_in_case_are_no_conflict() -> None:
    assert bundle_fault(["Tex/a.png", "tex/b.png"]) is None


def test_directories_are_counted() -> None:
    assert bundle_fault(f"{i}/x" for i in range(MOST_DIRECTORIES)) is None
    assert bundle_fault(f"{i}/x" for i in range(MOST_DIRECTORIES + 1))
    deep = (f"{i}/" + "/".join(["d"] * (MOST_PARTS - 2)) + "/x" for i in range(1000))
    assert bundle_fault(deep), "63 directories each"
