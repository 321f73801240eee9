"""Laws of what a viewer is owed: newest wins, nothing is lost, credit bounds what is sent."""

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from footlight_server.sessions.tile_queue import TileKey, TileQueue, TileVersion

TILES = 5


class Viewing(RuleBasedStateMachine):
    """A queue beside what the viewer would have to know: the newest version of each tile that it has not been sent."""

    def __init__(self) -> None:
        super().__init__()
        self.queue = TileQueue(["color"], 1)
        self.credit = 1
        self.owed: dict[TileKey, TileVersion] = {}
        self.samples = 0

    @rule(tiles=st.sets(st.integers(0, TILES - 1)))
    def render(self, tiles: set[int]) -> None:
        self.samples += 1
        version = TileVersion(self.samples, 1)
        self.queue.mark("color", sorted(tiles), version)
        self.queue.mark("depth", sorted(tiles), version)
        self.owed |= {TileKey("color", tile): version for tile in tiles}

    @rule(batches=st.integers(0, 2))
    def grant(self, batches: int) -> None:
        self.queue.grant(batches)
        self.credit += batches

    @rule(most=st.integers(1, TILES), fitting=st.integers(1, TILES), later=st.sets(st.integers(0, TILES - 1)))
    def send(self, most: int, fitting: int, later: set[int]) -> None:
        taken = self.queue.take(most)
        if self.credit == 0 or not self.owed:
            assert taken == {}
            return
        assert 0 < len(taken) <= most
        assert taken.items() <= self.owed.items()
        self.credit -= 1
        for key in list(taken)[:fitting]:
            del self.owed[key]
        self.render(later)  # while the batch is being encoded
        self.queue.put_back(dict(list(taken.items())[fitting:]))

    @invariant()
    def as_owed(self) -> None:
        assert len(self.queue) == len(self.owed)
        assert self.queue.ready == (bool(self.owed) and self.credit > 0)


TestViewing = Viewing.TestCase


@given(st.lists(st.integers(0, TILES - 1), min_size=1, max_size=40))
def test_the_tile_that_waits_longest_goes_first(marks: list[int]) -> None:
    queue = TileQueue(["color"], 1)
    for samples, tile in enumerate(marks):
        queue.mark("color", [tile], TileVersion(samples, 1))
    first = next(iter(queue.take(1)))
    assert first.tile == marks[0]


def test_everything_owed_comes_in_the_newest_version() -> None:
    queue = TileQueue(["color"], 1)
    queue.mark("color", range(TILES), TileVersion(1, 1))
    queue.mark("color", [2], TileVersion(7, 1))
    assert [version.samples for version in queue.take(TILES).values()] == [1, 1, 7, 1, 1]
