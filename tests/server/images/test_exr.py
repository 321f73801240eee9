"""What is written to an EXR is what is read back, bit for bit, under the names that DESIGN promises."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from footlight_server.images.exr import write_exr
from footlight_server.images.files import ImageError

CHANNELS = {"color": 3, "alpha": 1, "depth": 1, "normal": 3, "albedo": 3, "position": 3, "error": 3, "sample_count": 1}


def planes(names: list[str], height: int = 5, width: int = 7) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    return {name: rng.normal(size=(height, width, CHANNELS[name])).astype(np.float32) for name in names}


def read(path: Path) -> tuple[oiio.ImageSpec, np.ndarray]:
    image = oiio.ImageInput.open(str(path))
    assert image is not None
    pixels = image.read_image(oiio.FLOAT)
    assert pixels is not None
    return image.spec(), pixels


def test_every_aov_comes_back_bit_for_bit(tmp_path: Path) -> None:
    aovs = planes(list(CHANNELS))
    aovs["depth"][0, 0] = np.inf
    aovs["color"][1, 1] = np.nan
    write_exr(tmp_path / "a.exr", aovs, {})
    spec, pixels = read(tmp_path / "a.exr")
    assert spec.channelnames[:4] == ("R", "G", "B", "A")
    assert set(spec.channelnames[4:]) == {
        "depth.Z",
        *(f"{name}.{part}" for name in ("normal", "position") for part in "XYZ"),
        *(f"{name}.{part}" for name in ("albedo", "error") for part in "RGB"),
        "sample_count.Y",
    }
    by_name = dict(zip(spec.channelnames, np.moveaxis(pixels, 2, 0), strict=True))
    for name, prefix, parts in [
        ("color", "", "RGB"),
        ("alpha", "", "A"),
        ("depth", "depth.", "Z"),
        ("normal", "normal.", "XYZ"),
    ]:
        for index, part in enumerate(parts):
            assert by_name[prefix + part].tobytes() == np.ascontiguousarray(aovs[name][..., index]).tobytes()


@settings(deadline=None, max_examples=20)
@given(arrays.arrays(np.float32, (3, 4, 3), elements=st.floats(width=32, allow_nan=False)))
def test_any_float_comes_back(tmp_path_factory: pytest.TempPathFactory, color: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("any") / "a.exr"
    write_exr(path, {"color": color}, {})
    assert read(path)[1].tobytes() == color.tobytes()


def test_attributes_keep_their_type(tmp_path: Path) -> None:
    write_exr(
        tmp_path / "a.exr",
        planes(["color"]),
        {
            "seed": 7,
            "large_seed": 2**32 - 1,
            "samples": (0, 64),
            "error_mean": 0.25,
            "version": "0.1.0",
            "effects": ["dome", "specular"],
            "none": [],
        },
    )
    spec, _ = read(tmp_path / "a.exr")
    found = {a.name.removeprefix("footlight:"): a.value for a in spec.extra_attribs if a.name.startswith("footlight:")}
    assert found == {
        "seed": 7,
        "large_seed": "4294967295",
        "samples": (0, 64),
        "error_mean": 0.25,
        "version": "0.1.0",
        "effects": ("dome", "specular"),
    }
    assert spec.get_string_attribute("compression") == "zip"
    assert spec.format == oiio.FLOAT


def test_equal_images_are_equal_files(tmp_path: Path) -> None:
    for name in ("a.exr", "b.exr"):
        write_exr(tmp_path / name, planes(["color", "alpha"]), {"seed": 1})
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_a_missing_directory_is_named(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match=r"gone/a.exr: cannot be written: No such file or directory"):
        write_exr(tmp_path / "gone" / "a.exr", planes(["color"]), {})


def test_sizes_have_to_agree(tmp_path: Path) -> None:
    aovs = planes(["color"]) | planes(["depth"], height=2)
    with pytest.raises(ValueError, match="one size"):
        write_exr(tmp_path / "a.exr", aovs, {})


FULL_DISK = """
import resource, signal, sys
import numpy as np
from pathlib import Path
from footlight_server.images.exr import write_exr
from footlight_server.images.files import ImageError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
noise = np.random.default_rng(1).random((300, 300, 3), np.float32)
try:
    write_exr(Path(sys.argv[1]), {"color": noise}, {})
except ImageError as error:
    sys.exit(str(error))
"""


def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    path.write_bytes(b"what was there before")
    run = subprocess.run([sys.executable, "-c", FULL_DISK, path], capture_output=True, text=True, check=False)
    assert run.returncode == 1, run.stderr
    assert f"{path}: cannot be written" in run.stderr
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.exr"]
    assert path.read_bytes() == b"what was there before"
