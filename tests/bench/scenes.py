"""Stages to measure with, made in code: a room, a sphere of many triangles, the same geometry by instancing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

Points = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Grid:
    """A closed rippled sphere as quads: points (N, 3), four indices per quad."""

    points: Points
    indices: Indices

    @property
    def triangles(self) -> int:
        """How many triangles the quads make."""
        return len(self.indices) // 2


def rippled_sphere(triangles: int) -> Grid:
    """A sphere of radius 1 with ripples and about that many triangles; longitude runs twice as fine as latitude."""
    rows = max(2, round(np.sqrt(triangles / 4)))
    columns = 2 * rows
    latitude, longitude = np.meshgrid(
        np.linspace(0.02, np.pi - 0.02, rows + 1), np.arange(columns) * (2 * np.pi / columns), indexing="ij"
    )
    radius = 1 + 0.02 * np.sin(17 * longitude) * np.sin(23 * latitude)
    points = np.stack(
        [
            radius * np.sin(latitude) * np.sin(longitude),
            radius * np.cos(latitude),
            radius * np.sin(latitude) * np.cos(longitude),
        ],
        axis=-1,
    )
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    following = (column + 1) % columns
    corners = [(row, column), (row + 1, column), (row + 1, following), (row, following)]
    indices = np.stack([r * columns + c for r, c in corners], axis=-1)
    return Grid(points.reshape(-1, 3).astype(np.float32), indices.reshape(-1).astype(np.int32))


def material(stage: Usd.Stage, name: str, color: tuple[float, float, float], **inputs: float) -> UsdShade.Material:
    """A UsdPreviewSurface of constants."""
    made = UsdShade.Material.Define(stage, f"/World/Materials/{name}")
    shader = UsdShade.Shader.Define(stage, f"/World/Materials/{name}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color))
    for key, value in inputs.items():
        shader.CreateInput(key, Sdf.ValueTypeNames.Float).Set(value)
    made.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return made


def mesh(stage: Usd.Stage, path: str, points: Points, counts: Indices, indices: Indices) -> UsdGeom.Mesh:
    """A polygon mesh without subdivision."""
    made = UsdGeom.Mesh.Define(stage, path)
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, np.float32)))
    made.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(counts, np.int32)))
    made.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(indices, np.int32)))
    made.CreateSubdivisionSchemeAttr("none")
    return made


def bind(prim: UsdGeom.Gprim, bound: UsdShade.Material) -> None:
    """Bind a material."""
    UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(bound)


def new_stage(path: Path, eye: tuple[float, float, float]) -> Usd.Stage:
    """An empty stage with a camera that looks along -Z from `eye` and the scope for materials."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateFocalLengthAttr(35.0)
    camera.CreateHorizontalApertureAttr(24.0)
    camera.CreateVerticalApertureAttr(24.0)
    camera.AddTranslateOp().Set(Gf.Vec3d(*eye))
    return stage


def rect_light(stage: Usd.Stage, name: str, height: float, size: float, intensity: float) -> None:
    """A square light at that height that shines down."""
    light = UsdLux.RectLight.Define(stage, f"/World/{name}")
    light.CreateWidthAttr(size)
    light.CreateHeightAttr(size)
    light.CreateIntensityAttr(intensity)
    light.AddTranslateOp().Set(Gf.Vec3d(0, height, 0))
    light.AddRotateXOp().Set(-90.0)


def write_room(path: Path, triangles: int) -> None:
    """A closed room, 2 wide, with an area light, a glossy and a diffuse rippled sphere of half the triangles each."""
    stage = new_stage(path, (0, 0, 3.9))
    white = material(stage, "White", (0.73, 0.73, 0.73), roughness=1.0)
    gloss = material(stage, "Gloss", (0.9, 0.7, 0.4), roughness=0.25, metallic=1.0)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    walls = np.array([[0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [0, 2, 3, 1], [4, 5, 7, 6]], np.int32)
    bind(mesh(stage, "/World/Walls", corners, np.full(5, 4), walls.reshape(-1)), white)
    grid = rippled_sphere(triangles // 2)
    for name, x, bound in (("Left", -0.45, white), ("Right", 0.45, gloss)):
        ball = mesh(stage, f"/World/{name}", grid.points * 0.42, np.full(len(grid.indices) // 4, 4), grid.indices)
        ball.AddTranslateOp().Set(Gf.Vec3d(x, -0.55, 0))
        bind(ball, bound)
    rect_light(stage, "Lamp", 0.99, 0.5, 15.0)
    stage.Save()


def write_flat(path: Path, triangles: int) -> Grid:
    """One mesh of about that many triangles under a dome."""
    stage = new_stage(path, (0, 0, 4))
    grid = rippled_sphere(triangles)
    made = mesh(stage, "/World/Sphere", grid.points, np.full(len(grid.indices) // 4, 4), grid.indices)
    bind(made, material(stage, "White", (0.7, 0.7, 0.7), roughness=0.6))
    UsdLux.DomeLight.Define(stage, "/World/Dome")
    stage.Save()
    return grid


def write_instanced(path: Path, triangles: int, copies: int) -> int:
    """That many triangles as copies of one rippled sphere through a PointInstancer; answers how many it made."""
    stage = new_stage(path, (0, 0, 40))
    grid = rippled_sphere(triangles // copies)
    instancer = UsdGeom.PointInstancer.Define(stage, "/World/Field")
    made = mesh(stage, "/World/Field/Sphere", grid.points, np.full(len(grid.indices) // 4, 4), grid.indices)
    bind(made, material(stage, "White", (0.7, 0.7, 0.7), roughness=0.6))
    instancer.CreatePrototypesRel().AddTarget(made.GetPath())
    side = int(np.ceil(np.sqrt(copies)))
    place = np.arange(copies)
    positions = np.stack([place % side - side / 2, place // side - side / 2, np.zeros(copies)], axis=-1)
    instancer.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy((positions * 22 / side).astype(np.float32)))
    instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(np.full((copies, 3), 10 / side, np.float32)))
    instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(np.zeros(copies, np.int32)))
    UsdLux.DomeLight.Define(stage, "/World/Dome")
    stage.Save()
    return grid.triangles * copies
