"""What a translation talks to: the calls of footlight_core.Scene."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Indices = NDArray[np.uint32]
Ints = NDArray[np.int32]
Rgb = tuple[float, float, float]


class SceneSink(Protocol):
    """Receives a scene. Matrices (4, 4): row vectors, p' = p @ M. All refuse bad data with ValueError naming the path.

    The add_*_light calls return "" or the reason the light is not used.
    """

    def set_camera(
        self,
        *,
        path: str,
        camera_to_world: Doubles,
        focal_length: float,
        horizontal_aperture: float,
        vertical_aperture: float,
        horizontal_aperture_offset: float,
        vertical_aperture_offset: float,
        f_stop: float,
        focus_distance: float,
        clipping_range: tuple[float, float],
        exposure_scale: float,
    ) -> None:
        """Apertures and focal length in tenths of a stage unit, conformed to the image; distances in stage units."""

    def add_material(
        self,
        *,
        path: str,
        diffuse_color: Rgb,
        diffuse_from_primvar: bool,
        metallic: float,
        roughness: float,
        ior: float,
        specular_color: Rgb,
        use_specular_workflow: bool,
        clearcoat: float,
        clearcoat_roughness: float,
        emissive_color: Rgb,
        opacity: float,
        opacity_from_primvar: bool,
    ) -> int:
        """UsdPreviewSurface's constants; opacity after the threshold."""

    def add_mesh(
        self,
        *,
        path: str,
        material: int,
        points: Floats,
        triangles: Indices,
        normals: Floats | None,
        normal_indices: Indices | None,
        colors: Floats | None,
        color_indices: Indices | None,
        opacities: Floats | None,
        opacity_indices: Indices | None,
    ) -> int:
        """Points (N, 3) in object space [stage units], triangles (T, 3) counter-clockwise from outside.

        normals (M, 3), colors (K, 3), opacities (L,): one per point, or by *_indices (T, 3) per corner.
        """

    def add_instances(
        self,
        *,
        path: str,
        meshes: Sequence[int],
        local_transforms: Doubles,
        transforms: Doubles,
        visible_to_camera: bool,
    ) -> None:
        """The meshes with their local_transforms (len(meshes), 4, 4), placed by each of transforms (K, 4, 4)."""

    def add_rect_light(
        self,
        *,
        path: str,
        transform: Doubles,
        width: float,
        height: float,
        emission: Rgb,
        normalize: bool,
        visible_to_camera: bool,
    ) -> str:
        """Width along X, height along Y, light towards -Z."""

    def add_disk_light(
        self,
        *,
        path: str,
        transform: Doubles,
        radius: float,
        emission: Rgb,
        normalize: bool,
        visible_to_camera: bool,
    ) -> str:
        """Light towards -Z."""

    def add_sphere_light(
        self,
        *,
        path: str,
        transform: Doubles,
        radius: float,
        emission: Rgb,
        normalize: bool,
        visible_to_camera: bool,
    ) -> str:
        """Light outward."""

    def add_cylinder_light(
        self,
        *,
        path: str,
        transform: Doubles,
        radius: float,
        length: float,
        emission: Rgb,
        normalize: bool,
        visible_to_camera: bool,
    ) -> str:
        """Along X, without caps, light outward."""

    def add_distant_light(
        self,
        *,
        path: str,
        transform: Doubles,
        angle: float,
        emission: Rgb,
        normalize: bool,
        visible_to_camera: bool,
    ) -> str:
        """Light towards -Z from a disk of `angle` degrees across."""

    def add_dome_light(
        self, *, path: str, transform: Doubles, emission: Rgb, image: Floats | None, visible_to_camera: bool
    ) -> str:
        """Image (H, W, 3): latitude-longitude, top row +Y, centre column +Z, multiplied by emission."""
