"""How Footlight speaks to Ray: with a token, over TLS or on this machine only, and with Ray's own memory killer off.

Measured with Ray 2.60: by default all ports listen on every interface without a token, and Ray kills any worker when
the machine runs short, even for what another process took. Limits on memory are ours, per worker.
"""

import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from footlight.loopback import is_loopback

# The resource that a node declares for each task it takes at a time.
LANE_RESOURCE = "footlight_lane"
# [bytes] A token is 64 hexadecimal digits, a private key a few kilobytes.
_LARGEST_SECRET = 16384


class ClusterError(ValueError):
    """An option or file of the cluster that cannot be accepted; the message says what is."""


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """PEM files: the node's certificate, its key, and the authority that signed those of all nodes."""

    certificate: Path
    key: Path
    authority: Path


@dataclass(frozen=True, slots=True)
class Access:
    """What opens a cluster. Without TLS it is one of this machine alone."""

    token: Path
    tls: TlsFiles | None = None


def check_access(host: str, access: Access) -> None:
    """Raises ClusterError unless a node at `host` would be safe: token 0600; TLS unless it is on loopback."""
    _check_secret("--token-file", access.token)
    if access.tls is None:
        if not is_loopback(host):
            raise ClusterError(
                f"{host} is not a loopback address. Whoever reaches a Ray node can run code with its rights, so other "
                "addresses need --tls-cert, --tls-key and --tls-ca"
            )
        return
    _check_secret("--tls-key", access.tls.key)
    for option, path in (("--tls-cert", access.tls.certificate), ("--tls-ca", access.tls.authority)):
        if not path.is_file():
            raise ClusterError(f"{option} {path}: no such file")


def ray_environment(access: Access, surroundings: Mapping[str, str]) -> dict[str, str]:
    """The environment for any process that starts or joins a cluster."""
    kept = {name: value for name, value in surroundings.items() if not name.startswith("RAY_")}
    chosen = {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN_PATH": str(access.token.absolute()),
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_memory_monitor_refresh_ms": "0",
        # With a window for its own log lines Ray would print into ours.
        "RAY_DEDUP_LOGS": "0",
    }
    if access.tls is None:
        # The only way to have every port of Ray listen on 127.0.0.1: what it does by itself where it knows no clusters.
        chosen["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
    else:
        chosen |= {
            "RAY_USE_TLS": "1",
            "RAY_TLS_SERVER_CERT": str(access.tls.certificate.absolute()),
            "RAY_TLS_SERVER_KEY": str(access.tls.key.absolute()),
            "RAY_TLS_CA_CERT": str(access.tls.authority.absolute()),
        }
    return kept | chosen


def access_of(surroundings: Mapping[str, str], token: Path | None, tls: TlsFiles | None) -> Access:
    """The access to use: what was given, else the token where `footlight cluster up` puts it."""
    return Access(token or default_token(surroundings), tls)


def default_token(surroundings: Mapping[str, str]) -> Path:
    """Where the token of this user's cluster is."""
    home = Path(surroundings.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    return home / "footlight" / "cluster-token"


def _check_secret(option: str, path: Path) -> None:
    try:
        status = path.stat()
    except OSError as error:
        raise ClusterError(f"{option} {path}: {error.strerror}") from error
    if not stat.S_ISREG(status.st_mode) or not 0 < status.st_size <= _LARGEST_SECRET:
        raise ClusterError(f"{option} {path}: not a secret's file")
    if status.st_mode & 0o077:
        raise ClusterError(f"{option} {path}: others may read it; allow only yourself (chmod 600)")
    if status.st_uid not in {os.geteuid(), 0}:
        raise ClusterError(f"{option} {path}: belongs to another user")
