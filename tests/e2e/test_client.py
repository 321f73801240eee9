"""The Python client: tiles end as the image does, with threads and with asyncio."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight import AsyncClient, Client, LiveImage, TileBatch, render_spec
from footlight.errors import (
    InvalidRequestError,
    RenderCancelledError,
    RenderFailedError,
    RenderNotFoundError,
    ResultNotReadyError,
    StageNotFoundError,
)
from footlight.v1 import render_pb2

# [1] Half precision has 11 bits of significand; rounding to nearest is wrong by half of the last.
HALF_STEP = 2.0**-11


def read(path: Path) -> dict[str, np.ndarray]:
    image = oiio.ImageInput.open(str(path))
    assert image is not None
    pixels = image.read_image(oiio.FLOAT)
    assert pixels is not None
    return dict(zip(image.spec().channelnames, np.moveaxis(pixels, 2, 0), strict=True))


def assert_same(live: LiveImage, channels: dict[str, np.ndarray], *, exact: bool) -> None:
    color = np.stack([channels[name] for name in "RGB"], axis=2)
    if exact:
        assert live.pixels["color"].tobytes() == color.tobytes()
        assert live.pixels["depth"][..., 0].tobytes() == channels["depth.Z"].tobytes()
    else:
        np.testing.assert_allclose(live.pixels["color"], color, rtol=HALF_STEP, atol=2.0**-24)


@pytest.mark.parametrize("exact", [True, False])
def test_tiles_end_as_the_image(server: str, room: Path, tmp_path: Path, exact: bool) -> None:
    live, states, batches = LiveImage(), [], 0
    with Client(server) as client:
        session = client.submit(render_spec(room, size=(150, 100), spp=8, aovs=["depth"]))
        for event in session.events(["color", "depth"], exact=exact):
            if isinstance(event, TileBatch):
                live.add(event)
                batches += 1
            elif isinstance(event, render_pb2.Render):
                states.append(event.state)
        assert states[-1] == render_pb2.RENDER_STATE_SUCCEEDED
        assert states == sorted(states)
        assert batches > 0
        session.save(tmp_path / "a.exr")
        assert session.result() == (tmp_path / "a.exr").read_bytes()
        assert session.wait().stats.samples == 150 * 100 * 8
    assert_same(live, read(tmp_path / "a.exr"), exact=exact)


async def test_the_same_with_asyncio(server: str, room: Path, tmp_path: Path) -> None:
    live = LiveImage()
    async with AsyncClient(server) as client:
        session = await client.submit(render_spec(room, size=(150, 100), spp=8, aovs=["depth"], png=True))
        async for event in session.events(["color", "depth"], exact=True):
            if isinstance(event, TileBatch):
                live.add(event)
        render = await session.wait()
        assert render.state == (await session.get()).state == render_pb2.RENDER_STATE_SUCCEEDED
        await session.save(tmp_path / "a.exr")
        assert (await session.result("png")).startswith(b"\x89PNG")
        assert session.name in [known.name for known in await client.renders()]
        assert (await client.explain(render_spec(room))).report.pipeline
    assert_same(live, read(tmp_path / "a.exr"), exact=True)


def test_a_viewer_that_comes_late_sees_the_whole_image(server: str, room: Path) -> None:
    with Client(server) as client:
        session = client.submit(render_spec(room, size=(80, 40), spp=1))
        session.wait()
        events = list(client.session(session.name).events())
        assert isinstance(events[0], render_pb2.Render)
        assert events[0].has_result


def test_cancel_ends_the_render(server: str, room: Path) -> None:
    with Client(server) as client:
        session = client.submit(render_spec(room, size=(640, 480), spp=1 << 20))
        session.cancel()
        with pytest.raises(RenderCancelledError) as error:
            session.wait()
        assert not error.value.has_result
        with pytest.raises(ResultNotReadyError):
            session.result()
        assert session.cancel().state == render_pb2.RENDER_STATE_CANCELLED


def test_leaving_early_leaves_the_render_running(server: str, room: Path) -> None:
    with Client(server) as client:
        session = client.submit(render_spec(room, size=(64, 64), spp=64))
        for _ in session.events():
            break
        assert session.wait().state == render_pb2.RENDER_STATE_SUCCEEDED


def test_errors_have_types(server: str, room: Path, tmp_path: Path) -> None:
    with Client(server) as client:
        with pytest.raises(StageNotFoundError, match=r"missing\.usda"):
            client.submit(render_spec(tmp_path / "missing.usda"))
        with pytest.raises(InvalidRequestError, match="max_depth") as bad:
            client.submit(render_spec(room, max_depth=1 << 20))
        assert [field for field, _ in bad.value.fields] == ["spec.max_depth"]
        with pytest.raises(RenderNotFoundError):
            client.session("renders/none").get()
        with pytest.raises(RenderFailedError, match="/World/Nobody") as failed:
            client.submit(render_spec(room, camera="/World/Nobody")).wait()
        assert failed.value.reason == "INVALID_ARGUMENT"


def test_the_example_of_the_readme_runs(server: str, room: Path, tmp_path: Path) -> None:
    readme = Path(__file__).parents[2] / "client" / "README.md"
    program = readme.read_text().partition("```python\n")[2].partition("```")[0]
    program = program.replace("127.0.0.1:50051", server).replace("shot.usda", str(room)).replace("spp=256", "spp=2")
    run = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "shot.exr").exists()
