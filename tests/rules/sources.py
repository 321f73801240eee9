"""The files of the repository that the rules speak about."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
GENERATED = re.compile(r"_pb2(_grpc)?\.pyi?$")
SKIPPED_FOLDERS = {".git", ".venv", "build", "__pycache__", ".mypy_cache", ".pytest_cache", ".ruff_cache"}


def files(folder: str, *suffixes: str) -> list[Path]:
    """Hand-written files below a folder of the repository with one of the suffixes, sorted."""
    found = (path for path in (ROOT / folder).rglob("*") if path.suffix in suffixes and path.is_file())
    return sorted(
        path
        for path in found
        if not SKIPPED_FOLDERS & set(path.relative_to(ROOT).parts) and not GENERATED.search(path.name)
    )


def name(path: Path) -> str:
    """A path as the repository says it."""
    return path.relative_to(ROOT).as_posix()


def includes(path: Path) -> list[str]:
    """What a C++ file includes, without brackets or quotes."""
    return re.findall(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', path.read_text(), re.MULTILINE)


def imports(path: Path) -> Iterator[str]:
    """Every module a Python file imports anywhere in it, `from a import b` as `a` and as `a.b`."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                package = list(path.relative_to(ROOT).parts[1 : -node.level])
                base = ".".join([*package, base]).rstrip(".")
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
