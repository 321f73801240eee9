"""Where the server may listen: loopback and unix sockets as they are, anything else with TLS."""

from footlight.loopback import is_loopback


class AddressError(ValueError):
    """The address is none, or none that may be listened on."""


def check_address(address: str, *, tls: bool = False) -> str:
    """The address in gRPC's spelling, `HOST:PORT` or `unix:PATH`. Port 0: any that is free. Raises AddressError.

    `tls`: the server has a certificate, so that it may be reached from elsewhere.
    """
    if address.startswith("unix:"):
        if not address.removeprefix("unix:"):
            raise AddressError("a unix address needs a path: unix:PATH")
        return address
    host, _ = split_address(address)
    if not (tls or is_loopback(host)):
        raise AddressError(
            f"{address!r} is not a loopback address. Whoever reaches the server can read files with its rights, "
            "so without TLS (--tls-cert and --tls-key) it listens on 127.0.0.1, [::1] and unix sockets only"
        )
    return address


def is_local(address: str) -> bool:
    """Only this machine reaches the address: it is a unix socket, or on loopback. It needs no TLS and no token."""
    return address.startswith("unix:") or is_loopback(split_address(address)[0])


def split_address(address: str) -> tuple[str, int]:
    """Host, without brackets, and port of `HOST:PORT`. Raises AddressError."""
    host, colon, port = address.rpartition(":")
    if not (colon and host and port.isascii() and port.isdecimal() and int(port) <= 65535):
        raise AddressError(f"{address!r} is no address; write HOST:PORT or unix:PATH")
    return host.strip("[]"), int(port)
