"""Write AOVs as one multi-channel EXR: float32, zip, typed attributes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 its documentation's name
from numpy.typing import NDArray

from footlight_server.images.files import ImageError, replacing, why_not_written

Attribute = int | float | str | tuple[int, int] | Sequence[str]
Pixels = NDArray[np.float32]

# The image itself has EXR's bare names; any other AOV is a layer with components.
BARE = {"color": "RGB", "alpha": "A"}
COMPONENTS = {"depth": "Z", "normal": "XYZ", "position": "XYZ"}
COMPONENTS_BY_COUNT = {1: "Y", 3: "RGB"}

# OpenImageIO would put the time of writing, and equal renders would differ in bytes.
DATE_TIME = "1970:01:01 00:00:00"


def write_exr(path: Path, aovs: Mapping[str, Pixels], attributes: Mapping[str, Attribute]) -> None:
    """Write `aovs`, each (H, W, C), to `path`.

    `color` becomes R G B and `alpha` A; any other AOV becomes `name.component`, as in `depth.Z`,
    `normal.X`, `albedo.R`. `attributes` are stored as `footlight:name` with their type: int, float, string,
    a pair of ints (`v2i`), strings (`stringvector`). The same arguments give the same bytes. The file
    appears whole or not at all. Raises ImageError naming the file and the reason, ValueError for images
    that do not fit together.
    """
    names, planes = _channels(aovs)
    pixels = np.ascontiguousarray(np.concatenate(planes, axis=2), dtype=np.float32)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.FLOAT)
    spec.channelnames = names
    spec.attribute("compression", "zip")
    spec.attribute("oiio:ColorSpace", "lin_rec709_scene")
    spec.attribute("Software", "Footlight")
    spec.attribute("DateTime", DATE_TIME)
    for name, value in attributes.items():
        _set_attribute(spec, f"footlight:{name}", value)
    write_image(path, spec, pixels)


def write_image(path: Path, spec: oiio.ImageSpec, pixels: NDArray[np.generic]) -> None:
    """Write `pixels` in the format that the suffix of `path` names. Whole or not at all; errors as above."""
    with replacing(path) as temporary:
        output = oiio.ImageOutput.create(str(temporary))
        if output is None:
            raise ImageError(f"{path}: cannot be written: {oiio.geterror()}")
        written = output.open(str(temporary), spec) and output.write_image(pixels)
        reason = output.geterror()
        closed = output.close()  # writes tables and trailers, so it can fail as well
        if not (written and closed):
            raise ImageError(why_not_written(path, reason or output.geterror()))


def _channels(aovs: Mapping[str, Pixels]) -> tuple[list[str], list[Pixels]]:
    """Channel names and planes (H, W, C) in the file's order: color, alpha, then the others by name."""
    order = sorted(aovs, key=lambda name: (name != "color", name != "alpha", name))
    sizes = {aovs[name].shape[:2] for name in order}
    if len(sizes) != 1:
        raise ValueError(f"the AOVs of an image have one size, not {sorted(sizes)}")
    names: list[str] = []
    for name in order:
        count = aovs[name].shape[2]
        components = BARE.get(name) or COMPONENTS.get(name) or COMPONENTS_BY_COUNT.get(count, "")
        if len(components) != count:
            raise ValueError(f"AOV {name} cannot have {count} channels")
        names += [part if name in BARE else f"{name}.{part}" for part in components]
    return names, [aovs[name] for name in order]


def _set_attribute(spec: oiio.ImageSpec, name: str, value: Attribute) -> None:
    match value:
        case int() if not -(2**31) <= value < 2**31:
            spec.attribute(name, str(value))  # EXR's int has 32 bits with sign; a larger one stays readable
        case int() | float() | str():
            spec.attribute(name, value)
        case (int(first), int(second)):
            spec.attribute(name, oiio.TypeDesc(oiio.INT, oiio.VEC2), (first, second))
        case _:
            strings = tuple(str(item) for item in value)
            if strings:
                spec.attribute(name, oiio.TypeDesc(f"string[{len(strings)}]"), strings)
