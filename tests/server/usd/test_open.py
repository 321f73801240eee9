"""Laws of opening: every bad file is one clear error that names it, and no file can bring the process down."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Usd, UsdGeom

from footlight_server.usd import (
    OpenLimits,
    StageLimitError,
    StageMalformedError,
    StageNotFoundError,
    StageUnreadableError,
    TranslateRequest,
    open_stage,
    translate,
)
from footlight_server.usd.scan import bracket_depth
from tests.server.usd.capture import CapturingSink

GOOD = '#usda 1.0\ndef Cube "c" {\n}\n'


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd"])
def test_stages_of_every_format_open(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"s.{suffix}"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.Cube.Define(stage, "/c")
    stage.Save()
    sink = CapturingSink()
    translate(open_stage(path), sink, TranslateRequest())
    assert len(sink.meshes) == 1


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(StageNotFoundError, match=r"no\.usda: no such file"):
        open_stage(tmp_path / "no.usda")


def test_a_directory_and_a_file_that_may_not_be_read(tmp_path: Path) -> None:
    with pytest.raises(StageUnreadableError, match="not a file"):
        open_stage(tmp_path)
    secret = write(tmp_path / "s.usda", GOOD)
    secret.chmod(0)
    if os.access(secret, os.R_OK):
        pytest.skip("root reads everything")
    with pytest.raises(StageUnreadableError, match="may not be read"):
        open_stage(secret)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("s.png", GOOD, "not a stage, its name must end in"),
        ("s.usda", "", "is empty"),
        ("s.usd", "hello", "not a USD layer"),
        ("s.usda", "hello", r"s\.usda: "),
        ("s.usdc", "PXR-USDC" + "\0" * 200, r"s\.usdc: "),
        ("s.usda", '#usda 1.0\ndef Cube "c" {\n', r"s\.usda:3"),
        ("s.usda", "#usda 1.0\n" + "(" * 2000, "brackets nest 2000 deep, allowed are 1000"),
        ("s.usdz", b"PK\3\4nonsense", "not a usdz package"),
    ],
)
def test_what_is_not_a_stage(tmp_path: Path, name: str, content: str | bytes, reason: str) -> None:
    path = write(tmp_path / name, content)
    with pytest.raises(StageMalformedError, match=reason) as error:
        open_stage(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_errors_do_not_quote_the_file(tmp_path: Path) -> None:
    bad = write(tmp_path / "bad.usda", '#usda 1.0\ndef "a" {\n float x = TOPSECRET\n}\n')
    with pytest.raises(StageMalformedError) as error:
        open_stage(bad)
    assert "TOPSECRET" not in str(error.value)
    assert "bad.usda:3" in str(error.value)
    top = write(
        tmp_path / "top.usda", '#usda 1.0\ndef "a" (\n references = @bad.usda@</a>\n) {\n}\ndef Cube "c" {\n}\n'
    )
    opened = open_stage(top)
    sink = CapturingSink()
    report = translate(opened, sink, TranslateRequest())
    assert len(sink.meshes) == 1
    assert any("bad.usda" in line.reason for line in report.left_out)
    assert not any("TOPSECRET" in line.reason for line in report.left_out)


def test_missing_references_are_lines_in_the_report(tmp_path: Path) -> None:
    top = write(tmp_path / "s.usda", '#usda 1.0\ndef "a" (\n references = @gone.usda@\n) {\n}\ndef Cube "c" {\n}\n')
    report = translate(open_stage(top), CapturingSink(), TranslateRequest())
    assert any("gone.usda" in line.reason for line in report.left_out)


@pytest.mark.parametrize("link", [False, True])
def test_layers_outside_the_roots_are_refused(tmp_path: Path, link: bool) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    outside = write(tmp_path / "outside.usda", GOOD)
    target = "../outside.usda"
    if link:
        (inside / "link.usda").symlink_to(outside)
        target = "link.usda"
    stage = write(inside / "s.usda", f'#usda 1.0\ndef "a" (\n references = @{target}@</c>\n) {{\n}}\n')
    open_stage(stage)
    with pytest.raises(StageUnreadableError, match="outside the directories"):
        open_stage(stage, roots=[inside])
    with pytest.raises(StageUnreadableError, match="outside the directories"):
        open_stage(outside, roots=[inside])
    assert open_stage(stage, roots=[inside, tmp_path]).stage


def test_deep_layers_are_found_behind_references(tmp_path: Path) -> None:
    write(tmp_path / "deep.usda", "#usda 1.0\n" + "[" * 1001)
    write(tmp_path / "middle.usda", "#usda 1.0\n(\n subLayers = [@deep.usda@]\n)\n")
    top = write(tmp_path / "s.usda", '#usda 1.0\ndef "a" (\n payload = @./middle.usda@</c>\n) {\n}\n')
    with pytest.raises(StageMalformedError, match=r"deep\.usda: brackets nest 1001 deep"):
        open_stage(top)


def test_text_and_layers_have_limits(tmp_path: Path) -> None:
    path = write(tmp_path / "s.usda", GOOD)
    with pytest.raises(StageLimitError, match="bytes of text, allowed are 10"):
        open_stage(path, limits=OpenLimits(text_bytes=10))
    package = tmp_path / "p.usdz"
    with zipfile.ZipFile(package, "w") as out:
        out.writestr("s.usda", "#usda 1.0\n" + "{" * 3000)
    with pytest.raises(StageMalformedError, match=r"p\.usdz\[s\.usda\]: brackets nest 3000 deep"):
        open_stage(package)
    with zipfile.ZipFile(package, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("s.usda", GOOD)
    with pytest.raises(StageMalformedError, match="is compressed"):
        open_stage(package)


QUOTED = [
    '"[[["',
    "'((('",
    '"""[\n["""',
    "'''{\n{'''",
    "# ((\n",
    "// [[\n",
    "/* {\n{ */",
    "@((@",
    "@@@[[@@@",
    '"\\"["',
    '"a]]]"',
    "# ]]]\n",
]


@given(st.integers(0, 30), st.lists(st.sampled_from(QUOTED), max_size=12), st.randoms(use_true_random=False))
@settings(max_examples=100)
def test_only_brackets_that_nest_count(depth: int, quoted: list[str], random: object) -> None:
    opened = [random.choice("([{") for _ in range(depth)]  # type: ignore[attr-defined]
    parts: list[str] = []
    for k, bracket in enumerate(opened):
        parts += [quoted[k]] if k < len(quoted) else []
        parts += [bracket, " (1, 2) "] if k + 1 < depth else [bracket]
    closed = [{"(": ")", "[": "]", "{": "}"}[bracket] for bracket in reversed(opened)]
    assert bracket_depth("".join([*parts, *closed]).encode()) == depth


HOSTILE = {
    "brackets": '#usda 1.0\ndef "a" {\n int[] x = ' + "[" * 2_000_000,
    "dictionaries": "#usda 1.0\n(\n customLayerData = {\n" + "dictionary a = {\n" * 100_000,
    "parentheses": '#usda 1.0\ndef "a" {\n float3 x = ' + "(" * 2_000_000,
    "cycle": '#usda 1.0\ndef "a" (\n references = @s.usda@</a>\n) {\n}\n',
    "prims": "#usda 1.0\n" + 'def "a" {\n' * 900 + "}\n" * 900,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_end_in_an_exit_not_in_a_crash(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "s.usda", HOSTILE[name])
    code = (
        "import sys; from pathlib import Path\nfrom footlight_server.usd import *\n"
        "try: open_stage(Path(sys.argv[1]))\nexcept StageError as error: print(type(error).__name__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, path],
        check=False,
        capture_output=True,
        timeout=60,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    assert done.returncode == 0, done.stderr.decode()[-2000:]


def test_files_cut_short_while_they_are_open_are_errors(tmp_path: Path) -> None:
    """Memory-mapped, this would be a SIGBUS."""
    path = tmp_path / "s.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/m")
    mesh.CreatePointsAttr([(i % 7, i % 5, i % 3) for i in range(20_000)])
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    stage.Save()
    copy = write(tmp_path / "copy.usdc", path.read_bytes())
    opened = open_stage(copy)
    os.truncate(copy, 500)
    with pytest.raises(StageMalformedError, match=r"copy\.usdc: "):
        translate(opened, CapturingSink(), TranslateRequest())


def test_truncated_crate_files_are_errors(tmp_path: Path) -> None:
    whole = tmp_path / "whole.usdc"
    stage = Usd.Stage.CreateNew(str(whole))
    for i in range(50):
        UsdGeom.Cube.Define(stage, f"/c{i}")
    stage.Save()
    data = whole.read_bytes()
    for k, part in enumerate((0.1, 0.5, 0.9, 0.999)):
        with pytest.raises(StageMalformedError):
            open_stage(write(tmp_path / f"cut{k}.usdc", data[: int(len(data) * part)]))
