"""What the blob store accepts is what its digest says, on disk, once, and charged to whoever sent it."""

import asyncio
import errno
import hashlib
import os
import random
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from footlight_server.blobs import uploads
from footlight_server.blobs.digest import LARGEST_BLOB, Digest, digest_of, digest_of_file
from footlight_server.blobs.ledger import FILE_COST, Ledger, user_folder
from footlight_server.blobs.store import BlobStore, Standing
from footlight_server.blobs.uploads import Uploads
from footlight_server.sessions.errors import (
    BlobsMissingError,
    DigestMismatchError,
    QuotaError,
    StorageError,
    WrongOffsetError,
)
from tests.server.blobs.conftest import OpenStores, Stores

DATA = random.Random(1).randbytes(100_000)
DIGEST = digest_of(DATA)


async def send(blobs: BlobStore, data: bytes, user: str = "ann", offset: int = 0, piece: int = 30_000) -> bool:
    """All of it from `offset` on, in pieces, as a client does; whether the blob is whole then."""
    digest = digest_of(data)
    for at in range(offset, len(data), piece):
        if await blobs.append(user, digest, at, data[at : at + piece]):
            return True
    return False


@pytest.mark.parametrize(
    "text",
    ["", "0", f"{'0' * 64}", f"{'0' * 63}/1", f"{'A' * 64}/1", f"{'0' * 64}/-1", f"{'0' * 64}/01", f"{'0' * 64}/1/../x",
     f"{'0' * 64}/1\n", f"../{'0' * 61}/1", f"{'0' * 64}/{LARGEST_BLOB + 1}", f"{chr(0xFF10) * 64}/1",
     f"{'0' * 64}/\u0967"],
)  # fmt: skip
def test_what_is_no_digest_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        Digest.parse(text)


@given(st.binary(max_size=100))
def test_digests_are_told_apart_again(data: bytes) -> None:
    digest = digest_of(data)
    assert (digest.sha256, digest.size) == (hashlib.sha256(data).hexdigest(), len(data))
    assert Digest.parse(str(digest)) == Digest.from_file_name(digest.file_name) == digest


async def test_a_blob_is_kept_under_its_digest_and_read_only(stores: Stores) -> None:
    assert await stores.blobs.missing([DIGEST]) == [DIGEST]
    with pytest.raises(BlobsMissingError) as caught:
        await stores.blobs.read(DIGEST)
    assert caught.value.digests == (str(DIGEST),)
    await stores.blobs.write("ann", (DIGEST, DATA))
    assert await stores.blobs.missing([DIGEST]) == []
    assert await stores.blobs.read(DIGEST) == DATA
    assert await stores.blobs.total_bytes() == len(DATA)
    assert stores.blobs.path(DIGEST).stat().st_mode & 0o777 == 0o444


async def test_the_size_is_part_of_the_name(stores: Stores) -> None:
    await stores.blobs.write("ann", (DIGEST, DATA))
    other = Digest(DIGEST.sha256, DIGEST.size - 1)
    assert await stores.blobs.missing([other]) == [other]
    with pytest.raises(DigestMismatchError):
        await stores.blobs.write("ann", (other, DATA))


@pytest.mark.parametrize("wrong", [DATA[:-1], DATA + b"x", b"", b"x" + DATA[1:]])
async def test_bytes_that_are_others_than_their_digest_are_refused(stores: Stores, wrong: bytes) -> None:
    with pytest.raises(DigestMismatchError):
        await stores.blobs.write("ann", (DIGEST, wrong))
    assert stores.files() == []


async def test_an_upload_in_pieces_is_whole_with_its_last(stores: Stores) -> None:
    for at in range(0, len(DATA), 30_000):
        assert await stores.blobs.resume("ann", DIGEST) == Standing(at, complete=False)
        whole = await stores.blobs.append("ann", DIGEST, at, DATA[at : at + 30_000])
        assert whole is (at == 90_000)
    assert await stores.blobs.resume("ann", DIGEST) == Standing(len(DATA), complete=True)
    assert await stores.blobs.read(DIGEST) == DATA


async def test_nothing_is_a_blob_too(stores: Stores) -> None:
    empty = digest_of(b"")
    assert await stores.blobs.append("ann", empty, 0, b"")
    assert await stores.blobs.read(empty) == b""


async def test_an_upload_goes_on_after_the_server_was_killed(open_stores: OpenStores) -> None:
    with open_stores() as first:
        await first.blobs.append("ann", DIGEST, 0, DATA[:50_000])
    with open_stores() as second:
        assert await second.blobs.resume("ann", DIGEST) == Standing(50_000, complete=False)
        with pytest.raises(WrongOffsetError, match="50000"):
            await second.blobs.append("ann", DIGEST, 60_000, DATA[60_000:])
        assert await send(second.blobs, DATA, offset=50_000)
        assert await second.blobs.read(DIGEST) == DATA


