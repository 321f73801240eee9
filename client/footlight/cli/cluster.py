"""`footlight cluster`: the commands of footlight_server.cluster, in this process."""

from importlib.util import find_spec

from footlight.cli.serve import become
from footlight.private import NoServerError


def run_cluster(action: str, arguments: list[str]) -> None:
    """Become `python -m footlight_server.cluster`. Raises NoServerError if it is not installed."""
    if find_spec("footlight_server") is None:
        raise NoServerError(
            "footlight-server is not installed in this Python; install it with: pip install 'footlight-server[ray]'"
        )
    become("footlight_server.cluster", [action, *arguments])
