"""TLS for addresses beyond this machine: certificate, key, and the CA of clients if they need one."""

import logging
import ssl
import stat
from dataclasses import dataclass
from pathlib import Path

import grpc

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Tls:
    """PEM files. `client_ca`: clients have to show a certificate that it signed; None: they need none."""

    certificate: Path
    key: Path
    client_ca: Path | None = None


def check_tls(certificate: Path | None, key: Path | None, client_ca: Path | None) -> Tls | None:
    """The files, which belong together; None if there are none. Raises ValueError naming the option at fault.

    Checked here, because gRPC takes anything and then fails each handshake without a word.
    """
    if certificate is None and key is None and client_ca is None:
        return None
    if certificate is None or key is None:
        raise ValueError("--tls-cert and --tls-key: give both, or neither")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    for option, path in (("--tls-cert", certificate), ("--tls-key", key), ("--tls-client-ca", client_ca)):
        if path is not None and not path.is_file():
            raise ValueError(f"{option} {path}: not a file")
    try:
        # Without a password here, an encrypted key would have OpenSSL ask on the terminal.
        context.load_cert_chain(certificate, key, password="")
    except (OSError, ssl.SSLError) as error:
        raise ValueError(f"--tls-cert {certificate} and --tls-key {key}: {_reason(error)}") from None
    if client_ca is not None:
        try:
            context.load_verify_locations(client_ca)
        except (OSError, ssl.SSLError) as error:
            raise ValueError(f"--tls-client-ca {client_ca}: {_reason(error)}") from None
    if key.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH):
        log.warning("--tls-key %s: other users of this machine can read it; chmod 600 it", key)
    return Tls(certificate, key, client_ca)


def server_credentials(tls: Tls) -> grpc.ServerCredentials:
    """What a port is opened with. Raises OSError if a file cannot be read any more. Blocks."""
    return grpc.ssl_server_credentials(
        [(tls.key.read_bytes(), tls.certificate.read_bytes())],
        root_certificates=tls.client_ca.read_bytes() if tls.client_ca is not None else None,
        require_client_auth=tls.client_ca is not None,
    )


def _reason(error: Exception) -> str:
    """OpenSSL's words without its brackets, or the system's."""
    if isinstance(error, ssl.SSLError):
        reason = (error.reason or "").replace("_", " ").lower()
        return reason or "neither file is PEM"
    return str(error.strerror if isinstance(error, OSError) and error.strerror else error)