async def test_a_piece_that_is_here_already_is_passed_over(stores: Stores) -> None:
    await stores.blobs.append("ann", DIGEST, 0, DATA[:50_000])
    assert not await stores.blobs.append("ann", DIGEST, 0, b"?" * 10)
    assert not await stores.blobs.append("ann", DIGEST, 40_000, DATA[40_000:70_000])
    assert (await stores.blobs.resume("ann", DIGEST)).offset == 70_000
    assert await send(stores.blobs, DATA, offset=70_000)


async def test_a_damaged_upload_is_forgotten_and_comes_again(stores: Stores) -> None:
    await stores.blobs.append("ann", DIGEST, 0, b"?" * 50_000)
    with pytest.raises(DigestMismatchError):
        await stores.blobs.append("ann", DIGEST, 50_000, DATA[50_000:])
    with pytest.raises(DigestMismatchError):
        await stores.blobs.append("ann", DIGEST, 0, DATA + b"beyond the end")
    assert await stores.blobs.resume("ann", DIGEST) == Standing(0, complete=False)
    assert await send(stores.blobs, DATA)


async def test_uploads_of_two_users_do_not_touch(stores: Stores) -> None:
    await stores.blobs.append("eve", DIGEST, 0, b"?" * 50_000)
    assert await stores.blobs.resume("ann", DIGEST) == Standing(0, complete=False)
    assert await send(stores.blobs, DATA)
    # The other one's rubbish is not needed any more, and is gone.
    assert await stores.blobs.append("eve", DIGEST, 50_000, b"?")
    assert not any("uploads" in name for name in stores.files())
    assert await stores.blobs.read(DIGEST) == DATA


@pytest.mark.parametrize("users", [("ann", "ann", "ann"), ("ann", "bob", "cid")])
async def test_writers_of_the_same_blob_all_end_well(stores: Stores, users: tuple[str, ...]) -> None:
    wholes = await asyncio.gather(
        *(send(stores.blobs, DATA, user, piece=1000 + 77 * i) for i, user in enumerate(users))
    )
    assert wholes == [True] * len(users)
    assert await stores.blobs.read(DIGEST) == DATA
    assert digest_of_file(stores.blobs.path(DIGEST)) == DIGEST


def test_who_waited_for_an_upload_that_is_gone_begins_another(tmp_path: Path) -> None:
    """Else two threads would write the same file, each under a lock of its own."""
    found = Uploads(tmp_path / "uploads", Ledger(tmp_path / "charges", tmp_path / "uploads", 0))
    folder = user_folder("ann")
    found.append("ann", DIGEST, 0, DATA[:10])
    waiting = threading.Thread(target=found.append, args=("ann", DIGEST, 0, DATA[:20]))
    with found._held(folder, DIGEST) as upload:
        waiting.start()
        time.sleep(0.1)
        found._drop(folder, DIGEST)
    waiting.join(10)
    assert found.size("ann", DIGEST) == 20
    with found._held(folder, DIGEST) as another:
        assert another is not upload
        assert another.size == 20
    assert upload.size == 10


@pytest.mark.parametrize("user", ["..", "/etc/passwd", "a/b", "", "x" * 5000, "ünï\0code"])
async def test_users_with_any_name_have_a_folder(stores: Stores, user: str) -> None:
    await stores.blobs.append(user, DIGEST, 0, DATA[:10])
    await stores.blobs.write(user, (digest_of(b"small"), b"small"))
    inside = stores.root / "blobs"
    assert all((stores.root / name).resolve().is_relative_to(inside) for name in stores.files())
    assert len(stores.files()) == 3


# --- quotas ---


async def test_a_user_has_no_more_than_the_quota(open_stores: OpenStores) -> None:
    room = 2 * (10_000 + FILE_COST)
    first, second, third = (bytes([kind]) * 10_000 for kind in range(3))
    with open_stores(room) as stores:
        await stores.blobs.write("ann", (digest_of(first), first))
        await stores.blobs.write("ann", (digest_of(first), first))  # what is here costs nothing
        await stores.blobs.write("ann", (digest_of(second), second))
        with pytest.raises(QuotaError):
            await stores.blobs.write("ann", (digest_of(third), third))
        with pytest.raises(QuotaError):
            await stores.blobs.append("ann", digest_of(third), 0, third[:1])
        await stores.blobs.write("bob", (digest_of(third), third))
    with open_stores(room) as stores, pytest.raises(QuotaError):  # the books survive the server
        await stores.blobs.write("ann", (digest_of(b"1"), b"1"))


