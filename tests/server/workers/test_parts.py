"""The law of split frames: sample ranges merged are the unsplit frame, byte for byte; and what is refused."""

import hashlib
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight.v1 import render_pb2
from footlight.worker.v1 import worker_pb2
from footlight_server.images.files import ImageError
from footlight_server.workers.part import PartError, read_head, read_part, write_part
from footlight_server.workers.pool import WorkerPool
from tests.server.api.service import STAGE

AOVS = ("depth", "normal", "albedo", "position", "error", "sample_count")
SPP = 7


@pytest.fixture
async def pool() -> AsyncIterator[WorkerPool]:
    pool = WorkerPool(0, spare=False)
    yield pool
    await pool.close()


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    path = tmp_path / "stage.usda"
    path.write_text(STAGE)
    return path


def spec_of(stage: Path, **options: object) -> render_pb2.RenderSpec:
    given = {"width": 40, "height": 30, "spp": SPP, "max_depth": 3, "seed": 5, "aovs": AOVS, "threads": 1}
    spec = render_pb2.RenderSpec(stage_path=str(stage), **(given | options))
    spec.pixel_filter = render_pb2.PIXEL_FILTER_BLACKMAN_HARRIS
    spec.strategy = render_pb2.STRATEGY_MIS
    return spec


async def run(pool: WorkerPool, task: worker_pb2.Task) -> worker_pb2.WorkerEvent:
    """The last thing a worker says to a task."""
    worker = await pool.take(task)
    try:
        await worker.send(worker_pb2.WorkerRequest(task=task))
        while True:
            event = await worker.receive()
            if event.WhichOneof("event") in {"done", "failed"}:
                return event
    finally:
        await worker.close()


async def rendered(pool: WorkerPool, spec: render_pb2.RenderSpec, path: Path) -> worker_pb2.Done:
    event = await run(pool, worker_pb2.Task(spec=spec, exr_path=str(path)))
    assert event.HasField("done"), event.failed
    return event.done


async def parts(pool: WorkerPool, spec: render_pb2.RenderSpec, edges: list[int], directory: Path) -> list[Path]:
    paths = []
    for begin, end in pairwise(edges):
        path = directory / f"{begin}.part"
        task = worker_pb2.Task(spec=spec, part_path=str(path), sample_begin=begin, sample_end=end)
        event = await run(pool, task)
        assert event.HasField("done"), event.failed
        assert event.done.stats.spp == end - begin
        paths.append(path)
    return paths


async def merged(pool: WorkerPool, spec: render_pb2.RenderSpec, made: list[Path], exr: Path) -> worker_pb2.WorkerEvent:
    merge_paths = [str(path) for path in made]
    thumbnail = str(exr.with_suffix(".thumb.png"))
    task = worker_pb2.Task(spec=spec, merge_paths=merge_paths, exr_path=str(exr), thumbnail_path=thumbnail)
    task.png_path = str(exr.with_suffix(".png"))
    return await run(pool, task)


def color(path: Path) -> np.ndarray:
    """(H, W, 3)."""
    pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
    assert pixels is not None
    return np.asarray(pixels)[..., :3]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("edges", [[0, 3, SPP], [0, 1, 2, SPP]], ids=["two", "three, single samples"])
async def test_sample_ranges_merge_to_the_bytes_of_the_unsplit_frame(
    pool: WorkerPool, stage: Path, tmp_path: Path, edges: list[int]
) -> None:
    spec = spec_of(stage, png=render_pb2.Png())
    whole = await run(
        pool, worker_pb2.Task(spec=spec, exr_path=str(tmp_path / "whole.exr"), png_path=str(tmp_path / "whole.png"))
    )
    assert whole.HasField("done"), whole.failed
    made = await parts(pool, spec, edges, tmp_path)
    event = await merged(pool, spec, made[::-1], tmp_path / "merged.exr")
    assert event.HasField("done"), event.failed
    assert digest(tmp_path / "merged.exr") == digest(tmp_path / "whole.exr")
    assert digest(tmp_path / "merged.png") == digest(tmp_path / "whole.png")
    there, expected = event.done.stats, whole.done.stats
    assert (there.samples, there.spp, dict(there.rays)) == (expected.samples, SPP, dict(expected.rays))
    assert (there.error_mean, there.error_p95) == (expected.error_mean, expected.error_p95)


