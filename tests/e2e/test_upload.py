"""Uploaded stages: they render as they do where they are, whatever happens to the line, the server or the original."""

import contextlib
import random
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest
from pxr import UsdUtils

from footlight import Client, Job, job_spec, layer_spec, render_spec
from footlight.cli.exits import Exit
from footlight.errors import BlobsMissingError, InvalidRequestError
from footlight.v1 import render_pb2
from tests.client.uploading import BreakingLine
from tests.e2e.conftest import FOOTLIGHT, Command
from tests.server.api.service import start

ReadExr = Callable[[Path], tuple[oiio.ImageSpec, dict[str, np.ndarray]]]

MAIN = """#usda 1.0
(
    subLayers = [@./layers/light.usda@]
    defaultPrim = "World"
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 6
)
def Xform "World"
{
    def Camera "Camera"
    {
        double3 xformOp:translate = (0, 0.5, 6)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def "Box" (
        prepend references = @LIBRARY/box.usda@
    )
    {
        double3 xformOp:translate = (-1.2, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def "Ball" (
        prepend payload = @./ball.usdz@
    )
    {
        double3 xformOp:translate.timeSamples = { 1: (1.2, 0, 0), 6: (1.2, 1, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Volume "Fog"
    {
        custom rel field:density = </World/Fog/density>
        def OpenVDBAsset "density"
        {
            asset filePath = @./fog.vdb@
            token fieldName = "density"
        }
    }
    def Scope "Looks"
    {
        def Shader "Wood"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./tex/wood.<UDIM>.exr@
        }
    }
}
"""
LIGHT = """#usda 1.0
def DomeLight "Sky"
{
    asset inputs:texture:file = @../tex/sky.exr@
    float inputs:intensity = 1
}
"""


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    """A stage with a sublayer, a reference, a usdz, a texture, UDIMs and a volume, some from elsewhere."""
    show, library = tmp_path / "show", tmp_path / "library"
    for folder in (show / "layers", show / "tex", library):
        folder.mkdir(parents=True)
    write_image(show / "tex" / "sky.exr", 1)
    for tile in (1001, 1002):
        write_image(show / "tex" / f"wood.{tile}.exr", tile)
    (show / "fog.vdb").write_bytes(random.Random(5).randbytes(1000))
    head = '#usda 1.0\n(\n    defaultPrim = "P"\n)\n'
    (library / "box.usda").write_text(f'{head}def Xform "P"\n{{\n    def Cube "shape"\n    {{\n    }}\n}}\n')
    (show / "ball.usda").write_text(f'{head}def Xform "P"\n{{\n    def Sphere "shape"\n    {{\n    }}\n}}\n')
    assert UsdUtils.CreateNewUsdzPackage(str(show / "ball.usda"), str(show / "ball.usdz"))
    (show / "ball.usda").unlink()
    (show / "layers" / "light.usda").write_text(LIGHT)
    (show / "main.usda").write_text(MAIN.replace("LIBRARY", str(library)))
    return show / "main.usda"


def write_image(path: Path, seed: int, size: tuple[int, int] = (16, 8)) -> None:
    """Noise, float32 RGB."""
    pixels = np.random.default_rng(seed).random((size[1], size[0], 3), np.float32)
    image = oiio.ImageBuf(oiio.ImageSpec(*size, 3, oiio.FLOAT))
    image.set_pixels(oiio.ROI(0, size[0], 0, size[1], 0, 1, 0, 3), pixels)
    assert image.write(str(path)), image.geterror()


def spec_of(path: str | Path, **options: object) -> render_pb2.RenderSpec:
    return render_spec(path, size=(48, 32), spp=4, threads=2, **options)


def take_away(stage: Path) -> None:
    """All that the stage consists of is gone."""
    for folder in ("show", "library"):
        shutil.rmtree(stage.parent.parent / folder)


def same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> bool:
    assert set(first) == set(second)
    return all(np.array_equal(first[name], second[name]) for name in first)


