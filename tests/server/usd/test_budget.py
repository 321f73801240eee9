"""Laws of the budget: what a stage unfolds to is known before it does, and what is beyond a limit names its prim."""

import random
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Sdf, Usd, UsdUtils

from footlight_server.images.exr import write_exr
from footlight_server.images.texture import read_image
from footlight_server.usd import (
    Budget,
    OpenLimits,
    StageLimitError,
    StageMalformedError,
    StageUnreadableError,
    TranslateRequest,
    open_stage,
    translate,
)
from footlight_server.usd.scan import package_members
from footlight_server.usd.unfold import Unfolding
from tests.server.usd.capture import CapturingSink

BOMB_LIMIT = 10_000


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#usda 1.0\n" + text)
    return path


def levels(count: int, arc: str, more: str = "") -> str:
    """Prims L0 to L{count}; each has ten children that take in the one before it by `arc`."""
    text = 'def Xform "L0" {\n def Sphere "s" {\n}\n}\n'
    for level in range(1, count + 1):
        text += f'def Xform "L{level}" {{\n'
        for child in range(10):
            text += f' def Xform "c{child}" (\n{more} {arc.format(level - 1)}\n) {{\n}}\n'
        text += "}\n"
    return text


def unfolded(layer: Any) -> int:
    """What `Unfolding` counts for the whole layer."""
    return Unfolding(layer, 1, lambda _: True)._count(layer, "/")


