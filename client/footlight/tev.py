"""Pixels to an image viewer that speaks tev's protocol over TCP: tev, HDRView."""

import asyncio
import contextlib
from collections import OrderedDict
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from footlight.errors import FootlightError
from footlight.image import TileBatch

# [s] For connecting, and for the viewer to take a batch in.
TIMEOUT = 10.0
# [images] That are left open in the viewer: it holds every one of them in memory, as float32.
KEPT = 8
# Of `color`.
CHANNELS = ["R", "G", "B"]


class NoViewerError(FootlightError):
    """No viewer can be reached, or what it takes to speak to one is not installed."""


class TevViewer:
    """A viewer at `host`:`port`. Connects with the first pixels, and anew after the viewer was away.

    Raises NoViewerError at once if tevclient is not installed. Not for two tasks at the same time.
    """

    def __init__(self, host: str, port: int) -> None:
        if find_spec("tevclient") is None:
            raise NoViewerError("sending to a viewer takes tevclient: pip install 'footlight[tev]'")
        # tev's packets; the connection is ours, because tevclient's knows no deadline.
        self._packet: Any = import_module("tevclient.packet")
        self._host = host
        self._port = port
        self._writer: asyncio.StreamWriter | None = None
        # Name -> epoch of what it shows.
        self._open: OrderedDict[str, int] = OrderedDict()

    async def show(self, name: str, batch: TileBatch) -> None:
        """Draw the colour of a batch into the image `name`, which is opened if it is not. Raises NoViewerError."""
        packets = [] if self._open.get(name) == batch.epoch else self._create(name, batch)
        packets += [
            self._packet.update_image(name, tile.pixels, CHANNELS, tile.x, tile.y, grab_focus=False)
            for tile in batch.tiles
            if tile.aov == "color"
        ]
        try:
            async with asyncio.timeout(TIMEOUT):
                if self._writer is None:
                    _, self._writer = await asyncio.open_connection(self._host, self._port)
                for packet in packets:
                    self._writer.write(packet)
                    await self._writer.drain()
        except (OSError, TimeoutError) as error:
            self._drop()
            why = error.strerror if isinstance(error, OSError) and error.strerror else "it does not take anything in"
            raise NoViewerError(f"no viewer at {self._host}:{self._port}: {why}") from error

    def _create(self, name: str, batch: TileBatch) -> list[Any]:
        """A new, empty image; the oldest goes if there are too many."""
        fresh = name not in self._open
        self._open[name] = batch.epoch
        packets = [self._packet.create_image(name, batch.width, batch.height, CHANNELS, grab_focus=fresh)]
        while len(self._open) > KEPT:
            oldest, _ = self._open.popitem(last=False)
            packets.append(self._packet.close_image(oldest))
        return packets

    async def close(self) -> None:
        """Let the viewer go when it has taken in what was sent; its images stay."""
        if self._writer is not None:
            self._writer.close()
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(TIMEOUT):
                    await self._writer.wait_closed()
        self._drop()

    def _drop(self) -> None:
        """Forget the connection, and what was still to be sent over it."""
        if self._writer is not None:
            self._writer.transport.abort()
        self._writer = None
        self._open.clear()