def test_an_uploaded_stage_renders_as_it_does_where_it_is(
    server: str, stage: Path, tmp_path: Path, read_exr: ReadExr
) -> None:
    with Client(server) as client:
        session = client.submit(spec_of(stage))
        near = session.wait()
        session.save(tmp_path / "near.exr")
        bundle = client.upload(stage)
        assert bundle.unresolved == ()
        take_away(stage)
        session = client.submit(spec_of(bundle.stage_path, bundle=bundle.digest))
        far = session.wait()
        session.save(tmp_path / "far.exr")
    # Where the server keeps it is the server's business.
    assert (far.spec.stage_path, far.spec.bundle) == ("main.usda", bundle.digest)
    assert far.report == near.report
    pixels = read_exr(tmp_path / "near.exr")[1]
    assert same(pixels, read_exr(tmp_path / "far.exr")[1])
    assert np.ptp(pixels["R"]) > 0.05, "the texture and the shapes are to be seen"


def test_the_same_from_the_command_line(
    server: str, stage: Path, tmp_path: Path, footlight: Command, read_exr: ReadExr
) -> None:
    options = ("--server", server, "--size", "48x32", "--spp", "4", "--threads", "2")
    for name, more in (("near", ()), ("far", ("--upload",))):
        result = footlight("render", stage, "-o", tmp_path / f"{name}.exr", *options, *more)
        assert result.returncode == 0, result.stderr
    assert same(read_exr(tmp_path / "near.exr")[1], read_exr(tmp_path / "far.exr")[1])


def test_a_private_server_keeps_no_uploads(stage: Path, tmp_path: Path, footlight: Command) -> None:
    result = footlight("render", stage, "-o", tmp_path / "a.exr", "--upload")
    assert result.returncode == Exit.USAGE
    assert "--server" in result.stderr


def test_what_was_not_uploaded_is_said(server: str) -> None:
    with Client(server) as client:
        spec = spec_of("main.usda", bundle=f"{'0' * 64}/100")
        with pytest.raises(BlobsMissingError, match="0000"):
            client.submit(spec)
        with pytest.raises(BlobsMissingError, match="0000"):
            client.explain(spec)
        with pytest.raises(BlobsMissingError, match="0000"):
            client.farm.submit(job_spec(layer_spec(spec, frames="1-3")))
        with pytest.raises(InvalidRequestError, match="bundle"):
            client.submit(spec_of("main.usda", bundle="../.."))


@pytest.mark.parametrize("path", ["nowhere.usda", "../main.usda", "/etc/hostname", "layers"])
def test_the_stage_has_to_be_one_of_the_files(server: str, stage: Path, path: str) -> None:
    with Client(server) as client:
        bundle = client.upload(stage)
        with pytest.raises(InvalidRequestError, match="stage_path"):
            client.submit(spec_of(path, bundle=bundle.digest))
        with pytest.raises(InvalidRequestError, match="stage_path"):
            client.farm.submit(job_spec(layer_spec(spec_of(path, bundle=bundle.digest), frames="1-3")))


@pytest.mark.parametrize("upload", [True, False])
def test_a_stage_that_is_edited_while_its_job_runs(
    server: str, stage: Path, tmp_path: Path, read_exr: ReadExr, *, upload: bool
) -> None:
    """Changes no later frame if it was uploaded; by its path it does, so that this test can tell."""
    main = stage.read_text().replace("1: (1.2, 0, 0), 6: (1.2, 1, 0)", "1: (1.2, 0, 0)")
    stage.write_text(main)  # all frames are the same
    with Client(server) as client:
        spec = spec_of(stage)
        if upload:
            client.upload(stage).into(spec)
        job = client.farm.submit(job_spec(layer_spec(spec, frames="1-6", output=tmp_path / "out.####.exr"), retries=0))
        with paused_after_a_frame(job):
            first = {frame.frame for frame in job.frames()}
            assert 1 <= len(first) < 6
            stage.write_text(main.replace("(-1.2, 0, 0)", "(-0.2, 1, 1)"))
            write_image(stage.parent / "tex" / "sky.exr", 7)
            (stage.parent.parent / "library" / "box.usda").write_text("#usda 1.0\n")
        job.wait()
        images = {frame: read_exr(tmp_path / f"out.{frame:04}.exr")[1] for frame in range(1, 7)}
    before = images[min(first)]
    assert all(same(before, images[frame]) for frame in first)
    assert all(same(before, images[frame]) is upload for frame in images if frame not in first)


