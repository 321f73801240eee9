"""Paths as this machine and the server see them: the same file under different directories, mapped both ways."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath


@dataclass(frozen=True, slots=True)
class PathMap:
    r"""Pairs of directories: here, and on the server. Build it with `PathMap.of(["P:\\shows=/mnt/shows"])`.

    A path belongs to the longest directory that it lies below, whole names compared; drive letters and names of Windows
    paths compare without case. Paths below none of them stay as they are.
    """

    pairs: tuple[tuple[PurePath, PurePath], ...] = ()

    @classmethod
    def of(cls, rules: Iterable[str]) -> "PathMap":
        """From `FROM=TO` texts. Raises ValueError for one that is not two absolute directories."""
        return cls(tuple(_rule(text) for text in rules))

    def to_server(self, path: str | os.PathLike[str]) -> str:
        """The path as the server sees it. A relative path is taken from the current directory."""
        return _mapped(absolute(path), self.pairs)

    def to_client(self, path: str) -> str:
        """A path of the server's as this machine sees it."""
        return _mapped(path, tuple((there, here) for here, there in self.pairs))


def absolute(path: str | os.PathLike[str]) -> str:
    """`path`, from the current directory if it is relative. An absolute path of the other kind of system is one too."""
    text = os.fspath(path)
    return text if _pure(text).is_absolute() else str(Path(text).absolute())


def _rule(text: str) -> tuple[PurePath, PurePath]:
    here, equals, there = text.partition("=")
    pair = _pure(here), _pure(there)
    if not (equals and all(path.is_absolute() for path in pair)):
        raise ValueError(
            f"path_map: {text!r} is not FROM=TO with two absolute directories, as in /Volumes/shows=/mnt/shows"
        )
    return pair


def _pure(text: str) -> PurePath:
    """By its looks: a drive letter or a host makes it one of Windows."""
    windows = PureWindowsPath(text)
    return windows if windows.drive and "/" not in text[:1] else PurePosixPath(text)


def _mapped(path: str, pairs: Iterable[tuple[PurePath, PurePath]]) -> str:
    pure = _pure(path)
    below = [(source, target) for source, target in pairs if type(source) is type(pure) and pure.is_relative_to(source)]
    if not below:
        return path
    source, target = max(below, key=lambda pair: len(pair[0].parts))
    return str(target.joinpath(*pure.parts[len(source.parts) :]))
