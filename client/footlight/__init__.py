"""Footlight's client: submit USD stages to a render service or its farm queue, watch them converge, fetch the images.

Importing this costs next to nothing; gRPC and numpy are loaded with the first name that is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from footlight.client import AsyncClient as AsyncClient
    from footlight.client import Client as Client
    from footlight.errors import FootlightError as FootlightError
    from footlight.image import LiveImage as LiveImage
    from footlight.image import Tile as Tile
    from footlight.image import TileBatch as TileBatch
    from footlight.jobs import AsyncJob as AsyncJob
    from footlight.jobs import Job as Job
    from footlight.paths import PathMap as PathMap
    from footlight.private import private_server as private_server
    from footlight.session import AsyncSession as AsyncSession
    from footlight.session import Session as Session
    from footlight.spec import render_spec as render_spec
    from footlight.submission import job_spec as job_spec
    from footlight.submission import layer_spec as layer_spec

__version__ = "0.1.0"

_HOME = {
    "AsyncClient": "client",
    "AsyncJob": "jobs",
    "AsyncSession": "session",
    "Client": "client",
    "FootlightError": "errors",
    "Job": "jobs",
    "LiveImage": "image",
    "PathMap": "paths",
    "Session": "session",
    "Tile": "image",
    "TileBatch": "image",
    "job_spec": "submission",
    "layer_spec": "submission",
    "private_server": "private",
    "render_spec": "spec",
}

__all__ = ["__version__", *_HOME]  # noqa: PLE0604 the keys are strings


def __dir__() -> list[str]:
    return [*__all__]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'footlight' has no attribute {name!r}")
    return getattr(import_module(f"footlight.{_HOME[name]}"), name)
