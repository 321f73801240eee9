"""How many bytes each user has here, and the limit of that."""

import hashlib
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from footlight_server.blobs.digest import Digest
from footlight_server.sessions.errors import QuotaError

# [bytes] That a file costs beyond what it holds, so that a million empty ones are not free: a block.
FILE_COST = 4096


def user_folder(user: str) -> str:
    """A file name for a user, whatever the user is called."""
    return hashlib.sha256(user.encode()).hexdigest()[:32]


class Ledger:
    """Charges blobs to whoever uploaded them. Thread-safe; blocks on the file system.

    A blob that is charged has an empty file under the user's folder, so that the books survive the server. What is on
    the way is charged as it comes, by its partial file.
    """

    def __init__(self, charges: Path, partials: Path, quota_bytes: int) -> None:
        self._charges = charges
        self._partials = partials
        self._quota = quota_bytes
        self._lock = threading.Lock()
        # [bytes] By folder, once it was asked for.
        self._used: dict[str, int] = {}

    def used(self, user: str) -> int:
        """[bytes] That the user has here, what is on the way included."""
        with self._lock:
            return self._load(user_folder(user))

    def reserve(self, user: str, more: int) -> None:
        """Charge `more` [bytes]. Raises QuotaError and charges nothing if that is too much."""
        folder = user_folder(user)
        with self._lock:
            used = self._load(folder)
            if self._quota and used + more > self._quota:
                raise QuotaError(f"your uploads take {used} of {self._quota} bytes; {more} more do not fit")
            self._used[folder] = used + more

    def check(self, user: str, more: int) -> None:
        """Raises QuotaError if `more` [bytes] would not fit as things are."""
        self.reserve(user, more)
        self.release(user, more)

    def release(self, user: str, less: int) -> None:
        """Give `less` [bytes] back."""
        self._release(user_folder(user), less)

    def keep(self, user: str, digest: Digest) -> None:
        """What was reserved for it, content and file, stays charged until it is forgotten; but once only."""
        mark = self._charges / user_folder(user) / digest.file_name
        mark.parent.mkdir(parents=True, exist_ok=True)
        try:
            mark.touch(exist_ok=False)
        except FileExistsError:
            self.release(user, digest.size + FILE_COST)

    def forget(self, digest: Digest) -> None:
        """The blob is gone: nobody is charged for it any more."""
        for folder in self._folders(self._charges):
            try:
                (folder / digest.file_name).unlink()
            except FileNotFoundError:
                continue
            self._release(folder.name, digest.size + FILE_COST)

    def forget_partial(self, folder: str, size: int) -> None:
        """A partial file of `size` [bytes] in this user's folder is gone."""
        self._release(folder, size + FILE_COST)

    def _release(self, folder: str, less: int) -> None:
        with self._lock:
            self._used[folder] = max(0, self._load(folder) - less)

    def _load(self, folder: str) -> int:
        """Under the lock."""
        if folder not in self._used:
            kept = sum(digest.size + FILE_COST for digest in self._marks(folder))
            self._used[folder] = kept + sum(size + FILE_COST for size in self._partial_sizes(folder))
        return self._used[folder]

    def _marks(self, folder: str) -> Iterator[Digest]:
        with suppress(FileNotFoundError):
            for mark in (self._charges / folder).iterdir():
                with suppress(ValueError):
                    yield Digest.from_file_name(mark.name)

    def _partial_sizes(self, folder: str) -> Iterator[int]:
        with suppress(FileNotFoundError):
            for partial in (self._partials / folder).iterdir():
                with suppress(FileNotFoundError):
                    yield partial.stat().st_size

    @staticmethod
    def _folders(parent: Path) -> list[Path]:
        with suppress(FileNotFoundError):
            return [entry for entry in parent.iterdir() if entry.is_dir()]
        return []
