"""The command line of the server: what is refused, in which words, and what comes of what is not."""

import subprocess
import sys
from pathlib import Path

import pytest

from footlight_server.farm.folder import own_folder
from footlight_server.options import Launch, check_launch, default_data, parse_arguments
from footlight_server.settings import Quota, StageBudget


def launch(*arguments: str, scratch: Path = Path("/nowhere")) -> Launch:
    return check_launch(parse_arguments(arguments), scratch)


def test_the_defaults_let_nobody_in_from_elsewhere() -> None:
    made = launch("--data", "/somewhere")
    assert made.addresses == ("127.0.0.1:50051",)
    assert made.tls is None
    assert made.metrics == ""
    assert made.settings.data == Path("/somewhere")
    assert made.settings.database == "sqlite:////somewhere/queue.db"
    assert made.settings.quota == Quota(0, 0, 0)
    assert made.settings.budget == StageBudget()
    assert made.settings.allowed_environment == frozenset()
    assert not made.settings.trust_scenes


def test_every_option_reaches_its_setting(tmp_path: Path) -> None:
    made = launch(
        *("--listen", "unix:/a", "--listen", "127.0.0.1:0", "--farm-workers", "3", "--output-root", str(tmp_path)),
        *("--allow-env", "SHOW", "--allow-env", "SHOT", "--trust-scenes", "--quota-jobs", "4", "--quota-tasks", "5"),
        *("--quota-bytes", "1.5", "--keep-blobs", "2", "--max-prims", "6", "--max-instances", "7", "--max-points", "8"),
        *("--max-texels", "0", "--metrics", "127.0.0.1:9", "--drain-seconds", "11", "--database", "postgresql://h/x"),
    )
    settings = made.settings
    assert made.addresses == ("unix:/a", "127.0.0.1:0")
    assert made.metrics == "127.0.0.1:9"
    assert settings.farm_workers == 3
    assert settings.output_roots == (tmp_path,)
    assert settings.allowed_environment == {"SHOW", "SHOT"}
    assert settings.trust_scenes
    assert settings.quota == Quota(4, 5, 3 << 29)
    assert settings.keep_blobs == 2 * 86400
    assert settings.budget == StageBudget(6, 7, 8, 0)
    assert settings.drain == 11
    assert settings.database == "postgresql://h/x"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--farm-workers", "-1"], "--farm-workers -1: allowed are 0 to 256"),
        (["--quota-jobs", "-1"], "--quota-jobs -1"),
        (["--max-prims", "-1"], "--max-prims -1"),
        (["--drain-seconds", "nan"], "--drain-seconds nan"),
        (["--output-root", "/nowhere/at/all"], "--output-root /nowhere/at/all: not a directory"),
        (["--database", "mysql://u:secret@h/x"], "--database: has to begin with sqlite:/// or postgresql://"),
        (["--allow-env", "A=B"], "--allow-env A=B: not the name of a variable"),
        (["--allow-env", "LD_PRELOAD"], "--allow-env LD_PRELOAD: would let"),
        (["--allow-env", "PYTHONPATH"], "--allow-env PYTHONPATH: would let"),
        (["--allow-env", "PXR_PLUGINPATH_NAME"], "--allow-env PXR_PLUGINPATH_NAME: would let"),
        (["--metrics", "0.0.0.0:9090"], "not a loopback address"),
        (["--metrics", "unix:/x"], "--metrics unix:/x"),
        (["--ray-address", "127.0.0.1:6379"], "are for --executor ray"),
        (["--tls-cert", "/nowhere/at/all"], "--tls-cert and --tls-key: give both"),
        (["--listen", "127.0.0.1:1", "--listen", "127.0.0.1:1"], "--listen 127.0.0.1:1: given twice"),
    ],
)
def test_what_is_wrong_is_named(arguments: list[str], words: str) -> None:
    with pytest.raises(ValueError) as caught:
        launch(*arguments)
    assert words in str(caught.value)
    assert "secret" not in str(caught.value)


def test_data_goes_where_the_xdg_specification_says() -> None:
    assert default_data({"XDG_DATA_HOME": "/data"}) == Path("/data/footlight")
    assert default_data({"XDG_DATA_HOME": "relative"}) == Path.home() / ".local/share/footlight"
    assert default_data({}) == Path.home() / ".local/share/footlight"


def test_a_new_data_folder_is_for_its_owner_only(tmp_path: Path) -> None:
    own_folder(tmp_path / "a" / "data")
    assert (tmp_path / "a" / "data").stat().st_mode & 0o777 == 0o700
    own_folder(tmp_path / "a" / "data")


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701, 0o1777])
def test_a_data_folder_that_others_reach_into_is_refused_and_left_as_it_is(tmp_path: Path, mode: int) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(ValueError, match="chmod 700"):
        own_folder(folder)
    assert folder.stat().st_mode & 0o7777 == mode


def test_a_data_folder_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own_folder(tmp_path / "data")
    monkeypatch.setattr("os.getuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(ValueError, match="belongs to user"):
        own_folder(tmp_path / "data")


def test_the_server_refuses_such_a_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    command = [sys.executable, "-m", "footlight_server", "--listen", "127.0.0.1:0", "--data", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "chmod 700" in result.stderr
