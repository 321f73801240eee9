"""A bundle is laid out as its message says, whole or not at all, and nothing in it can be changed."""

import asyncio
import errno
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from footlight.v1 import blob_service_pb2
from footlight_server.blobs import bundle as bundles
from footlight_server.blobs import place as places
from footlight_server.blobs.digest import Digest, digest_of, digest_of_file
from footlight_server.blobs.place import Placer
from footlight_server.sessions.errors import BlobsMissingError, InvalidFieldsError, StorageError
from tests.server.blobs.conftest import OpenStores, Stores

FILES = {"stage.usda": b"#usda 1.0\n", "tex/a.png": b"a", "tex/deep/b.png": b"b", "again.png": b"a", "empty": b""}


async def add(stores: Stores, files: Mapping[str, bytes], *, without: tuple[str, ...] = ()) -> str:
    """Upload a bundle of these files, all but the contents of some; its name."""
    message = blob_service_pb2.Bundle()
    for path, data in files.items():
        digest = digest_of(data)
        message.files.add(path=path, digest=blob_service_pb2.Digest(sha256=digest.sha256, size_bytes=digest.size))
        if path not in without:
            await stores.blobs.write("ann", (digest, data))
    return await add_message(stores, message.SerializeToString(deterministic=True))


async def add_message(stores: Stores, data: bytes) -> str:
    await stores.blobs.write("ann", (digest_of(data), data))
    return str(digest_of(data))


def content(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if not path.is_dir()}


def leftovers(stores: Stores) -> list[str]:
    root = stores.root / "bundles"
    return sorted(path.name for path in root.iterdir()) if root.exists() else []


async def test_a_bundle_is_laid_out_read_only(stores: Stores) -> None:
    root = await stores.bundles.materialise(await add(stores, FILES))
    assert content(root) == FILES
    for path in [root, *root.rglob("*")]:
        assert not path.is_symlink()
        assert path.stat().st_mode & 0o777 == (0o555 if path.is_dir() else 0o444)


async def test_a_second_call_finds_the_first_ones_work(open_stores: OpenStores) -> None:
    with open_stores() as stores:
        name = await add(stores, FILES)
        roots = await asyncio.gather(*(stores.bundles.materialise(name) for _ in range(10)))
        assert len(set(roots)) == 1
        inode = (roots[0] / "stage.usda").stat().st_ino, roots[0].stat().st_ino
    with open_stores() as stores:
        assert await stores.bundles.materialise(name) == roots[0]
        assert ((roots[0] / "stage.usda").stat().st_ino, roots[0].stat().st_ino) == inode
        assert leftovers(stores) == [roots[0].name]


async def test_a_caller_that_gives_up_does_not_stop_the_others(stores: Stores) -> None:
    name = await add(stores, FILES)
    hasty = asyncio.create_task(stores.bundles.materialise(name))
    patient = asyncio.create_task(stores.bundles.materialise(name))
    await asyncio.sleep(0)
    hasty.cancel()
    assert content(await patient) == FILES
    assert hasty.cancelled()


async def test_what_is_missing_is_listed(stores: Stores) -> None:
    with pytest.raises(BlobsMissingError) as caught:
        await stores.bundles.materialise(str(digest_of(b"nowhere")))
    assert caught.value.digests == (str(digest_of(b"nowhere")),)
    name = await add(stores, FILES, without=("tex/a.png", "again.png", "tex/deep/b.png"))
    for call in (stores.bundles.materialise(name), stores.bundles.keep(name)):
        with pytest.raises(BlobsMissingError) as caught:
            await call
        assert set(caught.value.digests) == {str(digest_of(b"a")), str(digest_of(b"b"))}
    assert leftovers(stores) == []
    await add(stores, FILES)
    assert content(await stores.bundles.materialise(name)) == FILES


async def test_the_stage_has_to_be_in_the_bundle(stores: Stores) -> None:
    name = await add(stores, FILES)
    await stores.bundles.keep(name)
    await stores.bundles.keep(name, "tex/a.png")
    for path in ("tex", "stage.usd", "/etc/passwd", "../stage.usda", "tex/../stage.usda"):
        with pytest.raises(InvalidFieldsError) as caught:
            await stores.bundles.keep(name, path, "spec.layers[2].render")
        assert [violation.field for violation in caught.value.violations] == ["spec.layers[2].render.stage_path"]


@pytest.mark.parametrize("paths", [["../x"], ["/x"], ["a", "A"], ["a", "a/b"], ["nul"], ["a\0b"], [""], []])
async def test_a_bundle_that_reaches_out_is_refused(stores: Stores, paths: list[str]) -> None:
    name = await add(stores, dict.fromkeys(paths, b"harm"))
    for call in (stores.bundles.materialise(name), stores.bundles.keep(name)):
        with pytest.raises(InvalidFieldsError):
            await call
    assert leftovers(stores) == []
    assert not any("harm" in data.decode(errors="ignore") for data in content(stores.root / "bundles").values())


