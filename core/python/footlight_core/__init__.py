"""Footlight's core, compiled for several x86-64 levels: the best one this processor runs is loaded."""

import importlib
import os
from pathlib import Path
from types import ModuleType

_LEVELS = (
    ("_core_v4", {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}),
    ("_core_v3", {"avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"}),
    ("_core_v2", {"sse4_1", "sse4_2", "ssse3", "popcnt"}),
)


def _processor_flags() -> set[str]:
    with Path("/proc/cpuinfo").open(encoding="ascii", errors="replace") as lines:
        for line in lines:
            if line.startswith("flags"):
                return set(line.split(":", 1)[1].split())
    return set()


def _load() -> ModuleType:
    wanted = os.environ.get("FOOTLIGHT_INSTRUCTION_SET")
    flags = _processor_flags()
    found = []
    for name, needed in _LEVELS:
        level = name.removeprefix("_core_")
        if wanted is not None and wanted.removeprefix("x86-64-") != level:
            continue
        if not needed <= flags:
            continue
        try:
            return importlib.import_module(f"{__name__}.{name}")
        except ModuleNotFoundError:
            found.append(level)
    message = "no build of footlight_core runs on this processor"
    if wanted is not None:
        message += f" with FOOTLIGHT_INSTRUCTION_SET={wanted} (allowed: v2, v3, v4)"
    if found:
        message += f"; not built: {', '.join(found)}"
    raise ImportError(message)


_core = _load()
__version__: str = _core.__version__
instruction_set: str = _core.instruction_set
embree_version: str = _core.embree_version
AOVS = _core.AOVS
PIXEL_FILTERS = _core.PIXEL_FILTERS
STRATEGIES = _core.STRATEGIES
Scene = _core.Scene
RenderOptions = _core.RenderOptions
Renderer = _core.Renderer
subdivide = _core.subdivide

__all__ = [
    "AOVS",
    "PIXEL_FILTERS",
    "STRATEGIES",
    "RenderOptions",
    "Renderer",
    "Scene",
    "embree_version",
    "instruction_set",
    "subdivide",
]
