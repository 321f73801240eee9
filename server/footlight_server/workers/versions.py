"""What runs in a worker, by name and version, for statistics and EXR files."""

import platform
from functools import cache
from importlib.metadata import version

import footlight_core


@cache
def versions() -> dict[str, str]:
    """Names as in RenderStats.versions."""
    return {
        "footlight": version("footlight-server"),
        "footlight_core": footlight_core.__version__,
        "instruction_set": footlight_core.instruction_set,
        "embree": footlight_core.embree_version,
        "usd": version("usd-core"),
        "python": platform.python_version(),
    }
