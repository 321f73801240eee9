"""Samples per second of one thread with the core of one instruction set: instruction_set.py v2|v3|v4 TRIANGLES."""

import importlib
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.bench.scenes import rippled_sphere

SIZE = 256
SPP = 16


def main(isa: str, triangles: int) -> None:
    """Render a ball on a floor under a square light and print the rate [samples/s]."""
    core = importlib.import_module(f"footlight_core._core_{isa}")
    scene = core.Scene()
    camera = np.eye(4)
    camera[3, 2] = 4.0
    scene.set_camera(
        path="/Camera",
        camera_to_world=camera,
        focal_length=35.0,
        horizontal_aperture=24.0,
        vertical_aperture=24.0,
        horizontal_aperture_offset=0.0,
        vertical_aperture_offset=0.0,
        f_stop=0.0,
        focus_distance=0.0,
        clipping_range=(0.1, 1000.0),
        exposure_scale=1.0,
    )
    gloss = scene.add_material(
        path="/Gloss",
        diffuse_color=(0.6, 0.5, 0.3),
        diffuse_from_primvar=False,
        metallic=0.0,
        roughness=0.3,
        ior=1.5,
        specular_color=(0.0, 0.0, 0.0),
        use_specular_workflow=False,
        clearcoat=0.0,
        clearcoat_roughness=0.01,
        emissive_color=(0.0, 0.0, 0.0),
        opacity=1.0,
        opacity_from_primvar=False,
    )
    grid = rippled_sphere(triangles)
    quads = grid.indices.reshape(-1, 4)
    ball = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)
    floor = np.array([[-5, -1, 5], [5, -1, 5], [5, -1, -5], [-5, -1, -5]], np.float32)
    for path, points, corners in (
        ("/Ball", grid.points, ball),
        ("/Floor", floor, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)),
    ):
        mesh = scene.add_mesh(path=path, material=gloss, points=points, triangles=corners)
        scene.add_instances(path=path, meshes=[mesh], local_transforms=np.eye(4)[None], transforms=np.eye(4)[None])
    down = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 3, 0, 1]], np.float64)
    scene.add_rect_light(
        path="/Lamp",
        transform=down,
        width=2.0,
        height=2.0,
        emission=(5.0, 5.0, 5.0),
        normalize=False,
        visible_to_camera=True,
    )
    options = core.RenderOptions(width=SIZE, height=SIZE, threads=1)
    renderer = core.Renderer(scene, options)
    start = time.perf_counter()
    renderer.render(0, SPP, 0, renderer.tiles)
    print(SIZE * SIZE * SPP / (time.perf_counter() - start))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
