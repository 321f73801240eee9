"""Bad input: a clear error that names the file, the prim or the option, with the exit code that goes with it."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from footlight.cli.exits import Exit
from footlight_server.images.exr import write_exr

Command = Callable[..., subprocess.CompletedProcess[str]]

HEADER = "#usda 1.0\n"


def mesh(counts: str = "3", indices: str = "0, 1, 2", first: str = "0") -> str:
    """A triangle called Bad."""
    return (
        f'def Mesh "Bad" {{\n int[] faceVertexCounts = [{counts}]\n int[] faceVertexIndices = [{indices}]\n'
        f" point3f[] points = [({first}, 0, 0), (1, 0, 0), (0, 1, 0)]\n}}"
    )


def prim(kind: str, attribute: str) -> str:
    """A prim called Bad."""
    return f'def {kind} "Bad" {{\n {attribute}\n}}'


# Stages that are not stages.
UNREADABLE = {
    "empty.usda": b"",
    "text.usda": b"this is no stage",
    "cut.usda": b'#usda 1.0\ndef Xform "World" {',
    "noise.usdc": bytes(range(256)) * 16,
    "noise.usdz": bytes(range(256)) * 16,
    "stage.obj": b"v 0 0 0",
    "deep.usda": b'#usda 1.0\ndef X "a" { float[] x = ' + b"[" * 200_000,
}
# Prims that cannot be rendered as they are: the image is made without them, and the report names them.
SCALE_ORDER = 'uniform token[] xformOpOrder = ["xformOp:scale"]'
LEFT_OUT = {
    "nan points": mesh(first="nan"),
    "infinite points": mesh(first="inf"),
    "index out of range": mesh(indices="0, 1, 7"),
    "negative index": mesh(indices="0, 1, -2"),
    "negative count": mesh(counts="-3"),
    "counts beyond indices": mesh(counts="3, 4"),
    "singular transform": prim("Sphere", "float3 xformOp:scale = (0, 1, 1)\n" + SCALE_ORDER),
    "transform with nan": prim("Sphere", "float3 xformOp:scale = (nan, 1, 1)\n" + SCALE_ORDER),
    "light of zero size": prim("RectLight", "float inputs:width = 0"),
    "light of zero power": prim("SphereLight", "float inputs:intensity = 0"),
    "light of zero area": prim("RectLight", "float3 xformOp:scale = (0, 1, 1)\n" + SCALE_ORDER),
    "light that is nan": prim("DiskLight", "float inputs:intensity = nan"),
    "missing dome texture": prim("DomeLight", "asset inputs:texture:file = @./missing.exr@"),
    "unreadable dome texture": prim("DomeLight", "asset inputs:texture:file = @./text.exr@"),
    "dome texture with nan": prim("DomeLight", "asset inputs:texture:file = @./nan.exr@"),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_what_is_not_a_stage(footlight: Command, server: str, tmp_path: Path, name: str) -> None:
    stage = tmp_path / name
    stage.write_bytes(UNREADABLE[name])
    for command in (["render", stage, "-o", tmp_path / "a.exr", "--size", "8x8", "--spp", 1], ["explain", stage]):
        done = footlight(*command, "--server", server)
        assert done.returncode == Exit.STAGE, done.stderr
        assert name in done.stderr
        assert done.stdout == ""
    assert not (tmp_path / "a.exr").exists()


def test_what_is_not_a_file(footlight: Command, server: str, tmp_path: Path) -> None:
    for stage in (tmp_path / "missing.usda", tmp_path):
        for command in (["render", stage, "-o", tmp_path / "a.exr"], ["explain", stage]):
            done = footlight(*command, "--server", server)
            assert done.returncode == Exit.STAGE, done.stderr
            assert str(stage) in done.stderr


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--camera", "/World/Nobody"), ("/World/Nobody", "/World/Camera")),
        (("--camera", "/World/Ball"), ("/World/Ball",)),
        (("--camera", "not a path"), ("not a path",)),
        (("--aov", "beauty"), ("beauty", "albedo")),
        (("--png", "a.png", "--view", "Filmic"), ("Filmic", "Un-tone-mapped")),
        (("--spp", "2000000"), ("--spp", "1048576")),
        (("--size", "40000x10"), ("--size", "32768")),
        (("--max-depth", "5000"), ("--max-depth", "1024")),
        (("--threads", "5000"), ("--threads", "1024")),
        (("--frame", "nan"), ("--frame",)),
    ],
)
def test_options_name_what_is_allowed(
    footlight: Command, server: str, room: Path, tmp_path: Path, options: tuple[str, ...], says: tuple[str, ...]
) -> None:
    done = footlight("render", room, "--server", server, "-o", tmp_path / "a.exr", *options, cwd=tmp_path)
    assert done.returncode == Exit.USAGE, done.stderr
    for text in says:
        assert text in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", LEFT_OUT)
def test_what_cannot_be_rendered_is_named_and_the_rest_renders(
    footlight: Command, server: str, tmp_path: Path, kind: str
) -> None:
    stage = tmp_path / "bad.usda"
    stage.write_text(f'{HEADER}def Sphere "Good" {{}}\n{LEFT_OUT[kind]}\n')
    (tmp_path / "text.exr").write_text("this is no image")
    texels = np.ones((4, 8, 3), np.float32)
    texels[1, 2] = np.nan
    write_exr(tmp_path / "nan.exr", {"color": texels}, {})
    arguments = ("render", stage, "--server", server, "-o", tmp_path / "a.exr", "--size", "8x8", "--spp", 1)
    done = footlight(*arguments)
    assert done.returncode == 0, done.stderr
    assert "/Bad" in done.stderr
    strict = footlight(*arguments, "--strict")
    assert strict.returncode == Exit.STAGE, strict.stderr
    assert "/Bad" in strict.stderr


def test_strict_names_the_prim(footlight: Command, server: str, room: Path, tmp_path: Path) -> None:
    done = footlight("render", room, "--server", server, "-o", tmp_path / "a.exr", "--strict")
    assert done.returncode == Exit.STAGE, done.stderr
    assert "/World/Hair" in done.stderr


def test_only_loopback_is_listened_on(footlight: Command) -> None:
    done = footlight("serve", "--listen", "0.0.0.0:50999")
    assert done.returncode == Exit.USAGE
    assert "loopback" in done.stderr


def test_a_root_has_to_be_a_directory(footlight: Command, tmp_path: Path) -> None:
    done = footlight("serve", "--root", tmp_path / "missing")
    assert done.returncode == Exit.USAGE
    assert f"{tmp_path / 'missing'}: not a directory" in done.stderr