async def test_what_cannot_fit_is_refused_before_it_is_sent(open_stores: OpenStores) -> None:
    with open_stores(100_000) as stores:
        with pytest.raises(QuotaError):
            await stores.blobs.append("ann", Digest(DIGEST.sha256, 1 << 30), 0, b"the beginning")
        assert stores.files() == []


async def test_what_is_on_the_way_counts_and_what_failed_does_not(open_stores: OpenStores) -> None:
    with open_stores(len(DATA) + FILE_COST) as stores:
        await stores.blobs.append("ann", DIGEST, 0, DATA[:50_000])
        with pytest.raises(QuotaError):
            await stores.blobs.write("ann", (digest_of(DATA[1:]), DATA[1:]))
        with pytest.raises(DigestMismatchError):
            await stores.blobs.append("ann", DIGEST, 50_000, b"?" * 50_000)
        assert await send(stores.blobs, DATA)
        assert stores.blobs._ledger.used("ann") == len(DATA) + FILE_COST


async def test_two_who_send_the_same_at_once_pay_once_each(open_stores: OpenStores) -> None:
    with open_stores(10 * len(DATA)) as stores:
        await asyncio.gather(*(stores.blobs.write("ann", (DIGEST, DATA)) for _ in range(8)))
        used = stores.blobs._ledger.used("ann")
    with open_stores(10 * len(DATA)) as stores:
        assert used == stores.blobs._ledger.used("ann") == len(DATA) + FILE_COST


async def test_a_user_has_so_many_uploads_on_the_way(stores: Stores, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MOST_UPLOADS", 3)
    for size in range(11, 14):
        await stores.blobs.append("ann", Digest("0" * 64, size), 0, b"begun")
    with pytest.raises(QuotaError):
        await stores.blobs.append("ann", Digest("0" * 64, 20), 0, b"begun")
    await stores.blobs.append("bob", Digest("0" * 64, 20), 0, b"begun")


# --- disks ---


async def test_a_full_disk_is_said_and_the_upload_goes_on_later(
    stores: Stores, monkeypatch: pytest.MonkeyPatch
) -> None:
    await stores.blobs.append("ann", DIGEST, 0, DATA[:30_000])
    before = stores.blobs._ledger.used("ann")

    def full(handle: int, data: bytes) -> int:
        os.pwrite(handle, bytes(data)[:7], os.fstat(handle).st_size)  # some of it still fits
        raise OSError(errno.ENOSPC, "No space left on device", str(stores.root))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(StorageError, match="No space left") as caught:
            await stores.blobs.append("ann", DIGEST, 30_000, DATA[30_000:60_000])
        assert str(stores.root) not in str(caught.value)
    assert stores.blobs._ledger.used("ann") == before
    assert (await stores.blobs.resume("ann", DIGEST)).offset == 30_000
    assert await send(stores.blobs, DATA, offset=30_000)


async def test_a_blob_has_its_name_only_once_it_is_on_disk(stores: Stores, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    sync, rename = os.fsync, Path.replace

    def fsync(handle: int) -> None:
        kind = "directory" if Path(f"/proc/self/fd/{handle}").is_dir() else "file"
        done.append(f"sync {kind}")
        sync(handle)

    def replace(self: Path, target: Path) -> Path:
        done.append("rename")
        return rename(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", replace)
    await stores.blobs.write("ann", (DIGEST, DATA))
    await send(stores.blobs, DATA[1:])
    for _ in range(2):
        at = done.index("rename")
        assert "sync file" in done[:at]
        assert done[at + 1] == "sync directory"
        done = done[at + 2 :]


async def test_all_of_a_call_is_kept_or_nothing(open_stores: OpenStores) -> None:
    blobs = [(digest_of(data), data) for data in (b"a", b"b" * 5000, b"c", b"a")]
    with open_stores(20_000) as stores:
        with pytest.raises(DigestMismatchError):
            await stores.blobs.write("ann", *blobs, (digest_of(b"d"), b"e"))
        with pytest.raises(QuotaError):
            await stores.blobs.write("ann", *blobs, (digest_of(DATA), DATA))
        assert stores.files() == []
        await stores.blobs.write("ann", *blobs)
        assert await stores.blobs.missing([digest for digest, _ in blobs]) == []
        assert stores.blobs._ledger.used("ann") == 5002 + 3 * FILE_COST


async def test_nothing_stays_in_memory_of_uploads_that_were_refused(stores: Stores) -> None:
    for number in range(20):
        with pytest.raises(WrongOffsetError):
            await stores.blobs.append("ann", digest_of(bytes(20) + bytes([number])), 7, b"x")
    assert stores.blobs._uploads._uploads == {}
