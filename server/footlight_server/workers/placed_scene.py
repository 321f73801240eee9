"""The core's scene, and where its camera stands: positions in a film count from there."""

from typing import Any

import numpy as np

import footlight_core


class PlacedScene(footlight_core.Scene):  # type: ignore[misc]  # the core has no types
    """As the core's."""

    # [stage units] x, y, z.
    origin: tuple[float, ...] = (0.0, 0.0, 0.0)

    def set_camera(self, **camera: Any) -> None:
        """Arguments as of the core's."""
        self.origin = tuple(float(x) for x in camera["camera_to_world"][3, :3])
        super().set_camera(**camera)


def empty_scene(origin: tuple[float, ...]) -> footlight_core.Scene:
    """Nothing but a camera that stands there."""
    scene = footlight_core.Scene()
    place = np.eye(4)
    place[3, :3] = origin
    scene.set_camera(path="", camera_to_world=place)
    return scene
