"""What one viewer is still to be shown: newest value per tile, oldest tile first, as far as credit goes."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TileKey:
    """A tile of an AOV."""

    aov: str
    tile: int


@dataclass(frozen=True, slots=True)
class TileVersion:
    """[samples per pixel] in a tile, and [pixels] the edge of the square that one of its pixels stands for."""

    samples: int
    scale: int


class TileQueue:
    """Bounded by the number of tiles, whatever the viewer does. Knows no I/O and no clock."""

    def __init__(self, aovs: Iterable[str], credit: int) -> None:
        self._aovs = frozenset(aovs)
        # Ordered: a tile keeps its place while it gets newer.
        self._due: dict[TileKey, TileVersion] = {}
        self._credit = credit

    @property
    def aovs(self) -> frozenset[str]:
        """What the viewer looks at."""
        return self._aovs

    @property
    def credit(self) -> int:
        """Batches that the viewer has room for."""
        return self._credit

    @property
    def ready(self) -> bool:
        """A batch can be sent."""
        return bool(self._due) and self._credit > 0

    def __len__(self) -> int:
        """Tiles that are due."""
        return len(self._due)

    def grant(self, batches: int) -> None:
        """The viewer has room for more."""
        self._credit += batches

    def mark(self, aov: str, tiles: Iterable[int], version: TileVersion) -> None:
        """These tiles are new."""
        if aov in self._aovs:
            for tile in tiles:
                self._due[TileKey(aov, tile)] = version

    def take(self, most: int) -> dict[TileKey, TileVersion]:
        """Up to `most` tiles for one batch; costs one credit unless there is nothing to send."""
        if not self.ready:
            return {}
        self._credit -= 1
        taken = {key: self._due[key] for key in list(self._due)[:most]}
        for key in taken:
            del self._due[key]
        return taken

    def put_back(self, unsent: dict[TileKey, TileVersion]) -> None:
        """Tiles that did not fit go first again, unless they have become newer meanwhile."""
        self._due = {key: self._due.get(key, version) for key, version in unsent.items()} | self._due
