"""Laws of passes and slices."""

from hypothesis import given
from hypothesis import strategies as st

from footlight_server.workers.passes import LONGEST_PASS, LONGEST_SLICE, Pace, slice_seconds


@given(spp=st.integers(1, 300), speed=st.floats(1e-6, 1.0), tiles=st.integers(1, 60), threads=st.integers(1, 64))
def test_all_samples_are_taken_once(spp: int, speed: float, tiles: int, threads: int) -> None:
    """`speed`: [s] of a tile's sample."""
    pace, done, elapsed, passes = Pace(), 0, 0.0, []
    while done < spp:
        samples = pace.pass_samples(done, spp, slice_seconds(elapsed), threads)
        assert 1 <= samples <= min(LONGEST_PASS, spp - done)
        begin = 0
        while begin < tiles:
            count = pace.slice_tiles(slice_seconds(elapsed), samples, threads)
            assert count >= threads
            count = min(count, tiles - begin)
            seconds = speed * samples * count
            if count > threads:
                assert seconds <= LONGEST_SLICE * 1.001
            pace.saw(count, samples, seconds)
            elapsed += seconds
            begin += count
        done += samples
        passes.append(samples)
    assert done == spp
    assert passes[0] == 1


def test_the_first_image_comes_from_one_sample() -> None:
    assert Pace().pass_samples(0, 4096, LONGEST_SLICE, 2) == 1


def test_slow_tiles_get_short_passes() -> None:
    pace = Pace()
    pace.saw(2, 1, 10.0)
    assert pace.pass_samples(64, 4096, LONGEST_SLICE, 2) == 1
