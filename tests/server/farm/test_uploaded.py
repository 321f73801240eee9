"""Jobs with an uploaded stage: confined workers, sample ranges and their merge, and no path of the server's disk."""

from dataclasses import dataclass
from pathlib import Path

import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest

from footlight_server.farm.model import ExitClass, JobState
from footlight_server.sessions.errors import BlobsMissingError
from tests.server.farm.farm import Place, digest

BUNDLE = f"{'a' * 64}/100"


@dataclass
class LaidOut:
    """Bundles that are laid out already."""

    root: Path

    async def materialise(self, digest: str) -> Path:
        if digest != BUNDLE:
            raise BlobsMissingError(f"{digest} is not here", [digest])
        return self.root


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


@pytest.fixture
def bundles(place: Place) -> LaidOut:
    root = place.data / "bundles" / ("a" * 64)
    (root / "shot").mkdir(parents=True)
    (root / "shot" / "stage.usda").write_text(place.stage.read_text())
    (root / "bad.usda").write_text("#usda 1.0\ndef Xform (")
    return LaidOut(root)


async def test_an_uploaded_stage_renders_confined_whole_and_split(place: Place, bundles: LaidOut) -> None:
    stage = {"bundle": BUNDLE, "stage_path": "shot/stage.usda", "frames": "3", "spp": 4, "aovs": ["position"]}
    async with place.farm(bundles=bundles) as farm:
        whole = await farm.render(place.job(output=str(place.out / "whole.####.exr"), **stage))
        await farm.render(place.job(output=str(place.out / "split.####.exr"), split=2, **stage))
        assert digest(place.out / "whole.0003.exr") == digest(place.out / "split.0003.exr")
        header = oiio.ImageBuf(str(place.out / "whole.0003.exr")).spec()
        assert header.getattribute("footlight:stage") == "shot/stage.usda"
        assert oiio.ImageBuf(str(await farm.farm.sheet(whole, "main"))).spec().width == 24 + 2 * 4


async def test_messages_name_files_of_the_bundle_as_the_client_knows_them(place: Place, bundles: LaidOut) -> None:
    async with place.farm(bundles=bundles) as farm:
        job = await farm.submit(place.job(bundle=BUNDLE, stage_path="bad.usda", frames="1"))
        assert (await farm.end(job)).state is JobState.FAILED
        (attempt,) = await farm.attempts(job)
        assert attempt.exit_class is ExitClass.SCENE
        assert attempt.message.startswith("bad.usda: ")
        assert str(place.data) not in farm.log(job)


async def test_a_bundle_that_is_not_here_fails_and_says_so(place: Place, bundles: LaidOut) -> None:
    async with place.farm(bundles=bundles) as farm:
        other = BUNDLE.replace("a", "b")
        job = await farm.submit(place.job(bundle=other, stage_path="stage.usda", frames="1"))
        assert (await farm.end(job)).state is JobState.FAILED
        assert other in (await farm.attempts(job))[0].message
