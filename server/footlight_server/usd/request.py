"""What is asked of a translation."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Budget:
    """Upper limits; a stage beyond one of them is refused with the prim's path. 0: no limit."""

    prims: int = 2_000_000
    points: int = 400_000_000
    triangles: int = 400_000_000
    instances: int = 20_000_000
    lights: int = 100_000
    pixels: int = 1 << 28
    texels: int = 1 << 30


@dataclass(frozen=True, slots=True)
class TranslateRequest:
    """What to translate, and how. None: what the stage says, else the default.

    Attributes:
        camera: prim path; default: RenderSettings, else the first camera, else a framed one.
        time_code: every value is read at this time; default: the stage's startTimeCode, else 0.
        size: (width, height) [pixels]; default: RenderSettings, else 1280 x 720.
        purposes: of the prims to render; default: RenderSettings, else default and render.
        material_purpose: "full", "preview" or "" (allPurpose only); default: RenderSettings, else full.
        refinement: subdivision level, 0 draws the cage; default: by the size of each mesh, see prims/subdivision.py.
        lights_visible_to_camera: area lights and domes are seen directly.
        roots: textures must lie below one of these directories; empty: anywhere.
    """

    camera: str | None = None
    time_code: float | None = None
    size: tuple[int, int] | None = None
    purposes: tuple[str, ...] | None = None
    material_purpose: str | None = None
    refinement: int | None = None
    lights_visible_to_camera: bool = True
    roots: tuple[Path, ...] = ()
    budget: Budget = field(default_factory=Budget)
