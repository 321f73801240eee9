"""Renders the reference images of this folder with Mitsuba 3, an independent renderer.

Run: PYTHON tests/images/make_references.py [STAGE ...] [--replicates 32] [--spp 512]
with a Python that has mitsuba, numpy, usd-core and OpenImageIO (Mitsuba 3.9.1's LLVM back-end
needs LLVM 19, Debian's libllvm19: with 15 and 16 its kernels do not compile; DRJIT_LIBLLVM_PATH names the library).

Each stage is read here with pxr, by code that shares nothing with Footlight's translator. A reference holds the mean
(R G B) and the standard error of the mean (se.R se.G se.B) per pixel, from independent replicates, and in its metadata
their number, spp and seeds.

What the two renderers must agree on, and how it is held:
- box filter one pixel wide; max_depth counts path edges in both;
- UsdPreviewSurface with ior 1 and metallic 0 is Lambert; metals are Schlick GGX with alpha = roughness^2 <= 0.03, where
  energy compensation and height-correlated shadowing both differ from Mitsuba's `principled` by less than 0.1 %;
- faces are flat, so there are no shading normals to disagree about;
- lights are opaque black bodies; a distant light is a disk 1e5 stage units away;
- a dome texture is resampled with the bilinear, pixel-centred lookup onto Mitsuba's grid, whose rows lie on the poles.
"""

import argparse
import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 its documentation's name
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdShade

HERE = Path(__file__).parent
MAX_DEPTH = 6
FAR = 1e5  # [stage units], of the disk that stands for a distant light
Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Geometry:
    """One mesh in world space: points (N, 3) [stage units], triangles (T, 3)."""

    name: str
    points: Array
    triangles: npt.NDArray[np.int64]
    bsdf: dict[str, Any]


def rgb(value: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(x) for x in value]}


def world(prim: Usd.Prim) -> Array:
    """Local to world (4, 4), row vectors."""
    return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))


def column(matrix: Array) -> list[list[float]]:
    """The same transform for column vectors, as Mitsuba takes it."""
    columns: list[list[float]] = matrix.T.tolist()
    return columns


def bsdf(prim: Usd.Prim) -> dict[str, Any]:
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    shader = material.ComputeSurfaceSource()[0]
    value = {i.GetBaseName(): i.Get() for i in shader.GetInputs()}
    if value.get("metallic", 0):
        if value["roughness"] ** 2 > 0.03:
            raise ValueError(
                f"{prim.GetPath()}: roughness {value['roughness']} is outside what the two renderers share"
            )
        lobe = {
            "type": "principled",
            "base_color": rgb(value["diffuseColor"]),
            "metallic": 1.0,
            "roughness": value["roughness"],
            "specular": 0.5,
        }
    elif value.get("ior", 1.5) != 1:
        raise ValueError(
            f"{prim.GetPath()}: a dielectric layer is outside what the two renderers share; author ior = 1"
        )
    else:
        lobe = {"type": "diffuse", "reflectance": rgb(value["diffuseColor"])}
    return {"type": "twosided", "bsdf": lobe}


def mesh(prim: Usd.Prim, name: str, matrix: Array) -> Geometry:
    source = UsdGeom.Mesh(prim)
    points = np.array(source.GetPointsAttr().Get(), np.float64)
    counts, indices = source.GetFaceVertexCountsAttr().Get(), source.GetFaceVertexIndicesAttr().Get()
    triangles, start = [], 0
    for count in counts:
        face = indices[start : start + count]
        triangles += [(face[0], face[k], face[k + 1]) for k in range(1, count - 1)]
        start += count
    return Geometry(name, points @ matrix[:3, :3] + matrix[3, :3], np.array(triangles), bsdf(prim))


def geometry(stage: Usd.Stage) -> Iterator[Geometry]:
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim.IsA(UsdGeom.Mesh):
            yield mesh(prim, prim.GetPath().pathString.replace("/", "_"), world(prim))
        elif prim.IsA(UsdGeom.PointInstancer):
            prims.PruneChildren()
            yield from scatter(UsdGeom.PointInstancer(prim))


def scatter(instancer: UsdGeom.PointInstancer) -> Iterator[Geometry]:
    """Every visible instance as a mesh of its own; each prototype is one Mesh prim."""
    now = Usd.TimeCode.Default()
    prim = instancer.GetPrim()
    transforms = instancer.ComputeInstanceTransformsAtTime(now, now, applyMask=instancer.IgnoreMask)
    mask = instancer.ComputeMaskAtTime(now)
    prototypes = [prim.GetStage().GetPrimAtPath(p) for p in instancer.GetPrototypesRel().GetTargets()]
    for k, (which, transform) in enumerate(zip(instancer.GetProtoIndicesAttr().Get(), transforms, strict=True)):
        if not mask or mask[k]:
            yield mesh(prototypes[which], f"instance_{k}", np.array(transform) @ world(prim))


