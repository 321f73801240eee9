"""The Footlight service: renders USD stages, streams tiles while they converge."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("footlight-server")
except PackageNotFoundError:  # run from a source tree
    __version__ = "0.0.0"
