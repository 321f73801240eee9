"""Paths map both ways by whole directories, the longest first, whatever kind of system they are from."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight.paths import PathMap, absolute

PATHS = PathMap.of(
    ["/Volumes/shows=/mnt/shows", "/Volumes/shows/old=/archive", r"P:\shows=/mnt/shows", r"\\nas\lib=/mnt/lib"]
)


@pytest.mark.parametrize(
    ("here", "there"),
    [
        ("/Volumes/shows/a/b.usd", "/mnt/shows/a/b.usd"),
        ("/Volumes/shows", "/mnt/shows"),
        ("/Volumes/shows/old/b.usd", "/archive/b.usd"),
        ("/Volumes/shows2/b.usd", "/Volumes/shows2/b.usd"),
        (r"P:\shows\a\b.####.exr", "/mnt/shows/a/b.####.exr"),
        (r"p:\SHOWS\a\b.usd", "/mnt/shows/a/b.usd"),
        ("P:/shows/a/b.usd", "/mnt/shows/a/b.usd"),
        (r"Q:\shows\b.usd", r"Q:\shows\b.usd"),
        (r"\\nas\lib\wood.tx", "/mnt/lib/wood.tx"),
    ],
)
def test_a_path_goes_where_its_longest_directory_goes(here: str, there: str) -> None:
    assert PATHS.to_server(here) == there


def test_the_way_back_takes_the_first_of_equals() -> None:
    assert PATHS.to_client("/mnt/shows/a/b.usd") == "/Volumes/shows/a/b.usd"
    assert PathMap.of([r"P:\shows=/mnt/shows"]).to_client("/mnt/shows/a/b.usd") == r"P:\shows\a\b.usd"
    assert PATHS.to_client("/elsewhere/b.usd") == "/elsewhere/b.usd"


def test_relative_paths_are_from_here_and_absolute_ones_stay() -> None:
    assert absolute("a/####.exr") == str(Path.cwd() / "a" / "####.exr")
    assert absolute("/a/b.usd") == "/a/b.usd"
    assert absolute(r"P:\a\b.usd") == r"P:\a\b.usd"
    assert PathMap.of([f"{Path.cwd()}=/mnt"]).to_server("b.usd") == "/mnt/b.usd"


@pytest.mark.parametrize("rule", ["", "/a", "/a=", "a=/b", "/a=b", "=/b", r"\\nas=/b"])
def test_a_rule_is_two_absolute_directories(rule: str) -> None:
    with pytest.raises(ValueError, match=r"path_map: .* is not FROM=TO"):
        PathMap.of([rule])


NAMES = st.lists(st.text("ab.c", min_size=1, max_size=3).filter(lambda name: name not in (".", "..")), max_size=4)


@given(NAMES, NAMES, NAMES)
def test_there_and_back_is_the_same_path(here: list[str], there: list[str], rest: list[str]) -> None:
    paths = PathMap.of([f"/{'/'.join(['x', *here])}=/{'/'.join(['y', *there])}"])
    path = "/" + "/".join(["x", *here, *rest])
    assert paths.to_server(path) == "/" + "/".join(["y", *there, *rest])
    assert paths.to_client(paths.to_server(path)) == path
