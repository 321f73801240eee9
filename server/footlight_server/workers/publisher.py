"""Copies tiles that are new from the renderer into the shared film and says which."""

import os
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from footlight.worker.v1 import worker_pb2
from footlight_server.workers.film import TILE, Film, create_film, shape_of
from footlight_server.workers.link import Link


class TileSource(Protocol):
    """The part of the core's Renderer that is needed here."""

    def read_tile(self, aov: str, tile: int) -> NDArray[np.float32]:
        """(height, width, channels) float32 of the image so far."""
        ...


class Publisher:
    """Owns the worker's view of the film."""

    def __init__(self, link: Link, source: TileSource, width: int, height: int, aovs: Sequence[str]) -> None:
        self._link = link
        self._source = source
        channels = [(aov, int(source.read_tile(aov, 0).shape[2])) for aov in aovs]
        shape = shape_of(width, height, channels)
        self._film: Film
        self._film, descriptor = create_film(shape)
        # [samples per pixel] By tile: taken so far, and for each AOV those in the film.
        self._taken = np.zeros(shape.tiles, np.uint32)
        self._shown = {aov: np.zeros(shape.tiles, np.uint32) for aov in aovs}
        event = worker_pb2.WorkerEvent(film=worker_pb2.Film(width=width, height=height))
        for plane in shape.planes:
            event.film.aovs.add(name=plane.name, channels=plane.channels, offset=plane.offset)
        try:
            link.send(event, descriptor)
        finally:
            os.close(descriptor)

    @property
    def watched(self) -> bool:
        """Somebody looks."""
        return bool(self._link.wanted_aovs)

    def publish(self, begin: int, end: int, samples: int) -> None:
        """Tiles [begin, end) hold `samples` samples now: show what is new in the AOVs that somebody looks at."""
        self._taken[begin:end] = samples
        for aov in sorted(self._link.wanted_aovs & self._shown.keys()):
            self._show(aov)

    def publish_last(self) -> None:
        """Show `color` as it is in the end, for whoever comes late."""
        self._show("color")

    def publish_coarse(self, image: NDArray[np.float32], scale: int) -> None:
        """Show a `color` in which one pixel stands for `scale` x `scale`; it lies at the upper left of each tile."""
        shape, plane, step = self._film.shape, self._film.planes["color"], TILE // scale
        for tile in range(shape.tiles):
            box = shape.box(tile)
            part = image[box.y // scale :, box.x // scale :][:step, :step]
            plane[box.y : box.y + part.shape[0], box.x : box.x + part.shape[1]] = part
        message = worker_pb2.Tiles(aov="color", indices=range(shape.tiles), samples=0, scale=scale)
        self._link.send(worker_pb2.WorkerEvent(tiles=message))

    def _show(self, aov: str) -> None:
        """Copy the tiles of which there is more than the film has, and say so, grouped by their samples."""
        plane, shown = self._film.planes[aov], self._shown[aov]
        news = np.flatnonzero(shown != self._taken)
        for tile in news.tolist():
            box = self._film.shape.box(tile)
            plane[box.y : box.y + box.height, box.x : box.x + box.width] = self._source.read_tile(aov, tile)
        for samples in np.unique(self._taken[news]).tolist():
            tiles = news[self._taken[news] == samples].tolist()
            message = worker_pb2.Tiles(aov=aov, indices=tiles, samples=samples, scale=1)
            self._link.send(worker_pb2.WorkerEvent(tiles=message))
        shown[:] = self._taken
