"""Removes what nobody needs: blobs, layouts of bundles, uploads that were given up."""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import astuple, dataclass

from footlight_server.blobs.bundle import BundleStore
from footlight_server.blobs.store import BlobStore

log = logging.getLogger(__name__)

# [s] What the protocol promises, whatever --keep-blobs says: to blobs since they were asked for, to uploads since the
# last byte.
DAY = 86400.0
# [s] Between two sweeps; for asking what is needed; for one sweep.
_EVERY = 3600.0
_ASKING = 60.0
_SWEEPING = 3600.0

# The names of the bundles that jobs and running renders need, `{sha256}/{size}`.
InUse = Callable[[], Awaitable[AbstractSet[str]]]


@dataclass(frozen=True, slots=True)
class Swept:
    """What a sweep has removed: [bytes] of blobs and of uploads, [bundles] laid out."""

    blob_bytes: int
    upload_bytes: int
    bundles: int


async def sweep(blobs: BlobStore, bundles: BundleStore, in_use: AbstractSet[str], keep: float, now: float) -> Swept:
    """Remove what no bundle in use needs and nobody has asked for in the last `keep` [s], a day at least.

    `now` [s since 1970] is by the same clock as the stores'.
    """
    return await blobs.run(_sweep, blobs, bundles, in_use, now - max(keep, DAY), now - DAY, patience=_SWEEPING)


def _sweep(blobs: BlobStore, bundles: BundleStore, in_use: AbstractSet[str], before: float, stale: float) -> Swept:
    """Blocks."""
    needed = {digest for name in in_use for digest in bundles.needed_by(name)}
    return Swept(
        bundles=bundles.remove_unless(needed, before),
        blob_bytes=blobs.remove_unless(needed, before),
        upload_bytes=blobs.drop_partials(stale),
    )


class Sweeper:
    """Sweeps every hour, from `start` to `close`. A sweep that fails is logged, and the next one tries again."""

    def __init__(
        self,
        blobs: BlobStore,
        bundles: BundleStore,
        in_use: InUse,
        keep: float,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._blobs = blobs
        self._bundles = bundles
        self._in_use = in_use
        self._keep = keep
        self._clock = clock
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin, with a sweep at once."""
        self._task = asyncio.create_task(self._run(), name="blob sweeper")

    async def close(self) -> None:
        """End."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def once(self) -> Swept:
        """One sweep. If it is not known what is needed, nothing is removed."""
        async with asyncio.timeout(_ASKING):
            in_use = await self._in_use()
        swept = await sweep(self._blobs, self._bundles, in_use, self._keep, self._clock())
        if swept != Swept(0, 0, 0):
            log.info("swept bytes of blobs: %d, of uploads: %d; bundles: %d", *astuple(swept))
        return swept

    async def _run(self) -> None:
        while True:
            try:
                await self.once()
            except Exception:
                log.exception("the sweep of blobs failed")
            await asyncio.sleep(_EVERY)
