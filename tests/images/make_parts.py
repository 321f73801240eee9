"""Writes what the stages share and nobody writes by hand: a tessellated sphere and a small dome texture.

Run: python tests/images/make_parts.py  (needs numpy and OpenImageIO; writes stages/parts/).
"""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 its documentation's name

PARTS = Path(__file__).parent / "stages" / "parts"
SEGMENTS, RINGS = 48, 24
DOME_WIDTH, DOME_HEIGHT = 128, 64


def sphere_layer() -> str:
    """A unit sphere of flat quads and triangles, wound counter-clockwise seen from outside, poles on Y."""
    points = ["(0, 1, 0)"]
    for ring in range(1, RINGS):
        theta = math.pi * ring / RINGS
        for segment in range(SEGMENTS):
            phi = 2 * math.pi * segment / SEGMENTS
            x, y, z = math.sin(theta) * math.sin(phi), math.cos(theta), math.sin(theta) * math.cos(phi)
            points.append(f"({x:.6f}, {y:.6f}, {z:.6f})")
    points.append("(0, -1, 0)")

    def at(ring: int, segment: int) -> int:
        return 1 + (ring - 1) * SEGMENTS + segment % SEGMENTS

    counts: list[int] = []
    indices: list[int] = []
    for segment in range(SEGMENTS):
        counts.append(3)
        indices += [0, at(1, segment), at(1, segment + 1)]
    for ring in range(1, RINGS - 1):
        for segment in range(SEGMENTS):
            # Two triangles per cell: a quad of six rounded decimals is not quite flat.
            corners = (at(ring, segment), at(ring + 1, segment), at(ring + 1, segment + 1), at(ring, segment + 1))
            counts += [3, 3]
            indices += [corners[0], corners[1], corners[2], corners[0], corners[2], corners[3]]
    for segment in range(SEGMENTS):
        counts.append(3)
        indices += [len(points) - 1, at(RINGS - 1, segment + 1), at(RINGS - 1, segment)]
    return (
        "#usda 1.0\n"
        '(\n    defaultPrim = "Sphere"\n    doc = "A unit sphere of flat faces; written by make_parts.py."\n)\n\n'
        'def Mesh "Sphere"\n{\n'
        f"    int[] faceVertexCounts = {counts}\n"
        f"    int[] faceVertexIndices = {indices}\n"
        f"    point3f[] points = [{', '.join(points)}]\n"
        '    uniform token subdivisionScheme = "none"\n}\n'
    )


def dome_image() -> npt.NDArray[np.float32]:
    """(H, W, 3) radiance, lat-long as UsdLux says (centre +Z, top +Y); constant rows at the poles; one bright spot."""
    v, u = np.meshgrid(
        (np.arange(DOME_HEIGHT) + 0.5) / DOME_HEIGHT, (np.arange(DOME_WIDTH) + 0.5) / DOME_WIDTH, indexing="ij"
    )
    theta, longitude = v * math.pi, (0.5 - u) * 2 * math.pi
    x, y, z = np.sin(theta) * np.sin(longitude), np.cos(theta), np.sin(theta) * np.cos(longitude)
    away_from_poles = np.sin(theta) ** 2
    sky = np.stack([0.5 + 0.2 * y, 0.5 + 0.1 * y, 0.5 + 0.3 * y], -1)
    bands = (0.3 * np.sin(3 * longitude + 1) * away_from_poles)[..., None] * np.array([1.0, 0.2, -0.6])
    spot = np.array([0.6, 0.5, 0.62]) / np.linalg.norm([0.6, 0.5, 0.62])
    cosine = x * spot[0] + y * spot[1] + z * spot[2]
    sun = np.exp((cosine - 1.0) / (1.0 - math.cos(math.radians(4.0))))[..., None] * np.array([60.0, 50.0, 35.0])
    image: npt.NDArray[np.float32] = (sky + bands + sun).astype(np.float32)
    return image


def main() -> None:
    PARTS.mkdir(parents=True, exist_ok=True)
    (PARTS / "sphere.usda").write_text(sphere_layer())
    spec = oiio.ImageSpec(DOME_WIDTH, DOME_HEIGHT, 3, "half")
    spec.attribute("compression", "zip")
    output = oiio.ImageOutput.create(str(PARTS / "dome.exr"))
    if not (output and output.open(str(PARTS / "dome.exr"), spec) and output.write_image(dome_image())):
        raise OSError(f"cannot write {PARTS / 'dome.exr'}: {oiio.geterror()}")
    output.close()


if __name__ == "__main__":
    main()
