"""`footlight serve`: the server of footlight-server, in this process."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

from footlight.private import NoServerError


def run_serve(listen: str, workers: int, roots: list[Path]) -> None:
    """Become the server. Raises NoServerError if it is not installed."""
    if find_spec("footlight_server") is None:
        raise NoServerError(
            "footlight-server is not installed in this Python; install it with: pip install footlight-server"
        )
    options = [f"--listen={listen}", f"--workers={workers}", *(f"--root={root.absolute()}" for root in roots)]
    os.execv(sys.executable, [sys.executable, "-m", "footlight_server", *options])  # noqa: S606 no shell is meant
