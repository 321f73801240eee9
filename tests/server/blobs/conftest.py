"""A blob store in a directory of its own, under a clock that the test moves."""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from footlight_server.blobs.bundle import BundleStore
from footlight_server.blobs.store import BlobStore


@dataclass
class Clock:
    """Of the wall, in [s since 1970]."""

    now: float = 1_800_000_000.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Stores:
    """Both stores of one data folder, as a server has them."""

    blobs: BlobStore
    bundles: BundleStore
    root: Path
    clock: Clock = field(default_factory=Clock)

    def files(self) -> list[str]:
        """All of the blob store's files, relative."""
        return sorted(str(path.relative_to(self.root)) for path in self.root.rglob("*") if path.is_file())


OpenStores = Callable[..., AbstractContextManager[Stores]]


@pytest.fixture
def open_stores(tmp_path: Path) -> OpenStores:
    """Opens the stores of the test's data folder; again, as a server that was started anew does."""
    clock = Clock()

    @contextlib.contextmanager
    def opened(quota: int = 0) -> Iterator[Stores]:
        blobs = BlobStore(tmp_path / "data" / "blobs", quota, clock)
        try:
            yield Stores(blobs, BundleStore(blobs, tmp_path / "data" / "bundles", clock), tmp_path / "data", clock)
        finally:
            blobs.close()

    return opened


@pytest.fixture
def stores(open_stores: OpenStores) -> Iterator[Stores]:
    """Both stores, without a quota."""
    with open_stores() as opened:
        yield opened
