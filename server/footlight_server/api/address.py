"""Where the server may listen: loopback and unix sockets; anything else would need TLS."""

import ipaddress


class AddressError(ValueError):
    """The address is none, or none that may be listened on."""


def check_address(address: str) -> str:
    """The address in gRPC's spelling, `HOST:PORT` or `unix:PATH`. Port 0: any that is free. Raises AddressError."""
    if address.startswith("unix:"):
        if not address.removeprefix("unix:"):
            raise AddressError("a unix address needs a path: unix:PATH")
        return address
    host, colon, port = address.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65535:
        raise AddressError(f"{address!r} is no address; write HOST:PORT or unix:PATH")
    if not _is_loopback(host.strip("[]")):
        raise AddressError(
            f"{address!r} is not a loopback address. Whoever reaches the server can read files with its rights, "
            "so it listens on 127.0.0.1, [::1] and unix sockets only, until it speaks TLS"
        )
    return address


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