@contextlib.contextmanager
def paused_after_a_frame(job: Job) -> Iterator[None]:
    """Inside, some frames of the job are done and none is being rendered."""
    deadline = time.monotonic() + 60
    while not job.get().frames_done:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    job.pause()
    while job.get().tasks.running:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    yield
    job.resume()


def test_an_upload_goes_on_where_the_line_broke(server: str, stage: Path, tmp_path: Path, read_exr: ReadExr) -> None:
    write_image(stage.parent / "tex" / "sky.exr", 3, (1024, 512))
    with Client(server) as client:
        near = client.submit(spec_of(stage))
        near.wait()
        near.save(tmp_path / "near.exr")
    with BreakingLine(tmp_path, server, [1_000_000, 800_000, 10, 2_000_000]) as line, Client(line.address) as client:
        bundle = client.upload(stage)
        assert line.cuts == []
        take_away(stage)
        far = client.submit(spec_of(bundle.stage_path, bundle=bundle.digest))
        far.wait()
        far.save(tmp_path / "far.exr")
    assert same(read_exr(tmp_path / "near.exr")[1], read_exr(tmp_path / "far.exr")[1])


def test_an_upload_goes_on_after_the_server_was_killed(stage: Path, tmp_path: Path) -> None:
    (stage.parent / "fog.vdb").write_bytes(random.Random(6).randbytes(40_000_000))
    options = ("--listen", f"unix:{tmp_path}/socket", "--data", tmp_path / "data")
    heard: list[int] = []
    with contextlib.ExitStack() as servers:
        first = servers.enter_context(start(*options))
        killed = threading.Event()

        def told(done: int, total: int) -> None:
            heard.append(done)
            if done > 0.4 * total and not killed.is_set():
                killed.set()
                first.process.send_signal(signal.SIGKILL)
                first.process.wait(10)
                servers.enter_context(start(*options))

        with Client(first.address) as client:
            bundle = client.upload(stage, told)
            assert killed.is_set()
            later = heard[next(at for at in range(len(heard)) if heard[at] > 15_000_000) :]
            assert min(later) > 2_000_000, "it did not begin anew"
            take_away(stage)
            client.submit(spec_of(bundle.stage_path, bundle=bundle.digest)).wait()


def test_a_job_needs_its_upload_longer_than_the_server_lives(stage: Path, tmp_path: Path, read_exr: ReadExr) -> None:
    options = ("--listen", f"unix:{tmp_path}/socket", "--data", tmp_path / "data")
    with start(*options) as server, Client(server.address) as client:
        bundle = client.upload(stage)
        take_away(stage)
        layer = layer_spec(spec_of(bundle.stage_path, bundle=bundle.digest), frames="1-2")
        job = client.farm.submit(job_spec(layer, paused=True))
        server.process.send_signal(signal.SIGKILL)
    assert not list((tmp_path / "data").glob("bundles/*/main.usda")), "it was not laid out yet"
    with start(*options) as server, Client(server.address) as client:
        job = client.farm.job(job.name)
        job.resume()
        job.wait()
        for frame in (1, 2):
            job.save(tmp_path / f"{frame}.exr", frame)
    assert not same(read_exr(tmp_path / "1.exr")[1], read_exr(tmp_path / "2.exr")[1]), "the ball moves"


def test_the_quota_is_said_in_words(stage: Path, tmp_path: Path) -> None:
    (stage.parent / "fog.vdb").write_bytes(random.Random(6).randbytes(2_000_000))
    with start("--quota-bytes", "0.001") as server:
        result = subprocess.run(
            [FOOTLIGHT, "render", stage, "-o", tmp_path / "a.exr", "--upload", "--server", server.address],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert result.returncode == Exit.LIMIT
    assert "do not fit" in result.stderr
    assert "Traceback" not in result.stderr
