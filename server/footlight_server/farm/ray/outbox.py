"""What a worker has said and the server has not fetched yet: in order, tiles and progress in their newest form only."""

import asyncio
from collections import deque
from dataclasses import dataclass, field

from footlight.worker.v1 import worker_pb2

# [tiles] In one message: 3 MB of colour.
MOST_TILES = 64


@dataclass(slots=True)
class PendingTiles:
    """Tiles of one AOV that are newer than what was fetched: index -> (samples, scale)."""

    aov: str
    versions: dict[int, tuple[int, int]] = field(default_factory=dict)

    def messages(self) -> list[worker_pb2.Tiles]:
        """Messages of one version and at most MOST_TILES tiles each."""
        by_version: dict[tuple[int, int], list[int]] = {}
        for index, version in self.versions.items():
            by_version.setdefault(version, []).append(index)
        return [
            worker_pb2.Tiles(aov=self.aov, indices=indices[begin : begin + MOST_TILES], samples=samples, scale=scale)
            for (samples, scale), indices in by_version.items()
            for begin in range(0, len(indices), MOST_TILES)
        ]


Entry = worker_pb2.WorkerEvent | PendingTiles


class Outbox:
    """Bounded by what there is to say, not by how slowly it is fetched: one entry for each AOV and one for progress."""

    def __init__(self) -> None:
        self._entries: deque[Entry] = deque()
        self._news = asyncio.Event()

    def put(self, event: worker_pb2.WorkerEvent) -> None:
        """Take in what the worker said."""
        kind = event.WhichOneof("event")
        if kind == "tiles":
            self._pending(event.tiles.aov).versions.update(
                dict.fromkeys(event.tiles.indices, (event.tiles.samples, event.tiles.scale))
            )
        else:
            if kind == "progress":
                self._forget_progress()
            self._entries.append(event)
        self._news.set()

    async def next(self) -> Entry:
        """The oldest entry. The caller sets a deadline."""
        while not self._entries:
            self._news.clear()
            await self._news.wait()
        return self._entries.popleft()

    def _pending(self, aov: str) -> PendingTiles:
        for entry in self._entries:
            if isinstance(entry, PendingTiles) and entry.aov == aov:
                return entry
        fresh = PendingTiles(aov)
        self._entries.append(fresh)
        return fresh

    def _forget_progress(self) -> None:
        for entry in self._entries:
            if isinstance(entry, worker_pb2.WorkerEvent) and entry.HasField("progress"):
                self._entries.remove(entry)
                return