async def test_a_blob_that_is_no_bundle_is_refused(stores: Stores) -> None:
    wrong = blob_service_pb2.Bundle()
    wrong.files.add(path="a", digest=blob_service_pb2.Digest(sha256="../../x", size_bytes=1))
    for data in (b"\xff\xff\xff", b"", wrong.SerializeToString()):
        with pytest.raises(InvalidFieldsError):
            await stores.bundles.materialise(await add_message(stores, data))
    whole = Digest.parse(await add(stores, FILES))
    await stores.bundles.materialise(str(whole))
    with pytest.raises(BlobsMissingError):  # the same hash, but it is no name of these bytes
        await stores.bundles.materialise(f"{whole.sha256}/{whole.size + 1}")
    for name in ("", "x", "../..", f"{'0' * 64}/{1 << 50}", f"{'0' * 64}/{bundles.LARGEST_BUNDLE + 1}"):
        with pytest.raises(InvalidFieldsError):
            await stores.bundles.materialise(name)


async def test_files_are_counted(stores: Stores, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundles, "MOST_FILES", len(FILES) - 1)
    name = await add(stores, FILES)
    with pytest.raises(InvalidFieldsError, match="5 files"):
        await stores.bundles.keep(name)


@pytest.mark.parametrize("which", ["tex/a.png", None])
async def test_a_blob_that_the_disk_has_spoiled_has_to_come_again(stores: Stores, which: str | None) -> None:
    name = await add(stores, FILES)
    spoiled = Digest.parse(name) if which is None else digest_of(FILES[which])
    path = stores.blobs.path(spoiled)
    path.chmod(0o600)
    path.write_bytes(b"?" * spoiled.size)
    with pytest.raises(BlobsMissingError) as caught:
        await stores.bundles.materialise(name)
    assert caught.value.digests == (str(spoiled),)
    assert leftovers(stores) == []
    await add(stores, FILES)
    assert content(await stores.bundles.materialise(name)) == FILES


async def test_a_disk_that_fills_up_leaves_nothing(stores: Stores, monkeypatch: pytest.MonkeyPatch) -> None:
    name = await add(stores, FILES)
    done: list[Path] = []
    place = Placer.place

    def full(placer: Placer, source: Path, path: Path) -> None:
        if len(done) == 3:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        done.append(path)
        place(placer, source, path)

    with monkeypatch.context() as patch:
        patch.setattr(Placer, "place", full)
        with pytest.raises(StorageError, match="No space left"):
            await stores.bundles.materialise(name)
    assert leftovers(stores) == []
    assert content(await stores.bundles.materialise(name)) == FILES


# --- the ways to place a file ---


def test_a_file_is_placed_without_a_copy_where_that_can_be(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.write_bytes(b"data")
    source.chmod(0o444)
    Placer().place(source, tmp_path / "placed")
    assert (tmp_path / "placed").read_bytes() == b"data"
    cloned = (tmp_path / "placed").stat().st_ino != source.stat().st_ino
    assert cloned or source.stat().st_nlink == 2


@pytest.mark.parametrize("number", sorted(places._NO_LINK))
def test_a_file_is_copied_where_it_cannot_be_linked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    source = tmp_path / "source"
    source.write_bytes(b"data" * 1000)

    def refuse(*_: object) -> None:
        raise OSError(number, "refused")

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(fcntl, "ioctl", refuse)
    Placer().place(source, tmp_path / "placed")
    placed = tmp_path / "placed"
    assert digest_of_file(placed) == digest_of_file(source)
    assert placed.stat().st_ino != source.stat().st_ino
    assert placed.stat().st_mode & 0o777 == 0o444


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_not_taken_for_one_that_cannot_clone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    (tmp_path / "source").write_bytes(b"data")

    def refuse(*_: object) -> None:
        raise OSError(number, "refused")

    monkeypatch.setattr(fcntl, "ioctl", refuse)
    with pytest.raises(OSError, match="refused"):
        Placer().place(tmp_path / "source", tmp_path / "placed")


def test_nothing_is_placed_over_another_file(tmp_path: Path) -> None:
    for name in ("source", "there"):
        (tmp_path / name).write_bytes(name.encode())
    with pytest.raises(FileExistsError):
        Placer().place(tmp_path / "source", tmp_path / "there")
    assert (tmp_path / "there").read_bytes() == b"there"


def test_a_file_with_too_many_names_is_copied_seldom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As often as the file system's limit asks for; a bundle may name one large file a hundred thousand times."""
    link = os.link

    def limited(source: Path, path: Path) -> None:
        if source.stat().st_nlink >= 10:
            raise OSError(errno.EMLINK, "Too many links")
        link(source, path)

    monkeypatch.setattr(places, "_clone", lambda *_: False)
    monkeypatch.setattr(os, "link", limited)
    source = tmp_path / "source"
    source.write_bytes(b"x")
    placer = Placer()
    for number in range(40):
        placer.place(source, tmp_path / str(number))
    assert len({path.stat().st_ino for path in tmp_path.iterdir()}) == 5