def radiance(prim: Usd.Prim, size: float) -> list[float]:
    """Emitted radiance per channel; `size` is what UsdLux divides by when inputs:normalize is on."""
    light = UsdLux.LightAPI(prim)
    if light.GetEnableColorTemperatureAttr().Get():
        raise ValueError(f"{prim.GetPath()}: colour temperature is not used in these stages")
    scale = light.GetIntensityAttr().Get() * 2.0 ** light.GetExposureAttr().Get()
    if light.GetNormalizeAttr().Get():
        scale /= size
    return [scale * c for c in light.GetColorAttr().Get()]


def uniform_scale(matrix: Array, prim: Usd.Prim) -> float:
    scales = np.linalg.norm(matrix[:3, :3], axis=1)
    if np.ptp(scales) > 1e-6 * scales.max():
        raise ValueError(f"{prim.GetPath()}: non-uniform light scale is not used in these stages")
    return float(scales.mean())


def dome_bitmap(path: str) -> Array:
    """(H, W, 3) on Mitsuba's grid: columns at pixel centres, rows from pole to pole; 8 times the source's size."""
    source: Array = np.asarray(oiio.ImageBuf(path).get_pixels(oiio.FLOAT), np.float64)[..., :3]
    height, width = source.shape[:2]
    rows, columns = np.arange(8 * height) / (8 * height - 1), (np.arange(8 * width) + 0.5) / (8 * width)
    y, x = np.clip(rows * height - 0.5, 0, height - 1), columns * width - 0.5
    y0, x0 = np.minimum(y.astype(int), height - 2), np.floor(x).astype(int)
    fy, fx = (y - y0)[:, None, None], (x - x0)[None, :, None]
    low = source[y0][:, x0 % width] * (1 - fx) + source[y0][:, (x0 + 1) % width] * fx
    high = source[y0 + 1][:, x0 % width] * (1 - fx) + source[y0 + 1][:, (x0 + 1) % width] * fx
    result: Array = low * (1 - fy) + high * fy
    return result


def emitter(mi: Any, prim: Usd.Prim) -> dict[str, Any]:
    """A UsdLux light as a Mitsuba shape or environment. Mitsuba's rectangle and disk face +Z, UsdLux's -Z."""
    matrix, transform = world(prim), mi.ScalarTransform4f
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    turn = np.diag([-1.0, 1.0, -1.0, 1.0])
    if prim.IsA(UsdLux.DomeLight):
        light = UsdLux.DomeLight(prim)
        scale = radiance(prim, 1.0)
        texture = light.GetTextureFileAttr().Get()
        image = dome_bitmap(texture.resolvedPath) if texture else np.ones((16, 32, 3))
        bitmap = mi.Bitmap((image * scale).astype(np.float32))
        return {"type": "envmap", "bitmap": bitmap, "to_world": transform(column(matrix))}
    if prim.IsA(UsdLux.RectLight):
        rect = UsdLux.RectLight(prim)
        width, height = rect.GetWidthAttr().Get(), rect.GetHeightAttr().Get()
        area = width * height * uniform_scale(matrix, prim) ** 2
        to_world = turn @ np.diag([width / 2, height / 2, 1, 1]) @ matrix
        shape: dict[str, Any] = {"type": "rectangle", "to_world": transform(column(to_world))}
    elif prim.IsA(UsdLux.DiskLight):
        radius = UsdLux.DiskLight(prim).GetRadiusAttr().Get()
        area = math.pi * (radius * uniform_scale(matrix, prim)) ** 2
        shape = {"type": "disk", "to_world": transform(column(turn @ np.diag([radius, radius, radius, 1]) @ matrix))}
    elif prim.IsA(UsdLux.SphereLight):
        radius = UsdLux.SphereLight(prim).GetRadiusAttr().Get() * uniform_scale(matrix, prim)
        area = 4 * math.pi * radius**2
        shape = {"type": "sphere", "center": matrix[3, :3].tolist(), "radius": radius}
    elif prim.IsA(UsdLux.CylinderLight):
        tube, scale_ = UsdLux.CylinderLight(prim), uniform_scale(matrix, prim)
        half = tube.GetLengthAttr().Get() / 2
        ends = np.array([[-half, 0, 0, 1], [half, 0, 0, 1]]) @ matrix
        radius = tube.GetRadiusAttr().Get() * scale_
        area = 2 * math.pi * radius * 2 * half * scale_
        shape = {"type": "cylinder", "p0": ends[0, :3].tolist(), "p1": ends[1, :3].tolist(), "radius": radius}
    elif prim.IsA(UsdLux.DistantLight):
        half_angle = math.radians(UsdLux.DistantLight(prim).GetAngleAttr().Get()) / 2
        area = math.pi * math.sin(half_angle) ** 2
        radius = FAR * math.tan(half_angle)
        place = np.diag([radius, radius, radius, 1.0])
        place[3, 2] = FAR
        rotation = matrix.copy()
        rotation[3, :3] = 0
        shape = {"type": "disk", "to_world": transform(column(turn @ place @ rotation))}
    else:
        raise ValueError(f"{prim.GetPath()}: {prim.GetTypeName()} has no counterpart here")
    return shape | {"bsdf": black, "emitter": {"type": "area", "radiance": rgb(radiance(prim, area))}}


