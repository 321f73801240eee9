"""The sweep removes what nobody needs and nobody asked for lately, and nothing else."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from footlight_server.blobs import sweep as sweeps
from footlight_server.blobs.digest import Digest, digest_of
from footlight_server.blobs.ledger import FILE_COST
from footlight_server.blobs.store import Standing
from footlight_server.blobs.sweep import DAY, Sweeper, Swept, sweep
from footlight_server.sessions.errors import StorageError
from tests.server.blobs.conftest import OpenStores, Stores
from tests.server.blobs.test_bundle import FILES, add, content, leftovers

OTHER = {"other.usda": b"#usda 1.0 other", "tex/a.png": b"a"}


async def test_what_is_in_use_stays_and_the_rest_goes(stores: Stores) -> None:
    used, unused = await add(stores, FILES), await add(stores, OTHER)
    root, gone = [await stores.bundles.materialise(name) for name in (used, unused)]
    stores.clock.now += 8 * DAY
    swept = await sweep(stores.blobs, stores.bundles, {used}, 7 * DAY, stores.clock.now)
    assert swept == Swept(blob_bytes=len(OTHER["other.usda"]) + Digest.parse(unused).size, upload_bytes=0, bundles=1)
    assert content(root) == FILES
    assert not gone.exists()
    await stores.bundles.keep(used)
    assert await stores.blobs.missing([digest_of(OTHER["other.usda"])])
    assert leftovers(stores) == [root.name]


async def test_a_bundle_in_use_is_laid_out_again_from_what_stayed(stores: Stores) -> None:
    name = await add(stores, FILES)
    stores.clock.now += 30 * DAY
    assert await sweep(stores.blobs, stores.bundles, {name}, DAY, stores.clock.now) == Swept(0, 0, 0)
    assert content(await stores.bundles.materialise(name)) == FILES


@pytest.mark.parametrize("keep", [0.0, DAY, 3 * DAY])
async def test_what_was_asked_for_is_kept_for_that_long_and_a_day_at_least(stores: Stores, keep: float) -> None:
    name = await add(stores, FILES)
    root = await stores.bundles.materialise(name)
    for _ in range(2):
        await stores.bundles.materialise(name)
        await stores.bundles.keep(name)
        stores.clock.now += max(keep, DAY) - 1
        assert await sweep(stores.blobs, stores.bundles, set(), keep, stores.clock.now) == Swept(0, 0, 0)
    stores.clock.now += 2
    swept = await sweep(stores.blobs, stores.bundles, set(), keep, stores.clock.now)
    assert (swept.bundles, root.exists()) == (1, False)
    assert stores.files() == []


async def test_find_missing_keeps_what_it_finds(stores: Stores) -> None:
    await stores.blobs.write("ann", (digest_of(b"a"), b"a"))
    await stores.blobs.write("ann", (digest_of(b"b"), b"b"))
    stores.clock.now += 2 * DAY
    assert await stores.blobs.missing([digest_of(b"a")]) == []
    await sweep(stores.blobs, stores.bundles, set(), DAY, stores.clock.now)
    assert await stores.blobs.missing([digest_of(b"a"), digest_of(b"b")]) == [digest_of(b"b")]


async def test_uploads_that_were_given_up_go_after_a_day_and_give_their_room_back(open_stores: OpenStores) -> None:
    data = b"x" * 10_000
    with open_stores(len(data) + FILE_COST) as stores:
        await stores.blobs.append("ann", digest_of(data), 0, data[:5000])
        half = digest_of(data)
        now = (stores.root / "blobs" / next(name for name in _partials(stores))).stat().st_mtime
        assert (await sweep(stores.blobs, stores.bundles, set(), DAY, now + DAY - 1)).upload_bytes == 0
        assert await stores.blobs.resume("ann", half) == Standing(5000, complete=False)
        assert (await sweep(stores.blobs, stores.bundles, set(), 9 * DAY, now + DAY + 1)).upload_bytes == 5000
        assert await stores.blobs.resume("ann", half) == Standing(0, complete=False)
        assert stores.blobs._ledger.used("ann") == 0
        assert await stores.blobs.append("ann", half, 0, data)


def _partials(stores: Stores) -> list[str]:
    return [name.removeprefix("blobs/") for name in stores.files() if name.startswith("blobs/uploads/")]


async def test_swept_blobs_are_not_charged_any_more(open_stores: OpenStores) -> None:
    data = b"x" * 10_000
    with open_stores(len(data) + FILE_COST) as stores:
        await stores.blobs.write("ann", (digest_of(data), data))
        stores.clock.now += 2 * DAY
        await sweep(stores.blobs, stores.bundles, set(), DAY, stores.clock.now)
        await stores.blobs.write("ann", (digest_of(data[1:]), data[1:]))
    with open_stores(len(data) + FILE_COST) as stores:
        assert stores.blobs._ledger.used("ann") == len(data) - 1 + FILE_COST


async def test_what_a_killed_server_was_making_goes(open_stores: OpenStores) -> None:
    with open_stores() as stores:
        await stores.bundles.materialise(await add(stores, FILES))
        half = stores.root / "bundles" / ".temporary-of-a-dead-server"
        (half / "tex").mkdir(parents=True)
        (half / "tex" / "a.png").write_bytes(b"a")
        (half / "tex").chmod(0o555)
        await sweep(stores.blobs, stores.bundles, set(), DAY, stores.clock.now)
        assert not half.exists()
        assert len(leftovers(stores)) == 1


async def test_a_name_that_is_none_stops_no_sweep(stores: Stores) -> None:
    await stores.blobs.write("ann", (digest_of(b"a"), b"a"))
    stores.clock.now += 2 * DAY
    in_use = {"", "../..", str(digest_of(b"never uploaded")), str(digest_of(b"a"))}
    assert await sweep(stores.blobs, stores.bundles, in_use, DAY, stores.clock.now) == Swept(0, 0, 0)


@settings(max_examples=20)
@given(st.lists(st.tuples(st.sampled_from(["ask", "sweep", "lay out", "use", "release", "wait"]), st.booleans())))
def test_nothing_is_lost_between_asking_and_using(story: list[tuple[str, bool]]) -> None:
    """Whatever happens: a bundle in use, or asked for in the last day, is whole."""
    import tempfile
    from pathlib import Path

    from footlight_server.blobs.bundle import BundleStore
    from footlight_server.blobs.store import BlobStore
    from tests.server.blobs.conftest import Clock

    async def run(data: Path) -> None:
        clock = Clock()
        blobs = BlobStore(data / "blobs", 0, clock)
        stores = Stores(blobs, BundleStore(blobs, data / "bundles", clock), data, clock)
        names = [await add(stores, FILES), await add(stores, OTHER)]
        used: set[str] = set()
        asked = dict.fromkeys(names, clock.now)
        for what, first in story:
            name = names[0 if first else 1]
            due = name in used or clock.now - asked[name] <= DAY
            match what:
                case "ask" if due:
                    await stores.bundles.keep(name)
                    asked[name] = clock.now
                case "lay out" if due:
                    assert content(await stores.bundles.materialise(name)) == (FILES if first else OTHER)
                case "use" if due:
                    used.add(name)
                case "release" if name in used:
                    await stores.bundles.keep(name)
                    asked[name] = clock.now
                    used.discard(name)
                case "sweep":
                    await sweep(stores.blobs, stores.bundles, used, 0.0, clock.now)
                case "wait":
                    clock.now += 0.6 * DAY
        blobs.close()

    with tempfile.TemporaryDirectory() as directory:
        asyncio.run(run(Path(directory)))


# --- the sweeper ---


def in_use(*answers: set[str] | Exception) -> Callable[[], Awaitable[set[str]]]:
    """Answers in turn, the last one for ever."""
    rest = list(answers)

    async def answer() -> set[str]:
        found = rest.pop(0) if len(rest) > 1 else rest[0]
        if isinstance(found, Exception):
            raise found
        return found

    return answer


async def test_nothing_is_removed_while_it_is_not_known_what_is_needed(
    stores: Stores, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(sweeps, "_EVERY", 0.05)
    name = await add(stores, FILES)
    stores.clock.now += 2 * DAY
    sweeper = Sweeper(stores.blobs, stores.bundles, in_use(StorageError("locked")), 0.0, stores.clock)
    sweeper.start()
    await asyncio.sleep(0.2)
    await sweeper.close()
    assert "locked" in caplog.text
    await stores.bundles.keep(name)


async def test_the_sweeper_goes_on_after_a_failure(
    stores: Stores, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(sweeps, "_EVERY", 0.05)
    await add(stores, FILES)
    stores.clock.now += 2 * DAY
    sweeper = Sweeper(stores.blobs, stores.bundles, in_use(StorageError("locked"), set()), 0.0, stores.clock)
    sweeper.start()
    async with asyncio.timeout(10):
        while stores.files():
            await asyncio.sleep(0.02)
    await sweeper.close()
    assert "locked" in caplog.text