@given(st.randoms(use_true_random=False), st.integers(1, 9), st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_what_references_unfold_to_is_known_before(chance: random.Random, prims: int, arcs: int) -> None:
    """Any web of references to earlier prims, from prims that say nothing else: the count is USD's own, exactly."""
    text = 'def "P0" {\n def "a" {\n}\n def "b" {\n  def "c" {\n}\n}\n}\n'
    kinds = ("references = </P{}>", "payload = </P{}>", "inherits = </P{}>", "specializes = </P{}>")
    for number in range(1, prims + 1):
        text += f'def "P{number}" {{\n'
        for child in range(arcs):
            text += f' def "n{child}" (\n  {chance.choice(kinds).format(chance.randrange(number))}\n) {{\n}}\n'
        text += "}\n"
    layer = Sdf.Layer.CreateAnonymous("web.usda")
    assert layer.ImportFromString("#usda 1.0\n" + text)
    stage = Usd.Stage.Open(layer)
    assert unfolded(layer) == sum(1 for _ in stage.TraverseAll())


@pytest.mark.parametrize(
    "arc", ["references = </L{}>", "payload = </L{}>", "inherits = </L{}>", "specializes = </L{}>"]
)
def test_a_bomb_is_refused_before_it_goes_off(tmp_path: Path, arc: str) -> None:
    """Ten references each to ten references, in a few kilobytes. Of 10^9 and 10^40 prims only the layer is opened."""
    stage = write(tmp_path / "bomb.usda", levels(5, arc))
    with pytest.raises(StageLimitError, match=r"/L5/c\d: what it refers to unfolds to") as error:
        open_stage(stage, limits=OpenLimits(prims=BOMB_LIMIT))
    assert error.value.prim_path.startswith("/L5/c")
    for count in (9, 40):
        layer = Sdf.Layer.FindOrOpen(str(write(tmp_path / f"{count}.usda", levels(count, arc))))
        began = time.monotonic()
        with pytest.raises(StageLimitError, match=rf"/L{count}/c\d: what it refers to unfolds to"):
            Unfolding(layer, BOMB_LIMIT, lambda _: True).check()
        assert time.monotonic() - began < 2.0


def test_what_comes_through_an_ancestor_counts() -> None:
    """A prim inside of what another prim refers to is in no layer under its own path."""
    text = (
        'def "P" {\n def "a" {\n  def "b" {\n  }\n  def "c" {\n  }\n }\n}\n'
        'def "Q" (\n references = </P>\n) {\n}\ndef "R" (\n references = </Q/a>\n) {\n}\n'
    )
    layer = Sdf.Layer.CreateAnonymous("inner.usda")
    assert layer.ImportFromString("#usda 1.0\n" + text)
    stage = Usd.Stage.Open(layer)
    assert unfolded(layer) == sum(1 for _ in stage.TraverseAll())


def test_bombs_hide_behind_files_sublayers_variants_and_expressions(tmp_path: Path) -> None:
    for level in range(1, 6):
        text = 'def Xform "A" {\n'
        for child in range(10):
            text += f' def "c{child}" (\n  references = @./{level - 1}.usda@</A>\n) {{\n}}\n'
        write(tmp_path / f"{level}.usda", text + "}\n")
    write(tmp_path / "0.usda", 'def Xform "A" {\n}\n')
    limits = OpenLimits(prims=BOMB_LIMIT)
    hidden = {
        "sub": "(\n subLayers = [@./5.usda@]\n)\n",
        "variant": 'def "V" (\n variantSets = "v"\n variants = {\n  string v = "x"\n }\n) {\n variantSet "v" = {\n'
        '  "x" (\n   references = @./5.usda@</A>\n  ) {\n  }\n  "y" {\n  }\n }\n}\n',
        "expression": '(\n expressionVariables = {\n  string N = "5"\n }\n)\ndef "E" (\n'
        ' references = @`"./${N}.usda"`@</A>\n) {\n}\n',
    }
    for name, text in hidden.items():
        with pytest.raises(StageLimitError, match="unfolds to about"):
            open_stage(write(tmp_path / f"{name}.usda", text), roots=[tmp_path], limits=limits)


def test_only_one_variant_counts(tmp_path: Path) -> None:
    """A choice among fifty sets of a hundred prims is a hundred prims."""
    write(tmp_path / "set.usda", 'def "A" {\n' + "".join(f' def "p{i}" {{\n}}\n' for i in range(100)) + "}\n")
    options = "".join(f'  "v{i}" (\n   references = @./set.usda@</A>\n  ) {{\n  }}\n' for i in range(50))
    text = f'def "V" (\n variantSets = "v"\n) {{\n variantSet "v" = {{\n{options} }}\n}}\n'
    layer = Sdf.Layer.FindOrOpen(str(write(tmp_path / "choice.usda", text)))
    assert unfolded(layer) == 101


def test_chains_are_followed_only_so_far(tmp_path: Path) -> None:
    chain = 'def "P0" {\n}\n' + "".join(f'def "P{i}" (\n references = </P{i - 1}>\n) {{\n}}\n' for i in range(1, 400))
    # From its end, since what was counted before is not followed again.
    stage = write(tmp_path / "chain.usda", 'def "A" (\n references = </P399>\n) {\n}\n' + chain)
    with pytest.raises(StageLimitError, match="nested more than 256 deep"):
        open_stage(stage, limits=OpenLimits(prims=BOMB_LIMIT))


def test_cycles_and_missing_targets_are_no_bombs(tmp_path: Path) -> None:
    text = (
        'def "A" (\n references = </B>\n) {\n}\ndef "B" (\n references = </A>\n) {\n}\n'
        'def "C" (\n references = [</nowhere>, @gone.usda@, @../outside.usda@]\n) {\n}\ndef Cube "good" {\n}\n'
    )
    inside = write(tmp_path / "inside" / "s.usda", text)
    opened = open_stage(inside, roots=[inside.parent], limits=OpenLimits(prims=BOMB_LIMIT))
    assert opened.stage.GetPrimAtPath("/good")


def test_instances_are_counted_once_as_prims_and_each_as_instances(tmp_path: Path) -> None:
    """10^9 places of one sphere: nothing unfolds, but they are too many to place."""
    stage = write(tmp_path / "s.usda", levels(9, "references = </L{}>", " instanceable = true\n"))
    opened = open_stage(stage, limits=OpenLimits(prims=BOMB_LIMIT))
    request = TranslateRequest(budget=Budget(instances=1_000_000))
    with pytest.raises(StageLimitError, match=r"^/L\d/c\d: with it the stage has \d+ instances, allowed are") as error:
        translate(opened, CapturingSink(), request)
    assert error.value.prim_path.startswith("/L")


@pytest.mark.parametrize("limit", ["prims", "points", "texels"])
def test_what_is_beyond_a_limit_names_its_prim(tmp_path: Path, limit: str) -> None:
    write_exr(tmp_path / "sky.exr", {"color": np.ones((8, 16, 3), np.float32)}, {})
    stage = write(
        tmp_path / "s.usda",
        'def Mesh "first" {\n int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n'
        ' uniform token subdivisionScheme = "none"\n point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n}\n'
        'def DomeLight "one" {\n asset inputs:texture:file = @./sky.exr@\n}\n'
        'def DomeLight "two" {\n asset inputs:texture:file = @./sky.exr@\n}\n',
    )
    # (the most that is too little, the prim at which it shows); one more is enough.
    too_little, prim = {"prims": (2, "/two"), "points": (2, "/first"), "texels": (255, "/two")}[limit]

    def run(most: int) -> None:
        request = TranslateRequest(budget=Budget(**{limit: most}))
        load = lambda path, admit: read_image(Path(path), admit=admit)  # noqa: E731
        translate(open_stage(stage), CapturingSink(), request, load_image=load)

    with pytest.raises(StageLimitError, match=rf"^{prim}: with it the stage has \d+ {limit}, allowed are") as error:
        run(too_little)
    assert error.value.prim_path == prim
    run(too_little + 1)
    run(0)


def test_texels_are_counted_before_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "sky.exr"
    write_exr(path, {"color": np.ones((64, 64, 3), np.float32)}, {})
    path.write_bytes(path.read_bytes()[:1000])  # the header is whole, the texels are not there

    def refuse(texels: int) -> None:
        raise StageLimitError(f"{texels}")

    with pytest.raises(StageLimitError, match="4096"):
        read_image(path, admit=refuse)


def test_every_file_is_looked_at_where_names_do_not_tell(tmp_path: Path) -> None:
    """A crate file may name a text layer, and no look at text finds that."""
    write(tmp_path / "deep.usda", "[" * 1001)
    stage = Usd.Stage.CreateNew(str(tmp_path / "s.usdc"))
    stage.DefinePrim("/a")
    stage.GetRootLayer().GetPrimAtPath("/a").referenceList.Prepend(Sdf.Reference("./deep.usda"))
    stage.Save()
    del stage
    for name in ("s.usdc", "deep.usda"):
        with pytest.raises(StageMalformedError, match=r"deep\.usda: brackets nest 1001 deep"):
            open_stage(tmp_path / name, roots=[tmp_path], limits=OpenLimits(every_file=True))


def package(tmp_path: Path, name: str, inner: Path) -> Path:
    path = tmp_path / name
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(inner)), str(path))
    return path


