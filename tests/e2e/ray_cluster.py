"""A Ray cluster of three nodes on this machine, over TLS with a token, started by `footlight cluster`."""

import contextlib
import datetime as dt
import ipaddress
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

FOOTLIGHT = Path(sys.executable).with_name("footlight")


@dataclass(frozen=True, slots=True)
class Cluster:
    """Three nodes; `options` are what a command needs to be let in."""

    address: str
    options: tuple[str, ...]
    nodes: dict[str, subprocess.Popen[str]]

    def status(self) -> list[dict[str, object]]:
        """As `footlight cluster status --json` tells it."""
        command = [str(FOOTLIGHT), "cluster", "status", self.address, "--json", *self.options]
        answer = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        nodes: list[dict[str, object]] = json.loads(answer.stdout)["nodes"]
        return nodes


def own_address() -> str:
    """An address of this machine that is not loopback; empty if it has none. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect(("192.0.2.1", 9))
        address: str = probe.getsockname()[0]
        return "" if address.startswith("127.") else address
    return ""


def free_port() -> int:
    """A port that is free now, among those a cluster may have."""
    for port in range(6400, 6500):
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("", port))
            return port
    raise AssertionError("no port between 6400 and 6500 is free")


@contextlib.contextmanager
def three_nodes(folder: Path) -> Iterator[Cluster]:
    """Nodes n1 (the head), n2 and n3, each with one lane."""
    host = own_address()
    address = f"{host}:{free_port()}"
    tls = _certificates(folder, host)
    options = ("--token-file", str(folder / "token"), *tls)
    with contextlib.ExitStack() as stack:
        nodes = {}
        head = ("up", "--host", host, "--port", address.rpartition(":")[2])
        for name, command in (("n1", head), ("n2", ("join", address)), ("n3", ("join", address))):
            nodes[name] = stack.enter_context(_node(name, *command, *options))
        yield Cluster(address, options, nodes)


@contextlib.contextmanager
def _node(name: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [FOOTLIGHT, "cluster", *arguments, "--name", name, "--lanes", "1"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        said = ""
        while "Ctrl-C stops this node" not in said:
            assert select.select([process.stdout], [], [], 90)[0], f"{name} did not start: {said}"
            line = process.stdout.readline()
            assert line, f"{name} did not start: {said}"
            said += line
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def kill_node(process: subprocess.Popen[str]) -> None:
    """SIGKILL to everything a node consists of, as if its power had gone."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="ascii").split()
    process.kill()
    for child in children:  # `ray start`, whose session holds all that is Ray's
        os.killpg(int(child), signal.SIGKILL)


def lane_actors() -> list[int]:
    """Ids of the Ray workers that hold a lane."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if entry.name.isdecimal() and (entry / "cmdline").read_bytes().startswith(b"ray::LaneActor"):
                found.append(int(entry.name))
    return found


def _certificates(folder: Path, host: str) -> tuple[str, ...]:
    """An authority and one certificate for all nodes, as options."""
    authority_key, key = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
    authority_name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "test authority")])
    node_name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "node")])
    names = x509.SubjectAlternativeName(
        [x509.DNSName("localhost"), *(x509.IPAddress(ipaddress.ip_address(ip)) for ip in ("127.0.0.1", host))]
    )
    now = dt.datetime.now(dt.UTC)

    def sign(subject: x509.Name, public: ec.EllipticCurvePublicKey, *, authority: bool) -> x509.Certificate:
        builder = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(authority_name)
            .public_key(public)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - dt.timedelta(hours=1))
            .not_valid_after(now + dt.timedelta(hours=1))
            .add_extension(x509.BasicConstraints(ca=authority, path_length=None), critical=True)
        )
        if not authority:
            builder = builder.add_extension(names, critical=False)
        return builder.sign(authority_key, hashes.SHA256())

    pem = serialization.Encoding.PEM
    (folder / "ca.pem").write_bytes(sign(authority_name, authority_key.public_key(), authority=True).public_bytes(pem))
    (folder / "node.pem").write_bytes(sign(node_name, key.public_key(), authority=False).public_bytes(pem))
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    (folder / "node.key").touch(0o600)
    (folder / "node.key").write_bytes(private)
    return (
        "--tls-cert",
        str(folder / "node.pem"),
        "--tls-key",
        str(folder / "node.key"),
        "--tls-ca",
        str(folder / "ca.pem"),
    )
