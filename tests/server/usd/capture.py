"""A SceneSink that records the calls and checks what they promise: types, shapes, indices, finite values."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from footlight_server.usd.sink import Doubles, Floats, Indices


@dataclass(frozen=True, slots=True)
class CapturedInstances:
    path: str
    meshes: list[int]
    local_transforms: Doubles
    transforms: Doubles


@dataclass(slots=True)
class CapturingSink:
    """Keyword arguments of every call, in order."""

    camera: dict[str, Any] = field(default_factory=dict)
    materials: list[dict[str, Any]] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)
    instances: list[CapturedInstances] = field(default_factory=list)
    lights: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    prune: str = ""  # the answer to every light

    def set_camera(self, **arguments: Any) -> None:
        _check_matrices(arguments["camera_to_world"][None])
        assert arguments["focal_length"] > 0
        assert arguments["horizontal_aperture"] > 0
        assert arguments["vertical_aperture"] > 0
        assert 0 <= arguments["clipping_range"][0] < arguments["clipping_range"][1]
        self.camera = arguments

    def add_material(self, **arguments: Any) -> int:
        for name in ("diffuse_color", "specular_color", "emissive_color"):
            assert len(arguments[name]) == 3
            assert min(arguments[name]) >= 0
        for name in ("metallic", "roughness", "clearcoat", "clearcoat_roughness", "opacity"):
            assert 0 <= arguments[name] <= 1
        assert arguments["ior"] > 0
        self.materials.append(arguments)
        return len(self.materials) - 1

    def add_mesh(self, **arguments: Any) -> int:
        points, triangles = arguments["points"], arguments["triangles"]
        assert 0 <= arguments["material"] < len(self.materials)
        _check_array(points, np.float32, 3)
        _check_array(triangles, np.uint32, 3)
        assert triangles.size
        assert int(triangles.max()) < len(points)
        for values, indices, width in (("normals", "normal_indices", 3), ("colors", "color_indices", 3)):
            _check_primvar(arguments[values], arguments[indices], width, len(points), len(triangles))
        _check_primvar(arguments["opacities"], arguments["opacity_indices"], 0, len(points), len(triangles))
        self.meshes.append(arguments)
        return len(self.meshes) - 1

    def add_instances(
        self,
        *,
        path: str,
        meshes: Sequence[int],
        local_transforms: Doubles,
        transforms: Doubles,
        visible_to_camera: bool,
    ) -> None:
        assert visible_to_camera
        assert len(meshes) == len(local_transforms)
        assert all(0 <= mesh < len(self.meshes) for mesh in meshes)
        assert len(transforms)
        _check_matrices(local_transforms)
        _check_matrices(transforms)
        self.instances.append(CapturedInstances(path, list(meshes), local_transforms, transforms))

    def add_rect_light(self, **arguments: Any) -> str:
        return self._add_light("rect", arguments)

    def add_disk_light(self, **arguments: Any) -> str:
        return self._add_light("disk", arguments)

    def add_sphere_light(self, **arguments: Any) -> str:
        return self._add_light("sphere", arguments)

    def add_cylinder_light(self, **arguments: Any) -> str:
        return self._add_light("cylinder", arguments)

    def add_distant_light(self, **arguments: Any) -> str:
        return self._add_light("distant", arguments)

    def add_dome_light(self, **arguments: Any) -> str:
        if arguments["image"] is not None:
            assert arguments["image"].dtype == np.float32
            assert arguments["image"].shape[2] == 3
        return self._add_light("dome", arguments)

    def _add_light(self, kind: str, arguments: dict[str, Any]) -> str:
        _check_matrices(arguments["transform"][None])
        assert np.isfinite(arguments["emission"]).all()
        if not self.prune:
            self.lights.append((kind, arguments))
        return self.prune

    def placed(self) -> list[tuple[dict[str, Any], Doubles]]:
        """Every mesh at every place: (mesh, local to world), in the order of the calls."""
        return [
            (self.meshes[mesh], local @ transform)
            for group in self.instances
            for transform in group.transforms
            for mesh, local in zip(group.meshes, group.local_transforms, strict=True)
        ]

    def world_points(self, path: str) -> NDArray[np.float64]:
        """Points of all meshes of a path, in the world."""
        found = [to_world(mesh["points"], matrix) for mesh, matrix in self.placed() if mesh["path"] == path]
        return np.concatenate(found) if found else np.zeros((0, 3))


def to_world(points: Floats, matrix: Doubles) -> NDArray[np.float64]:
    moved: NDArray[np.float64] = points.astype(np.float64) @ matrix[:3, :3] + matrix[3, :3]
    return moved


def corners(mesh: dict[str, Any], name: str, indices: str) -> NDArray[Any]:
    """Values of a primvar at the triangles' corners, (T, 3, ...)."""
    values: NDArray[Any] = mesh[name]
    at: Indices = mesh["triangles"] if mesh[indices] is None else mesh[indices]
    return np.asarray(values[at])


def face_normals(mesh: dict[str, Any]) -> NDArray[np.float64]:
    """Geometric normals (T, 3) by the right-hand rule, twice the area long."""
    p = mesh["points"].astype(np.float64)[mesh["triangles"]]
    return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])


def area(mesh: dict[str, Any]) -> float:
    return float(np.linalg.norm(face_normals(mesh), axis=1).sum() / 2)


def _check_array(array: NDArray[Any], dtype: Any, width: int) -> None:
    assert array.dtype == dtype
    assert array.flags.c_contiguous
    assert array.shape[1:] == ((width,) if width else ())
    assert np.isfinite(array).all()


def _check_primvar(values: Any, indices: Any, width: int, points: int, triangles: int) -> None:
    if values is None:
        assert indices is None
        return
    _check_array(values, np.float32, width)
    if indices is None:
        assert len(values) == points
    else:
        _check_array(indices, np.uint32, 3)
        assert len(indices) == triangles
        assert int(indices.max()) < len(values)


def _check_matrices(matrices: NDArray[Any]) -> None:
    assert matrices.dtype == np.float64
    assert matrices.shape[1:] == (4, 4)
    assert np.isfinite(matrices).all()
