"""Which hosts are this machine and nothing else: the one rule by which client, server and cluster do without TLS."""

import ipaddress


def is_loopback(host: str) -> bool:
    """`host`, without brackets, is `localhost` or a loopback address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