def sensor(mi: Any, stage: Usd.Stage, size: tuple[int, int]) -> dict[str, Any]:
    prim = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Camera))
    camera = UsdGeom.Camera(prim)
    width, height = camera.GetHorizontalApertureAttr().Get(), camera.GetVerticalApertureAttr().Get()
    focal = camera.GetFocalLengthAttr().Get()
    if abs(width / height - size[0] / size[1]) > 1e-6:
        raise ValueError(f"{prim.GetPath()}: the aperture must have the image's aspect")
    # Mitsuba's camera looks along +Z with +X to the left; its principal point moves the image, not the window.
    to_world = np.diag([-1.0, 1.0, -1.0, 1.0]) @ world(prim)
    near, far = camera.GetClippingRangeAttr().Get()
    result = {
        "type": "perspective", "fov_axis": "x", "fov": math.degrees(2 * math.atan(width / 2 / focal)),
        "principal_point_offset_x": camera.GetHorizontalApertureOffsetAttr().Get() / width,
        "principal_point_offset_y": -camera.GetVerticalApertureOffsetAttr().Get() / height,
        "near_clip": near, "far_clip": far, "to_world": mi.ScalarTransform4f(column(to_world)),
        "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"},
                 "pixel_format": "rgb", "component_format": "float32"},
        "sampler": {"type": "independent", "sample_count": 16},
    }  # fmt: skip
    if camera.GetFStopAttr().Get() > 0:
        # UsdGeomCamera: the focal length is in tenths of a stage unit, the focus distance in stage units.
        result |= {"type": "thinlens", "aperture_radius": focal / 10 / (2 * camera.GetFStopAttr().Get()),
                   "focus_distance": camera.GetFocusDistanceAttr().Get()}  # fmt: skip
        if result.pop("principal_point_offset_x") or result.pop("principal_point_offset_y"):
            raise ValueError(f"{prim.GetPath()}: Mitsuba's thin lens has no aperture offset")
    return result


def check_camera(mi: Any, scene: Any, stage: Usd.Stage) -> None:
    """Mitsuba's rays through the corners of the image are those of GfCamera's frustum."""
    prim = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Camera))
    frustum = UsdGeom.Camera(prim).GetCamera(Usd.TimeCode.Default()).frustum
    sensor_ = scene.sensors()[0]
    for x, y in ((0.02, 0.02), (0.98, 0.02), (0.5, 0.5), (0.02, 0.98), (0.9, 0.6)):
        ray, _ = sensor_.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5, 0.5))
        pick = frustum.ComputePickRay(Gf.Vec2d(2 * x - 1, 1 - 2 * y)).direction
        theirs = np.array(ray.d).reshape(3)
        if np.linalg.norm(theirs - np.array(Gf.Vec3d(pick).GetNormalized())) > 1e-4:
            raise AssertionError(f"{prim.GetPath()}: at ({x}, {y}) Mitsuba looks along {theirs}, USD along {pick}")


