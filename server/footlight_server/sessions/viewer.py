"""One viewer of one render: the states, progress and tiles it is owed, and when it may have them."""

import asyncio
import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

from footlight.v1 import render_pb2
from footlight_server.sessions.encoding import Batch, Encoding, TileEncoder
from footlight_server.sessions.tile_queue import TileKey, TileQueue, TileVersion

# [bytes] Of pixels in one batch; with headers below the 256 KB of the protocol.
_BATCH_BYTES = 240 << 10
# [tiles] Tried for one batch: enough to fill it when black compresses to nothing.
_BATCH_TILES = 256
# [1/s] Rounds of tiles at most.
MAX_RATE = 12.0
# [1] Encoding may take this share of one core: the pause after a round is its cost divided by that.
_ENCODING_SHARE = 0.03
# [s] The last tiles may take after the end of the render.
_LINGER = 5.0
# [s] And a viewer, once all is sent, to give back its credit. A grant that crossed the end of the stream would fail the
# call on the client's side, with everything it has not read yet.
_FAREWELL = 0.5


class Viewer:
    """Filled by the session, emptied by the stream that serves it; both on the event loop."""

    def __init__(
        self, aovs: Iterable[str], encoding: Encoding, credit: int, max_rate: float, encoders: ThreadPoolExecutor
    ) -> None:
        self.queue = TileQueue(aovs, credit)
        self._window = credit
        self._encoding = encoding
        self._period = 1.0 / (max_rate or MAX_RATE)
        self._encoders = encoders
        self._encoder: TileEncoder | None = None
        self._renders: deque[render_pb2.Render] = deque()
        self._progress: render_pb2.Progress | None = None
        self._wake = asyncio.Event()
        self._round_cost = 0.0
        self._round_left = 0
        self._next_round = 0.0
        self._linger_until: float | None = None
        self._leave_at: float | None = None

    # --- filled by the session ---

    def show_render(self, render: render_pb2.Render, *, ended: bool) -> None:
        """There is a new state. States are few; none is left out."""
        self._renders.append(render)
        if ended and self._linger_until is None:
            self._linger_until = time.monotonic() + _LINGER
        self._wake.set()

    def show_progress(self, progress: render_pb2.Progress) -> None:
        """There is news of the progress; replaces what was not sent yet."""
        self._progress = progress
        self._wake.set()

    def show_tiles(self, aov: str, tiles: Iterable[int], version: TileVersion, encoder: TileEncoder) -> None:
        """Tiles have new pixels."""
        self._encoder = encoder
        self.queue.mark(aov, tiles, version)
        self._wake.set()

    # --- emptied by the stream ---

    def grant(self, batches: int) -> None:
        """The client has room for more batches."""
        self.queue.grant(batches)
        self._wake.set()

    async def next(self) -> render_pb2.Render | render_pb2.Progress | Batch | None:
        """What to send next; None when the render has ended and everything is sent that can be."""
        while True:
            if self._renders:
                return self._renders.popleft()
            if self._progress is not None:
                progress, self._progress = self._progress, None
                return progress
            now = time.monotonic()
            if self._may_leave(now):
                return None
            if self.queue.ready and (now >= self._next_round or self._linger_until is not None):
                return await self._next_batch()
            await self._wait(now)

    def _may_leave(self, now: float) -> bool:
        """The render has ended, and the viewer has what it can have."""
        if self._linger_until is None:
            return False
        if now >= self._linger_until or (not self.queue and self.queue.credit >= self._window):
            return True
        if not self.queue and self._leave_at is None:
            self._leave_at = now + _FAREWELL
        return self._leave_at is not None and now >= self._leave_at

    async def _wait(self, now: float) -> None:
        """Until there is news, or it is time."""
        times = [t for t in (self._leave_at, self._linger_until, self._due_round()) if t is not None]
        self._wake.clear()
        try:
            async with asyncio.timeout(max(0.0, min(times) - now) if times else None):
                await self._wake.wait()
        except TimeoutError:
            pass

    def _due_round(self) -> float | None:
        return self._next_round if self.queue.ready else None

    async def _next_batch(self) -> Batch:
        assert self._encoder is not None
        if self._round_left <= 0:
            self._round_left = len(self.queue)
        due = self.queue.take(_BATCH_TILES)
        batch, cost = await asyncio.get_running_loop().run_in_executor(
            self._encoders, _encode, self._encoder, due, self._encoding
        )
        self.queue.put_back(dict(list(due.items())[len(batch.tiles) :]))
        self._round_cost += cost
        self._round_left -= len(batch.tiles)
        if self._round_left <= 0:
            self._next_round = time.monotonic() + max(self._period, self._round_cost / _ENCODING_SHARE)
            self._round_cost = 0.0
        return batch


def _encode(encoder: TileEncoder, due: dict[TileKey, TileVersion], encoding: Encoding) -> tuple[Batch, float]:
    """A batch, and the CPU time [s] it took."""
    before = time.thread_time()
    batch = encoder.encode_batch(due.items(), encoding, _BATCH_BYTES)
    return batch, time.thread_time() - before