async def test_the_mutant_that_adds_single_precision_images_is_another_image(
    pool: WorkerPool, stage: Path, tmp_path: Path
) -> None:
    """What the law above would not notice if it could not fail: the mean of the ranges' pictures."""
    spec = spec_of(stage)
    pictures = []
    edges = [0, 3, SPP]
    for path in await parts(pool, spec, edges, tmp_path):
        head, film = read_part(path)
        alone = tmp_path / f"{path.stem}.alone.part"
        head.spec.spp = head.sample_end - head.sample_begin
        head.sample_begin, head.sample_end = 0, head.spec.spp
        write_part(alone, head, film)
        assert (await merged(pool, head.spec, [alone], alone.with_suffix(".exr"))).HasField("done")
        pictures.append(color(alone.with_suffix(".exr")))
    await rendered(pool, spec, tmp_path / "whole.exr")
    whole = color(tmp_path / "whole.exr")
    weights = np.diff(edges).astype(np.float32) / np.float32(SPP)
    naive = sum(w * picture for w, picture in zip(weights, pictures, strict=True))
    assert np.abs(naive - whole).max() < 1e-4 * whole.max()
    assert not np.array_equal(naive, whole)


async def test_ranges_that_are_not_all_of_one_image_are_refused(pool: WorkerPool, stage: Path, tmp_path: Path) -> None:
    spec = spec_of(stage)
    first, second = await parts(pool, spec, [0, 3, SPP], tmp_path)
    (tmp_path / "other").mkdir()
    other, _ = await parts(pool, spec_of(stage, seed=6), [0, 3, SPP], tmp_path / "other")
    exr = tmp_path / "merged.exr"
    for wrong, says in [
        ([first], "3 samples of 7"),
        ([second], "do not fit"),
        ([first, first, second], "do not fit"),
        ([other, second], "different images"),
    ]:
        event = await merged(pool, spec, wrong, exr)
        assert event.failed.reason == render_pb2.FAILURE_REASON_SCENE
        assert says in event.failed.message
        assert not exr.exists()


async def test_a_damaged_part_is_refused(pool: WorkerPool, stage: Path, tmp_path: Path) -> None:
    spec = spec_of(stage, spp=1)
    (path,) = await parts(pool, spec, [0, 1], tmp_path)
    good = path.read_bytes()
    half, flipped, none = tmp_path / "half.part", tmp_path / "flipped.part", tmp_path / "none.part"
    half.write_bytes(good[: len(good) // 2])
    flipped.write_bytes(good[:-20] + bytes([good[-20] ^ 1]) + good[-19:])
    none.write_bytes(b"something else")
    for wrong in (half, flipped, none, tmp_path / "gone.part"):
        with pytest.raises(PartError, match=wrong.name):
            read_part(wrong)
        event = await merged(pool, spec, [wrong], tmp_path / "merged.exr")
        assert event.failed.reason == render_pb2.FAILURE_REASON_OUTPUT
    assert not (tmp_path / "merged.exr").exists()


def test_a_part_reads_back_as_it_was_written(tmp_path: Path) -> None:
    head = worker_pb2.Part(sample_begin=3, sample_end=9, origin=[1.0, -2.5, 1e300])
    film = bytes(range(256)) * 1000
    write_part(tmp_path / "a.part", head, film)
    assert read_part(tmp_path / "a.part") == (head, film)
    assert read_head(tmp_path / "a.part") == head
    assert (tmp_path / "a.part").stat().st_size < len(film) / 10
    with pytest.raises(ImageError, match=r"nowhere.*No such file"):
        write_part(tmp_path / "nowhere" / "a.part", head, film)


async def test_the_thumbnail_is_small_and_the_environment_reaches_the_worker(
    pool: WorkerPool, stage: Path, tmp_path: Path
) -> None:
    task = worker_pb2.Task(
        spec=spec_of(stage, width=400, height=100, spp=1, aovs=[]),
        exr_path=str(tmp_path / "a.exr"),
        thumbnail_path=str(tmp_path / "a.png"),
    )
    assert (await run(pool, task)).HasField("done")
    spec = oiio.ImageBuf(str(tmp_path / "a.png")).spec()
    assert (spec.width, spec.height, spec.nchannels, str(spec.format)) == (320, 80, 3, "uint8")
    task.spec.png.view = "no such view"
    task.environment["OCIO"] = str(tmp_path / "studio.ocio")
    event = await run(pool, task)
    assert event.failed.reason == render_pb2.FAILURE_REASON_INVALID_ARGUMENT
    assert "studio.ocio" in event.failed.message
