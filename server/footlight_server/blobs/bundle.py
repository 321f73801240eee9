"""Bundles: the files of a stage, laid out read-only below one directory."""

import asyncio
import os
import shutil
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from google.protobuf.message import DecodeError

from footlight.v1 import blob_service_pb2
from footlight_server.blobs.digest import Digest, digest_of, digest_of_file
from footlight_server.blobs.durable import make_directory, sync_directory
from footlight_server.blobs.paths import bundle_fault
from footlight_server.blobs.place import Placer
from footlight_server.blobs.store import BlobStore
from footlight_server.sessions.errors import BlobsMissingError, FieldViolation, InvalidFieldsError, TimeLimitError

# Said in the protocol: [files] in a bundle, and [bytes] of the message.
MOST_FILES = 100_000
LARGEST_BUNDLE = 64 << 20
# [s] To lay a bundle out; all of it is read once, to be sure of it.
_PATIENCE = 3600.0
# What is being made, or on its way out.
_TEMPORARY = ".temporary-"


@dataclass(frozen=True, slots=True)
class BundleFile:
    """One file; `path` is relative and was checked."""

    path: str
    digest: Digest


class BundleStore:
    """Bundles laid out below `root`; their files are those of `blobs`, shared where the file system can.

    A bundle is named `{sha256}/{size}` of its serialized Bundle message, as in RenderSpec.bundle. Every coroutine that
    takes such a name raises InvalidFieldsError if it is none, or its blob is no Bundle, or holds paths that are not
    allowed; BlobsMissingError listing what has to be uploaded first; and StorageError.
    """

    def __init__(self, blobs: BlobStore, root: Path, clock: Callable[[], float] = time.time) -> None:
        self._blobs = blobs
        self._root = root
        self._clock = clock
        self._making: dict[Digest, asyncio.Task[Path]] = {}
        # Names of directories that this process works on.
        self._temporary: set[str] = set()
        # Between a look at when a layout was last asked for and its removal nobody may ask for it.
        self._removal = threading.Lock()

    async def keep(self, name: str, stage_path: str = "", where: str = "spec") -> None:
        """All of the bundle is here, `stage_path` with it if one is given, and stays for a day at least from now on.

        `where` is the path of the RenderSpec in the request, for naming the field at fault.
        """
        await self._blobs.run(self._keep, name, stage_path, where)

    async def materialise(self, name: str) -> Path:
        """The directory with the bundle's files: regular, read-only, their bytes checked against their digests.

        A second call finds the first one's directory; calls at the same time wait for the same work, which goes on if a
        caller gives up. Raises StorageError if the disk is full.
        """
        digest = bundle_digest(name)
        making = self._making.get(digest)
        if making is None:
            making = asyncio.create_task(self._make_once(digest), name=f"bundle {name}")
            self._making[digest] = making
            making.add_done_callback(lambda task: self._made(digest, task))
        try:
            async with asyncio.timeout(_PATIENCE):
                return await asyncio.shield(making)
        except TimeoutError:
            raise TimeLimitError(f"bundle {name}: not laid out after {_PATIENCE:g} s") from None

    async def close(self) -> None:
        """Stop what is being laid out; what is half done goes with the next sweep."""
        tasks = list(self._making.values())
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=5.0)

    # --- for the sweep ---

    def needed_by(self, name: str) -> Iterator[Digest]:
        """The blobs of a bundle, itself first, as far as they are here. Blocks."""
        with suppress(BlobsMissingError, InvalidFieldsError):
            digest = bundle_digest(name)
            yield digest
            yield from (file.digest for file in self._files(digest))

    def remove_unless(self, needed: AbstractSet[Digest], before: float) -> int:
        """Remove layouts that are not needed and were last asked for before [s since 1970]; how many. Blocks."""
        names = {digest.file_name for digest in needed}
        entries = list(self._root.iterdir()) if self._root.is_dir() else []
        layouts = [path for path in entries if not path.name.startswith(_TEMPORARY) and path.name not in names]
        removed = sum(self._retire(path, before) for path in layouts)
        for path in list(self._root.glob(f"{_TEMPORARY}*")):
            if path.name not in self._temporary:
                _remove_tree(path)
        return removed

    # --- laying out ---

    async def _make_once(self, digest: Digest) -> Path:
        return await self._blobs.run(self._make, digest, patience=_PATIENCE)

    def _made(self, digest: Digest, task: asyncio.Task[Path]) -> None:
        self._making.pop(digest, None)
        if not task.cancelled():
            task.exception()  # whoever waited was told

    def _make(self, digest: Digest) -> Path:
        """Blocks."""
        path = self._root / digest.file_name
        now = self._clock()
        with self._removal, suppress(FileNotFoundError):
            os.utime(path, (now, now))
            return path
        files = self._files(digest)
        self._require([file.digest for file in files])
        self._check({file.digest for file in files})
        make_directory(self._root)
        temporary = self._root / f"{_TEMPORARY}{uuid.uuid4().hex}"
        self._temporary.add(temporary.name)
        try:
            self._lay_out(temporary, files)
            os.utime(temporary, (now, now))
            temporary.rename(path)
            sync_directory(self._root)
        finally:
            if temporary.exists():
                _remove_tree(temporary)
            self._temporary.remove(temporary.name)
        return path

    def _retire(self, path: Path, before: float) -> bool:
        """Take its name from a layout that was last asked for before; the rest goes with what is temporary."""
        with self._removal:
            if path.stat().st_mtime >= before:
                return False
            path.rename(self._root / f"{_TEMPORARY}{uuid.uuid4().hex}")
            return True

    def _keep(self, name: str, stage_path: str, where: str) -> None:
        """Blocks."""
        try:
            digest = bundle_digest(name)
            files = self._files(digest)
            self._require([digest, *(file.digest for file in files)])
            if stage_path and all(file.path != stage_path for file in files):
                raise _refusal("stage_path", f"{stage_path!r} is not a file of the bundle")
        except InvalidFieldsError as error:
            violations = [FieldViolation(f"{where}.{each.field}", each.description) for each in error.violations]
            raise InvalidFieldsError(violations) from None

    def _lay_out(self, root: Path, files: list[BundleFile]) -> None:
        root.mkdir()
        placer = Placer()
        directories = {root}
        for file in files:
            path = root / file.path
            if path.parent not in directories:
                path.parent.mkdir(parents=True, exist_ok=True)
                directories.update(parent for parent in path.parents if parent.is_relative_to(root))
            placer.place(self._blobs.path(file.digest), path)
        for directory in sorted(directories, reverse=True):  # the inner ones first
            sync_directory(directory)
            directory.chmod(0o555)

    def _files(self, digest: Digest) -> list[BundleFile]:
        """What the bundle consists of. Blocks."""
        if digest.size > LARGEST_BUNDLE:
            raise _refusal("bundle", f"{digest.size} bytes: a Bundle has at most {LARGEST_BUNDLE}")
        data = self._blobs.read_now(digest)
        if digest_of(data) != digest:
            self._blobs.remove_damaged(digest)
            raise BlobsMissingError(f"bundle {digest} is damaged; upload it again", [str(digest)])
        try:
            message = blob_service_pb2.Bundle.FromString(data)
        except DecodeError:
            raise _refusal("bundle", f"{digest} is no Bundle message") from None
        return _checked(message)

    def _require(self, digests: list[Digest]) -> None:
        """All of these are here, and are kept for a day from now on. Blocks."""
        missing = self._blobs.missing_now(list(dict.fromkeys(digests)))
        if missing:
            raise BlobsMissingError(
                f"{len(missing)} of the bundle's files are not here; upload them first",
                [str(digest) for digest in missing],
            )

    def _check(self, digests: set[Digest]) -> None:
        """Each blob still is what its digest says: disks forget. Blocks."""
        damaged = [digest for digest in digests if digest_of_file(self._blobs.path(digest)) != digest]
        for digest in damaged:
            self._blobs.remove_damaged(digest)
        self._require(damaged)


def bundle_digest(name: str) -> Digest:
    """The digest that a RenderSpec names a bundle by. Raises InvalidFieldsError."""
    try:
        return Digest.parse(name)
    except ValueError as error:
        raise _refusal("bundle", str(error)) from None


def _checked(message: blob_service_pb2.Bundle) -> list[BundleFile]:
    if not 1 <= len(message.files) <= MOST_FILES:
        raise _refusal("bundle", f"{len(message.files)} files: allowed are 1 to {MOST_FILES}")
    fault = bundle_fault(file.path for file in message.files)
    if fault:
        raise _refusal("bundle", fault)
    try:
        return [BundleFile(file.path, Digest(file.digest.sha256, file.digest.size_bytes)) for file in message.files]
    except ValueError as error:
        raise _refusal("bundle", f"a file's digest: {error}") from None


def _refusal(field: str, description: str) -> InvalidFieldsError:
    return InvalidFieldsError([FieldViolation(field, description)])


def _remove_tree(path: Path) -> None:
    """Remove a directory that was made read-only."""
    for directory, _, _ in os.walk(path):
        Path(directory).chmod(0o700)
    shutil.rmtree(path, ignore_errors=True)
