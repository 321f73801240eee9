"""`footlight render`: the image, its picture, its statistics, and that they are the same whatever the threads."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight.v1 import stats_pb2

Command = Callable[..., subprocess.CompletedProcess[str]]
ReadExr = Callable[[Path], tuple[oiio.ImageSpec, dict[str, np.ndarray]]]

SMALL = ("--size", "96x64", "--spp", "4")


def test_a_private_server_renders_everything_asked_for(
    footlight: Command, room: Path, tmp_path: Path, read_exr: ReadExr
) -> None:
    exr, png, stats = tmp_path / "out.exr", tmp_path / "out.png", tmp_path / "stats.json"
    aovs = [part for name in ("depth", "normal", "error", "sample_count") for part in ("--aov", name)]
    done = footlight("render", room, "-o", exr, *SMALL, "--seed", 5, "--png", png, "--stats", stats, *aovs)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert "left out: /World/Hair: BasisCurves" in done.stderr
    assert f"{exr}: 96x64, 4 spp" in done.stderr

    spec, channels = read_exr(exr)
    assert (spec.width, spec.height) == (96, 64)
    assert str(spec.format) == "float"
    assert spec.channelnames[:4] == ("R", "G", "B", "A")
    assert {name.partition(".")[0] for name in spec.channelnames[4:]} == {"depth", "normal", "error", "sample_count"}
    assert all(np.isfinite(channels[name]).all() for name in "RGBA")
    assert channels["G"].mean() > 0.01
    assert (channels["sample_count.Y"] == 4).all()
    attributes = {item.name: item.value for item in spec.extra_attribs}
    assert attributes["footlight:seed"] == 5
    assert attributes["footlight:samples"] == (0, 4)
    assert set(attributes["footlight:effects"]) >= {"specular", "area_lights"}  # type: ignore[call-overload]
    assert isinstance(attributes["footlight:error_mean"], float)
    assert attributes["footlight:version"]

    picture = oiio.ImageInput.open(str(png))
    assert picture is not None
    assert (picture.spec().width, picture.spec().height) == (96, 64)
    assert str(picture.spec().format) == "uint8"

    found = json.loads(stats.read_text())
    assert set(found) == {field.name for field in stats_pb2.RenderStats.DESCRIPTOR.fields}
    assert set(found["seconds"]) == {"open", "translate", "commit", "render", "write", "total"}
    assert found["seconds"]["total"] >= found["seconds"]["render"] > 0
    assert found["samples"] == 96 * 64 * 4
    assert set(found["rays"]) == {"closest", "shadow"}
    assert found["seed"] == 5
    assert found["peak_memory_bytes"] > 0
    assert {effect["name"] for effect in found["effects"] if effect["active"]} >= {"specular", "area_lights"}
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["out.exr", "out.png", "stats.json"]


def test_same_bytes_for_any_number_of_threads(footlight: Command, server: str, room: Path, tmp_path: Path) -> None:
    files = []
    for threads in (1, 2, 3):
        files.append(tmp_path / f"{threads}.exr")
        done = footlight("render", room, "--server", server, "-o", files[-1], *SMALL, "--threads", threads)
        assert done.returncode == 0, done.stderr
    assert len({file.read_bytes() for file in files}) == 1
    other = tmp_path / "other.exr"
    footlight("render", room, "--server", server, "-o", other, *SMALL, "--seed", 1)
    assert other.read_bytes() != files[0].read_bytes()


def test_an_exr_goes_through_a_pipe(server: str, room: Path, footlight: Command, tmp_path: Path) -> None:
    command = [str(footlight("--version").args[0]), "render", str(room), "--server", server, "-o", "-", *SMALL]
    piped = subprocess.run(command, capture_output=True, timeout=120, check=True).stdout
    footlight("render", room, "--server", server, "-o", tmp_path / "a.exr", *SMALL)
    assert piped == (tmp_path / "a.exr").read_bytes()


@pytest.mark.parametrize(
    ("strategy", "pixel_filter"), [("mis", "gaussian"), ("light", "blackman-harris"), ("bsdf", "box")]
)
def test_every_strategy_and_filter_renders(
    footlight: Command, server: str, room: Path, tmp_path: Path, strategy: str, pixel_filter: str
) -> None:
    options = ("--strategy", strategy, "--pixel-filter", pixel_filter, "--size", "16x16", "--spp", 2)
    done = footlight("render", room, "--server", server, "-o", tmp_path / "a.exr", *options)
    assert done.returncode == 0, done.stderr


def test_a_view_changes_the_picture_and_nothing_else(
    footlight: Command, server: str, room: Path, tmp_path: Path
) -> None:
    for name, view in (("plain", ()), ("view", ("--view", "ACES 2.0 - SDR 100 nits (Rec.709)"))):
        outputs = ("-o", tmp_path / f"{name}.exr", "--png", tmp_path / f"{name}.png")
        done = footlight("render", room, "--server", server, *outputs, *SMALL, *view)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "plain.exr").read_bytes() == (tmp_path / "view.exr").read_bytes()
    assert (tmp_path / "plain.png").read_bytes() != (tmp_path / "view.png").read_bytes()


def test_explain_says_what_and_why(footlight: Command, server: str, room: Path) -> None:
    table = footlight("explain", room, "--server", server)
    assert table.returncode == 0, table.stderr
    assert table.stderr == ""
    for text in ("/World/Camera", "specular", "/World/Metal", "generate → ", "BasisCurves"):
        assert text in table.stdout
    found = json.loads(footlight("explain", room, "--server", server, "--json").stdout)
    by_name = {effect["name"]: effect for effect in found["report"]["effects"]}
    assert by_name["area_lights"]["active"]
    assert by_name["area_lights"]["prim_paths"] == ["/World/Lamp"]
    assert not by_name["dome"]["active"]
    assert by_name["dome"]["reason"]
    assert found["report"]["left_out"][0]["prim_path"] == "/World/Hair"
    assert found["spec"]["camera_path"] == "/World/Camera"
