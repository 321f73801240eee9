"""Ctrl-C, a killed client, a full disk: the render ends, what was asked for is kept, nothing stays behind."""

import contextlib
import resource
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight import Client
from footlight.cli.exits import Exit
from footlight.v1 import render_pb2
from tests.e2e.conftest import FOOTLIGHT, alive, descendants

Command = Callable[..., subprocess.CompletedProcess[str]]
ReadExr = Callable[[Path], tuple[oiio.ImageSpec, dict[str, np.ndarray]]]

# [s] A render that nobody will wait for.
ENDLESS = ("--size", "320x240", "--spp", "1000000")


@contextlib.contextmanager
def rendering(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """A `footlight render` that takes samples already."""
    command = [str(FOOTLIGHT), "render", *(str(argument) for argument in arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("rendering "):
                break
        yield process
    finally:
        process.kill()
        process.communicate()


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    _, said = process.communicate(timeout=30)
    return process.returncode, said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("keep", [True, False])
def test_ctrl_c_cancels_on_the_server(
    server: str, room: Path, tmp_path: Path, read_exr: ReadExr, number: signal.Signals, keep: bool
) -> None:
    path, png = tmp_path / "a.exr", tmp_path / "a.png"
    kept = ["--keep-partial"] if keep else []
    with rendering(room, "--server", server, "-o", path, "--png", png, *ENDLESS, *kept) as process:
        process.send_signal(number)
        code, said = finish(process)
    assert code == Exit.CANCELLED, said
    assert "cancelling" in said
    with Client(server) as client:
        assert client.renders(1)[0].state == render_pb2.RENDER_STATE_CANCELLED
    assert path.exists() == png.exists() == keep
    if keep:
        spec, channels = read_exr(path)
        first, end = spec.getattribute("footlight:samples")
        assert first == 0
        assert 0 < end < 1_000_000
        assert channels["G"].mean() > 0.01
        assert f"partial image, 320x240, {end} spp" in said
    else:
        assert "nothing is written" in said


def test_ctrl_c_with_a_private_server_leaves_nothing_running(room: Path, tmp_path: Path) -> None:
    with rendering(room, "-o", tmp_path / "a.exr", "--keep-partial", *ENDLESS) as process:
        below = descendants(process.pid)
        assert below
        process.send_signal(signal.SIGINT)
        code, said = finish(process)
    assert code == Exit.CANCELLED, said
    assert (tmp_path / "a.exr").exists()
    assert not [process for process in below if alive(process)]


def test_the_private_server_ends_with_a_killed_client(room: Path, tmp_path: Path) -> None:
    with rendering(room, "-o", tmp_path / "a.exr", *ENDLESS) as process:
        below = descendants(process.pid)
        assert below
        process.kill()
    deadline = time.monotonic() + 15
    while any(alive(process) for process in below) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [process for process in below if alive(process)]


def test_a_full_disk_is_said_and_nothing_half_written(server: str, room: Path, tmp_path: Path) -> None:
    # A limit on file size fails like a full disk: in the middle of a write.
    command = [
        FOOTLIGHT,
        "render",
        room,
        "--server",
        server,
        "-o",
        tmp_path / "a.exr",
        "--size",
        "320x240",
        "--spp",
        "1",
    ]
    run = subprocess.run(
        [str(argument) for argument in command],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)),
    )
    assert run.returncode == Exit.OUTPUT, run.stderr
    assert f"error: {tmp_path / 'a.exr'}: cannot be written: File too large" in run.stderr
    assert list(tmp_path.iterdir()) == []