def test_packages_are_read_as_usd_reads_them(tmp_path: Path) -> None:
    """USD goes by the header before a file, other programs by the directory at the end: a package with two truths."""
    write(tmp_path / "n.usda", 'def Sphere "s" {\n}\n')
    inner = write(tmp_path / "m.usda", 'def "a" (\n references = @./n.usda@</s>\n) {\n}\n')
    honest = package(tmp_path, "honest.usdz", inner)
    data = honest.read_bytes()
    at = data.rindex(b"m.usda")
    liar = tmp_path / "liar.usdz"
    liar.write_bytes(data[:at] + b"m.text" + data[at + 6 :])
    for path in (honest, liar):
        with path.open("rb") as file:
            members = list(package_members(file, 0, path.stat().st_size))
        archive = Sdf.ZipFile.Open(str(path))
        assert [member.name for member in members] == list(archive.GetFileNames()) == ["m.usda", "n.usda"]
        for member in members:
            info = archive.GetFileInfo(member.name)
            assert (member.begin, member.size) == (info.dataOffset, info.size)
    body = b"#usda 1.0\n" + b"[" * 2000
    start = data.index(b"#usda")
    evil = data[:start] + body + data[start + len(body) :] if len(data) > start + len(body) else data[:start] + body
    # The size in the header: 18 bytes from its beginning, twice.
    evil = evil[:18] + len(body).to_bytes(4, "little") * 2 + evil[26:]
    liar.write_bytes(evil)
    with pytest.raises(StageMalformedError, match=r"liar\.usdz\[m\.usda\]: brackets nest 2000 deep"):
        open_stage(liar)


def test_of_files_outside_the_roots_nothing_is_told(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Not what they hold, nor what they are, nor whether they are there."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "secret.txt").write_text("TOPSECRET = 5")
    (tmp_path / "outside" / "secret.usda").write_text("#usda 1.0\nTOPSECRET = 5\n")
    inside = tmp_path / "inside"

    def told(target: str) -> tuple[list[str], str]:
        text = f'(\n subLayers = [@{target}@]\n)\ndef "a" (\n references = @{target}@\n) {{\n}}\n'
        text += f'def DomeLight "d" {{\n asset inputs:texture:file = @{target}@\n}}\ndef Cube "c" {{\n}}\n'
        stage = write(inside / "s.usda", text)
        Sdf.Layer.Find(str(stage)) and Sdf.Layer.Find(str(stage)).Reload()
        opened = open_stage(stage, roots=[inside])
        load = lambda path, admit: read_image(Path(path), admit=admit)  # noqa: E731
        report = translate(opened, CapturingSink(), TranslateRequest(roots=(inside,)), load_image=load)
        lines = [f"{line.path} {line.reason}" for line in report.left_out]
        return [line.replace(Path(target).name, "X") for line in lines], capfd.readouterr().err

    missing, _ = told("../outside/missing.usda")
    assert len(missing) == 3
    for target in ("../outside/secret.txt", "../outside/secret.usda", f"{tmp_path}/outside/secret.usda"):
        lines, errors = told(target)
        assert "TOPSECRET" not in "".join(lines) + errors
        assert "format" not in "".join(lines)
        if not target.startswith("/"):
            assert lines == missing


def test_layers_that_come_in_late_are_found_out(tmp_path: Path) -> None:
    """Value clips are opened as values are asked for: by then the stage is open."""
    write(
        tmp_path / "outside.usda",
        'over "m" {\n point3f[] points.timeSamples = {\n  0: [(7, 7, 7), (1, 0, 0), (0, 1, 0)]\n }\n}\n',
    )
    inside = write(
        tmp_path / "inside" / "s.usda",
        '(\n startTimeCode = 0\n endTimeCode = 1\n)\ndef Mesh "m" (\n clips = {\n  dictionary default = {\n'
        '   asset[] assetPaths = [@../outside.usda@]\n   string primPath = "/m"\n'
        "   double2[] active = [(0, 0)]\n   double2[] times = [(0, 0), (1, 1)]\n"
        "   asset manifestAssetPath = @./manifest.usda@\n  }\n }\n) {\n"
        " int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n point3f[] points\n}\n",
    )
    write(inside.parent / "manifest.usda", 'over "m" {\n point3f[] points\n}\n')
    opened = open_stage(inside, roots=[inside.parent])
    with pytest.raises(StageUnreadableError, match=r"outside\.usda: outside the directories"):
        translate(opened, CapturingSink(), TranslateRequest(roots=(inside.parent,)))
