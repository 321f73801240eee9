"""The way to a server: plain on this machine, TLS and a token beyond it."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

import grpc

from footlight.errors import CredentialsError
from footlight.loopback import is_loopback

# Called again, by gRPC, where the connection broke before an answer: reading, and what is idempotent by its request_id.
_REPEATABLE = ("RenderService", "StageService", "JobService")

_SERVICE_CONFIG = {
    "methodConfig": [
        {
            "name": [{"service": f"footlight.v1.{service}"} for service in _REPEATABLE],
            "retryPolicy": {
                "maxAttempts": 4,
                "initialBackoff": "0.2s",
                "maxBackoff": "1s",
                "backoffMultiplier": 2,
                "retryableStatusCodes": ["UNAVAILABLE"],
            },
        }
    ]
}

_OPTIONS = (
    # [ms] A server that vanished without a word is noticed after the two together.
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    # [ms] A server that comes back is found before the last of those tries; gRPC's own pauses grow to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 500),
    # Farm servers are reached directly; $http_proxy has no business there.
    ("grpc.enable_http_proxy", 0),
    ("grpc.service_config", json.dumps(_SERVICE_CONFIG)),
)


@dataclass(frozen=True, slots=True)
class Credentials:
    """What a client shows and whom it trusts. Files are PEM.

    `token` is sent over TLS only. `ca` holds the certificates that the server's may be signed by; without it those that
    gRPC brings along. `certificate` and `key` are for servers that ask clients for a certificate too.
    """

    token: str = ""
    ca: str | os.PathLike[str] | None = None
    certificate: str | os.PathLike[str] | None = None
    key: str | os.PathLike[str] | None = None


def is_local(address: str) -> bool:
    """`address` is a Unix socket or on the loopback interface."""
    if address.startswith(("unix:", "unix-abstract:")):
        return True
    return is_loopback(address.rpartition(":")[0].strip("[]"))


def open_channel(address: str, credentials: Credentials) -> grpc.Channel:
    """A channel for calls from threads. Nothing is sent yet. Raises CredentialsError for a file that cannot be read."""
    secure = _secure(address, credentials)
    if secure is None:
        return grpc.insecure_channel(address, options=_OPTIONS)
    return grpc.secure_channel(address, secure, options=_OPTIONS)


def open_async_channel(address: str, credentials: Credentials) -> grpc.aio.Channel:
    """As `open_channel`, for the running loop."""
    secure = _secure(address, credentials)
    if secure is None:
        return grpc.aio.insecure_channel(address, options=_OPTIONS)
    return grpc.aio.secure_channel(address, secure, options=_OPTIONS)


def _secure(address: str, credentials: Credentials) -> grpc.ChannelCredentials | None:
    """Of TLS; None for a plain connection, which stays on this machine and carries no token."""
    if is_local(address) and not (credentials.ca or credentials.certificate):
        return None
    if bool(credentials.certificate) != bool(credentials.key):
        raise CredentialsError("a client certificate and its key go together; one of them is missing")
    tls = grpc.ssl_channel_credentials(
        root_certificates=_pem(credentials.ca),
        private_key=_pem(credentials.key),
        certificate_chain=_pem(credentials.certificate),
    )
    if not credentials.token:
        return tls
    return grpc.composite_channel_credentials(tls, grpc.access_token_call_credentials(credentials.token))


def _pem(path: str | os.PathLike[str] | None) -> bytes | None:
    if not path:
        return None
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise CredentialsError(f"{path} cannot be read: {error.strerror}") from error
    if b"-----BEGIN " not in data:
        raise CredentialsError(f"{path} is not a PEM file: it holds no -----BEGIN … line")
    return data
