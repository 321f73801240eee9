"""`footlight cluster` before it starts anything: what it refuses, and in which words."""

import os
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from footlight_server.cluster import main
from footlight_server.farm.ray.environment import Access, TlsFiles, ray_environment


def cluster(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "footlight_server.cluster", *(str(argument) for argument in arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def secret(path: Path, mode: int = 0o600) -> Path:
    path.write_text("0" * 64)
    path.chmod(mode)
    return path


def test_another_address_than_loopback_needs_tls(tmp_path: Path) -> None:
    answer = cluster("up", "--host", "0.0.0.0", "--token-file", tmp_path / "token")
    assert answer.returncode == 2
    assert "0.0.0.0 is not a loopback address" in answer.stderr
    assert "--tls-cert" in answer.stderr


def test_up_makes_a_token_that_nobody_else_can_read(tmp_path: Path) -> None:
    token = tmp_path / "new" / "token"
    cluster("up", "--host", "0.0.0.0", "--token-file", token)
    assert stat.S_IMODE(token.stat().st_mode) == 0o600
    assert len(token.read_text()) == 64


@pytest.mark.parametrize("mode", [0o604, 0o640, 0o602])
def test_a_token_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    token = secret(tmp_path / "token", mode)
    answer = cluster("up", "--token-file", token)
    assert answer.returncode == 2
    assert str(token) in answer.stderr
    assert "chmod 600" in answer.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("up", "--lanes", "0"), "--lanes 0: allowed are 1 to 256"),
        (("up", "--port", "16379"), "--port 16379: allowed are 1024 to 9999"),
        (("up", "--tls-cert", "a.pem"), "belong together"),
        (("join", "somewhere"), "'somewhere' is no address; write HOST:PORT"),
    ],
)
def test_options_outside_what_is_allowed(
    tmp_path: Path, arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main([*arguments, "--token-file", str(secret(tmp_path / "token"))])
    assert left.value.code == 2
    assert message in capsys.readouterr().err


def test_a_head_that_does_not_answer_is_told_at_once(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        answer = cluster("join", f"127.0.0.1:{port}", "--token-file", secret(tmp_path / "token"))
    assert answer.returncode == 2
    assert f"nothing answers at 127.0.0.1:{port}" in answer.stderr


def test_what_others_set_for_ray_does_not_get_through(tmp_path: Path) -> None:
    surroundings = {"RAY_AUTH_MODE": "disabled", "RAY_ADDRESS": "ray://elsewhere", "HOME": "/home/td"}
    environment = ray_environment(Access(tmp_path / "token"), surroundings)
    assert environment["RAY_AUTH_MODE"] == "token"
    assert "RAY_ADDRESS" not in environment
    assert environment["HOME"] == "/home/td"
    assert environment["RAY_memory_monitor_refresh_ms"] == "0"


def test_tls_is_on_where_its_files_are_given(tmp_path: Path) -> None:
    tls = TlsFiles(tmp_path / "cert", tmp_path / "key", tmp_path / "ca")
    environment = ray_environment(Access(tmp_path / "token", tls), os.environ)
    assert environment["RAY_USE_TLS"] == "1"
    assert environment["RAY_TLS_SERVER_KEY"] == str(tmp_path / "key")
    assert "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER" not in environment
