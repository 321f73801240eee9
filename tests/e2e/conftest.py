"""A real server process and the real command line, over real sockets."""

import os
import re
import select
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

FOOTLIGHT = Path(sys.executable).with_name("footlight")
STAGES = Path(__file__).parent / "stages"

Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def room() -> Path:
    return STAGES / "room.usda"


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """The address of a server that `footlight serve` started."""
    with tempfile.TemporaryDirectory() as directory:
        process = subprocess.Popen(
            [FOOTLIGHT, "serve", "--listen", f"unix:{directory}/socket", "--workers", "2"],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"XDG_DATA_HOME": directory},
        )
        assert process.stdout is not None
        try:
            assert select.select([process.stdout], [], [], 30)[0], "the server did not start"
            found = re.fullmatch(r"listening on (\S+)\n", process.stdout.readline())
            assert found is not None
            yield found[1]
        finally:
            process.terminate()
            assert process.wait(15) == 0
            process.stdout.close()


@pytest.fixture(scope="session")
def footlight() -> Command:
    """Runs the command line as a user would, with its output captured."""

    def run(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
        command = [str(FOOTLIGHT), *(str(argument) for argument in arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)  # type: ignore[call-overload, no-any-return]

    return run


@pytest.fixture(scope="session")
def read_exr() -> Callable[[Path], tuple[oiio.ImageSpec, dict[str, np.ndarray]]]:
    """The header and the channels (H, W) by name."""

    def read(path: Path) -> tuple[oiio.ImageSpec, dict[str, np.ndarray]]:
        image = oiio.ImageInput.open(str(path))
        assert image is not None, oiio.geterror()
        pixels = image.read_image(oiio.FLOAT)
        assert pixels is not None, image.geterror()
        spec = image.spec()
        return spec, dict(zip(spec.channelnames, np.moveaxis(pixels, 2, 0), strict=True))

    return read


def descendants(process: int) -> list[int]:
    """Ids of all processes below `process`."""
    below: list[int] = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue  # it ended while we looked
            if parent == process:
                below += [int(entry.name), *descendants(int(entry.name))]
    return below


def alive(process: int) -> bool:
    """`process` runs, and is not one that only waits to be collected."""
    try:
        os.kill(process, 0)
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