def check_metal(mi: Any) -> None:
    """Mitsuba's `principled` metal is Schlick's F times GGX with Smith's G to 0.2 %, away from grazing."""
    base, roughness = np.array([0.95, 0.75, 0.35]), 0.17
    alpha = roughness**2
    lobe = mi.load_dict(
        {"type": "principled", "base_color": rgb(base), "metallic": 1.0, "roughness": roughness, "specular": 0.5}
    )
    for angle in (0.0, 0.5, 1.0, 1.3):
        for tilt in (0.0, 0.02, 0.05):
            wo = np.array([math.sin(angle), 0, math.cos(angle)])
            wi = np.array([-math.sin(angle - tilt), 0.01, math.cos(angle - tilt)])
            wi /= np.linalg.norm(wi)
            h = (wo + wi) / np.linalg.norm(wo + wi)
            d = 1 / (math.pi * alpha**2 * ((h[0] / alpha) ** 2 + (h[1] / alpha) ** 2 + h[2] ** 2) ** 2)
            g1 = [2 * c / (c + math.sqrt(alpha**2 * (1 - c * c) + c * c)) for c in (wo[2], wi[2])]
            f = base + (1 - base) * (1 - wo @ h) ** 5
            expected = f * d * g1[0] * g1[1] / (4 * wo[2])
            si = mi.SurfaceInteraction3f()
            si.wi = mi.Vector3f(*wo.tolist())
            value = np.array(lobe.eval(mi.BSDFContext(), si, mi.Vector3f(*wi.tolist()))).reshape(3)
            if np.abs(value / expected - 1).max() > 2e-3:
                raise AssertionError(f"principled metal at {angle}, {tilt}: {value} instead of {expected}")


def build(mi: Any, stage: Usd.Stage, size: tuple[int, int], folder: Path) -> Any:
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": 1000},
        "sensor": sensor(mi, stage, size),
    }
    for part in geometry(stage):
        shape = mi.Mesh(part.name, len(part.points), len(part.triangles))
        values = mi.traverse(shape)
        values["vertex_positions"] = part.points.astype(np.float32).ravel()
        values["faces"] = part.triangles.astype(np.uint32).ravel()
        values.update()
        shape.write_ply(str(folder / f"{part.name}.ply"))
        scene[part.name] = {
            "type": "ply",
            "filename": str(folder / f"{part.name}.ply"),
            "face_normals": True,
            "bsdf": part.bsdf,
        }
    for prim in stage.Traverse():
        if prim.HasAPI(UsdLux.LightAPI):
            scene[prim.GetPath().pathString.replace("/", "_")] = emitter(mi, prim)
    return mi.load_dict(scene)


def write(path: Path, mean: Array, standard_error: Array, metadata: dict[str, Any]) -> None:
    spec = oiio.ImageSpec(mean.shape[1], mean.shape[0], 6, "float")
    spec.channelnames = ("R", "G", "B", "se.R", "se.G", "se.B")
    spec.attribute("compression", "zip")
    for key, value in metadata.items():
        spec.attribute(key, value)
    output = oiio.ImageOutput.create(str(path))
    pixels = np.concatenate([mean, standard_error], -1).astype(np.float32)
    if not (output and output.open(str(path), spec) and output.write_image(pixels) and output.close()):
        raise OSError(f"cannot write {path}: {oiio.geterror()}")


def render(mi: Any, stage_path: Path, replicates: int, spp: int) -> None:
    stage = Usd.Stage.Open(str(stage_path))
    resolution = stage.GetPrimAtPath(stage.GetMetadata("renderSettingsPrimPath")).GetAttribute("resolution").Get()
    size = (resolution[0], resolution[1])
    with tempfile.TemporaryDirectory() as folder:
        scene = build(mi, stage, size, Path(folder))
        check_camera(mi, scene, stage)
        images = np.stack(
            [np.array(mi.render(scene, spp=spp, seed=1 + k), np.float64)[..., :3] for k in range(replicates)]
        )
    mean, standard_error = images.mean(0), images.std(0, ddof=1) / math.sqrt(replicates)
    metadata = {
        "footlight:renderer": f"Mitsuba {mi.__version__} {mi.variant()}", "footlight:integrator": "path",
        "footlight:max_depth": MAX_DEPTH, "footlight:replicates": replicates, "footlight:spp": spp * replicates,
        "footlight:seed": 1, "footlight:last_seed": replicates,
    }  # fmt: skip
    write(HERE / "references" / f"{stage_path.stem}.exr", mean, standard_error, metadata)
    error = np.sqrt((standard_error**2).mean()) / mean.mean()
    means = mean.mean((0, 1)).round(5)
    print(f"{stage_path.stem}: {size}, {spp * replicates} spp, mean {means}, rms error {error:.2%}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", help="names in stages/; all of them without")
    parser.add_argument("--replicates", type=int, default=32)
    parser.add_argument("--spp", type=int, default=512, help="samples per pixel of one replicate")
    arguments = parser.parse_args()

    import mitsuba as mi  # type: ignore[import-not-found]

    mi.set_variant("scalar_rgb")
    check_metal(mi)
    mi.set_variant("llvm_ad_rgb")
    names = arguments.stages or sorted(p.stem for p in (HERE / "stages").glob("*.usda"))
    for name in names:
        render(mi, HERE / "stages" / f"{name}.usda", arguments.replicates, arguments.spp)


if __name__ == "__main__":
    main()
