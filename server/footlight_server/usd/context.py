"""What every prim translator works with: the stage, the sink, the report, the looks, the counts."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from footlight_server.usd.errors import StageLimitError
from footlight_server.usd.report import Report
from footlight_server.usd.request import TranslateRequest
from footlight_server.usd.sink import Doubles, Floats, SceneSink

if TYPE_CHECKING:
    from footlight_server.usd.prims.materials import Looks

# Is told how many texels an image has before they are read. Raises StageLimitError.
Admit = Callable[[int], None]
# Reads an image file: path -> (H, W, 3) float32, linear. Raises OSError or ValueError with the reason.
LoadImage = Callable[[str, Admit], NDArray[np.float32]]


class Subdivide(Protocol):
    """footlight_core.subdivide."""

    def __call__(
        self, points: Any, face_counts: Any, face_indices: Any, scheme: str, level: int, **options: Any
    ) -> dict[str, Any]:
        """Limit surface of a cage: points, normals, triangles, normal_indices, face_of_triangle, primvars."""


@dataclass(slots=True)
class Context:
    """One translation under way."""

    stage: Any
    sink: SceneSink
    report: Report
    request: TranslateRequest
    time: Any  # Usd.TimeCode
    looks: "Looks"
    load_image: LoadImage | None
    subdivide: Subdivide
    mesh_bounds: dict[int, Floats] = field(default_factory=dict)  # mesh id -> (2, 3) low and high corner
    shape_meshes: dict[tuple[object, ...], int] = field(default_factory=dict)  # implicit shapes of one look
    refined: dict[str, list[str]] = field(default_factory=dict)  # why subdivided -> prim paths

    def count(self, name: str, n: int, path: object) -> None:
        """Adds to the counts. Raises StageLimitError when that breaks the budget."""
        self.check(name, n, path)
        self.report.counts[name] += n

    def check(self, name: str, n: int, path: object) -> None:
        """Raises StageLimitError if so many more would break the budget."""
        total = self.report.counts[name] + n
        limit = getattr(self.request.budget, name, 0)
        if limit and total > limit:
            message = f"{path}: with it the stage has {total} {name}, allowed are {limit}"
            raise StageLimitError(message, str(path))


@dataclass(slots=True)
class Part:
    """A mesh at its place in its group."""

    mesh: int
    path: str
    transform: Doubles


@dataclass(slots=True)
class GroupLight:
    """A light at its place in its group; `add(transform)` hands it to the sink."""

    path: str
    transform: Doubles
    add: Callable[[Doubles], str]


@dataclass(slots=True)
class Group:
    """Things placed together: the world, or a prototype. Children are placed (K, 4, 4) in this group's space."""

    path: str
    parts: list[Part] = field(default_factory=list)
    lights: list[GroupLight] = field(default_factory=list)
    children: list[tuple["Group", Doubles]] = field(default_factory=list)

    @property
    def is_empty(self) -> bool:
        """Nothing would be rendered of it."""
        return not (self.parts or self.lights or self.children)
