"""Decides whether two noisy images have the same mean: global z and 8x8-tile z, at a chosen false-alarm rate.

A per-pixel rule has no power against a uniform bias, and a global rule none against a local one: the first statistic
finds 0.3 % everywhere, the second 10 % in one tile. Both are Welch tests on standard errors from replicates.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 its documentation's name
from scipy import stats

TILE = 8  # [pixels], the side of a tile
ALPHA = 1e-5  # false alarms per comparison of two images: over a hundred comparisons, one in a thousand runs
ROUNDING = 2.0**-20  # of the brightest mean: what single precision explains where neither image has noise
Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measured:
    """A mean with the variance of that mean and its degrees of freedom, all of one shape."""

    mean: Array
    variance: Array
    freedom: Array


@dataclass(frozen=True, slots=True)
class Image:
    """An image (H, W, 3) with its means and their errors over the whole picture and over tiles, per channel."""

    pixels: Array
    whole: Measured
    tiles: Measured


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether two images differ, the strongest statistic, and its probability under equal means."""

    differ: bool
    probability: float
    threshold: float
    where: str
    global_z: Array


def tile_means(images: Array) -> Array:
    """Means of TILE x TILE tiles: (..., H, W, C) to (..., H/TILE, W/TILE, C); H and W are multiples of TILE."""
    *front, height, width, channels = images.shape
    means: Array = images.reshape(*front, height // TILE, TILE, width // TILE, TILE, channels).mean((-4, -2))
    return means


def of_replicates(replicates: Array) -> Image:
    """The mean of independent renders (R, H, W, 3) of one scene."""
    count = len(replicates)

    def measured(values: Array) -> Measured:
        mean = values.mean(0)
        return Measured(mean, values.var(0, ddof=1) / count, np.full(mean.shape, count - 1.0))

    return Image(replicates.mean(0), measured(replicates.mean((1, 2))), measured(tile_means(replicates)))


def of_standard_error(mean: Array, standard_error: Array, replicates: int) -> Image:
    """An image (H, W, 3) whose pixels are independent, with the standard error of each from that many replicates."""
    variance = standard_error**2
    height, width = mean.shape[:2]

    def measured(value: Array, value_variance: Array, pixels: int) -> Measured:
        # Pixels may differ in variance a lot: one pixel's degrees of freedom is the safe count.
        return Measured(value, value_variance / pixels, np.full(value.shape, replicates - 1.0))

    return Image(
        mean,
        measured(mean.mean((0, 1)), variance.mean((0, 1)), height * width),
        measured(tile_means(mean), tile_means(variance), TILE * TILE),
    )


def read_reference(path: Path) -> Image:
    """A reference written by make_references.py; one without its errors and their origin is refused."""
    buffer = oiio.ImageBuf(str(path))
    if buffer.has_error:
        raise OSError(f"{path}: {buffer.geterror()}")
    names, spec = list(buffer.spec().channelnames), buffer.spec()
    wanted = ["R", "G", "B", "se.R", "se.G", "se.B"]
    replicates = spec.getattribute("footlight:replicates")
    recorded = [spec.getattribute(f"footlight:{key}") is not None for key in ("renderer", "spp", "seed", "max_depth")]
    if sorted(names) != sorted(wanted) or not replicates or not all(recorded):
        raise ValueError(
            f"{path}: a reference holds {wanted} and its renderer, spp, seed and replicates; it has {names}"
        )
    planes = np.asarray(buffer.get_pixels(oiio.FLOAT), np.float64)[..., [names.index(name) for name in wanted]]
    return of_standard_error(planes[..., :3], planes[..., 3:], int(replicates))


def probabilities(a: Measured, b: Measured, rounding: float) -> tuple[Array, Array]:
    """Welch's statistic and its two-sided probability, element by element."""
    # Relative to the brightest: tails of a lobe that one renderer samples and the other never meets are no difference.
    floor = (rounding * max(float(np.abs(a.mean).max()), float(np.abs(b.mean).max()))) ** 2
    variance = a.variance + b.variance + floor
    tiny = np.finfo(np.float64).tiny
    freedom = variance**2 / np.maximum(a.variance**2 / a.freedom + b.variance**2 / b.freedom, tiny)
    z = (a.mean - b.mean) / np.sqrt(np.maximum(variance, tiny))
    return z, 2 * stats.t.sf(np.abs(z), np.clip(freedom, 1.0, 1e6))


def compare(a: Image, b: Image, alpha: float = ALPHA, rounding: float = ROUNDING) -> Verdict:
    """Tests equality of the means, globally and per tile and per channel, with Sidak's correction over all of them.

    `rounding` is a standard deviation on top of the noise, relative to the brightest mean.
    """
    if a.pixels.shape != b.pixels.shape:
        raise ValueError(f"images of {a.pixels.shape} and {b.pixels.shape} cannot be compared")
    if not (np.isfinite(a.pixels).all() and np.isfinite(b.pixels).all()):
        raise ValueError("an image with NaN or Inf has no mean")
    global_z, global_p = probabilities(a.whole, b.whole, rounding)
    tile_z, tile_p = probabilities(a.tiles, b.tiles, rounding)
    # Half of the false alarms for the three global statistics, half for the many tiles: neither hides the other.
    worst_global, worst_tile = int(global_p.argmin()), np.unravel_index(int(tile_p.argmin()), tile_p.shape)
    thresholds = [-math.expm1(math.log1p(-alpha / 2) / n) for n in (global_p.size, tile_p.size)]
    if global_p.min() / thresholds[0] <= tile_p.min() / thresholds[1]:
        relative = (
            a.whole.mean[worst_global] / b.whole.mean[worst_global] - 1 if b.whole.mean[worst_global] else math.inf
        )
        where = f"global mean of channel {worst_global}: z {global_z[worst_global]:+.2f}, {relative:+.3%}"
        probability, threshold = float(global_p.min()), thresholds[0]
    else:
        row, column, channel = (int(k) for k in worst_tile)
        values = a.tiles.mean[worst_tile], b.tiles.mean[worst_tile]
        where = (
            f"tile of pixels x {column * TILE}.., y {row * TILE}.., channel {channel}: z {tile_z[worst_tile]:+.2f}, "
            f"{values[0]:.6g} against {values[1]:.6g}"
        )
        probability, threshold = float(tile_p.min()), thresholds[1]
    return Verdict(probability < threshold, probability, threshold, where, global_z)


def scaled(image: Image, factor: float) -> Image:
    """The image a renderer with a relative bias of factor - 1 would make."""

    def times(measured: Measured) -> Measured:
        return Measured(measured.mean * factor, measured.variance * factor**2, measured.freedom)

    return Image(image.pixels * factor, times(image.whole), times(image.tiles))


def write_failure(folder: Path, image: Image, reference: Image) -> None:
    """Image, reference and difference as EXR and PNG; in the difference's PNG red is too bright, blue too dark."""
    folder.mkdir(parents=True, exist_ok=True)
    difference = image.pixels - reference.pixels
    white = max(float(np.percentile(reference.pixels, 98)), 1e-12)
    sign = difference.mean(-1) / (np.abs(reference.pixels).mean(-1) + 0.01 * white)
    signed = np.stack([np.clip(5 * sign, 0, 1), np.zeros_like(sign), np.clip(-5 * sign, 0, 1)], -1)
    for name, pixels, display in (
        ("image", image.pixels, np.clip(image.pixels / white, 0, 1) ** (1 / 2.2)),
        ("reference", reference.pixels, np.clip(reference.pixels / white, 0, 1) ** (1 / 2.2)),
        ("difference", difference, signed),
    ):
        for suffix, values in (("exr", pixels), ("png", display)):
            buffer = oiio.ImageBuf(oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "float"))
            buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(values, np.float32))
            buffer.write(str(folder / f"{name}.{suffix}"), "float" if suffix == "exr" else "uint8")
