"""A real server process and stages that do what real ones should not."""

import contextlib
import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from tests.server.api.service import STAGE, Server, StartServer, Stubs, connect, start


@pytest.fixture(scope="session")
def start_server() -> StartServer:
    """Starts a server with more options; it ends with the block."""
    return start


@pytest.fixture(scope="session")
def shared_server() -> Iterator[Server]:
    """A server for tests that do it no harm."""
    with start("--workers", 2) as server:
        yield server


@pytest.fixture
async def client(shared_server: Server) -> AsyncIterator[Stubs]:
    """A client of the shared server."""
    async with connect(shared_server) as stubs:
        yield stubs


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    """A small stage."""
    path = tmp_path / "stage.usda"
    path.write_text(STAGE)
    return path


@pytest.fixture
def hanging_stage(tmp_path: Path) -> Iterator[Path]:
    """A stage whose reference never answers."""
    fifo = tmp_path / "never.usda"
    os.mkfifo(fifo)
    path = tmp_path / "hangs.usda"
    path.write_text('#usda 1.0\ndef Xform "World" (\n    references = @./never.usda@</World>\n) {}\n')
    yield path
    with contextlib.suppress(OSError):  # let go of a worker that still waits
        os.close(os.open(fifo, os.O_WRONLY | os.O_NONBLOCK))


@pytest.fixture
def bomb_stage(tmp_path: Path) -> Path:
    """A few lines that compose to 10^7 prims: gigabytes, and minutes."""
    for level in range(7):
        reference = f"(\n references = @./bomb{level + 1}.usda@</root>\n)" if level < 6 else ""
        prims = "\n".join(f'    def "p{i}" {reference} {{}}' for i in range(10))
        (tmp_path / f"bomb{level}.usda").write_text(f'#usda 1.0\ndef Xform "root" {{\n{prims}\n}}\n')
    return tmp_path / "bomb0.usda"
