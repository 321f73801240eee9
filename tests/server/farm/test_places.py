"""Laws of names: no two things share a file, and a frame's file says which frame it is."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from footlight_server.farm.model import Attempt
from footlight_server.farm.places import Places, frame_file, frame_of, workspace

PLACES = Places(Path("/data"))
LAYER = st.from_regex(r"[A-Za-z0-9_.-]{1,64}", fullmatch=True)
FRAME = st.integers(-(2**31), 2**31 - 1)


@given(LAYER, FRAME, LAYER, FRAME)
def test_a_file_of_a_frame_is_of_no_other_frame(layer: str, frame: int, other: str, another: int) -> None:
    path = Path("/data") / frame_file(layer, frame, ".png")
    assert path.parent == Path("/data")
    assert frame_of(path, layer) == frame
    same = (layer, frame) == (other, another)
    assert (Path("/data") / frame_file(other, another, ".png") == path) == same
    if other != layer:
        assert frame_of(path, other) is None


@given(LAYER, FRAME, st.integers(0, 1 << 20))
def test_everything_of_a_job_lies_below_its_folder(layer: str, frame: int, begin: int) -> None:
    paths = [
        PLACES.log(7, 3, 1),
        PLACES.image(7, layer, frame),
        PLACES.part(7, layer, frame, begin),
        PLACES.thumbnail(7, layer, frame),
        PLACES.picture(7, layer, frame),
        PLACES.sheet(7, layer),
    ]
    assert len(set(paths)) == len(paths)
    assert all(path.parent.parent == PLACES.job(7) and path.name not in {".", ".."} for path in paths)


def test_a_workspace_is_on_the_disk_of_its_target_and_of_one_attempt_at_one_frame() -> None:
    target = Path("/shots/sh010/beauty.1001.exr")
    attempts = [
        Attempt(job, task, number, "a/1", "a", 0.0) for job in (1, 11) for task in (1, 11) for number in (1, 11)
    ]
    names = {workspace(target, attempt, frame) for attempt in attempts for frame in (1, -1, 11)}
    assert len(names) == 24
    assert {name.parent for name in names} == {target.parent}
    assert all(name.name.startswith(".") for name in names)
