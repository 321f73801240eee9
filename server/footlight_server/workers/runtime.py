"""What a worker process runs on: Python, its packages, libraries. A confined one reads this and its task, no more."""

import importlib.util
import os
import sys
import sysconfig
from collections.abc import Iterator
from functools import cache
from pathlib import Path

# May lie outside the environment: they are edited in place while they are developed.
_OWN_PACKAGES = ("footlight", "footlight_core", "footlight_server")
# Libraries, and the linker's index of them.
_SYSTEM = ("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/etc/ld.so.cache", "/etc/localtime")


@cache
def runtime_paths() -> tuple[Path, ...]:
    """Directories and files that exist, absolute, by the names they are known by and with links resolved."""
    named = {Path(os.path.abspath(path)) for path in _candidates() if path.exists()}  # noqa: PTH100 - keeps links
    found = {path for path in named if path not in system_links()} | {path.resolve() for path in named}
    return tuple(sorted(path for path in found if not found & set(path.parents)))


@cache
def system_links() -> dict[Path, Path]:
    """Links at the top of the file system, and where they lead: /lib to usr/lib."""
    tops = (Path(name) for name in _SYSTEM)
    return {path: path.readlink() for path in tops if path.parent == Path("/") and path.is_symlink()}


def _candidates() -> Iterator[Path]:
    yield from (Path(name) for name in _SYSTEM)
    yield from (Path(sys.prefix), Path(sysconfig.get_path("stdlib")), Path(sysconfig.get_path("platstdlib")))
    # A virtual environment's interpreter, and the libraries beside it.
    yield from (Path(sys.executable).resolve().parent, Path(sys.base_prefix, "lib"))
    for name in _OWN_PACKAGES:
        spec = importlib.util.find_spec(name)
        yield from (Path(place) for place in (spec.submodule_search_locations or () if spec else ()))
    yield from _color_config(os.environ.get("OCIO", ""))


def _color_config(name: str) -> Iterator[Path]:
    """The operator's OpenColorIO config with the tables beside it; the file alone if it lies about in a home folder."""
    config = Path(name)
    if name and config.is_absolute() and config.is_file():
        folder = config.resolve().parent
        home = Path(os.environ.get("HOME") or "/").resolve()
        yield config if home.is_relative_to(folder) else folder
