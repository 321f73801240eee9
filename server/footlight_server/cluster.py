"""`footlight cluster up|join|status`: the nodes of a Ray cluster on which `footlight serve --executor ray` renders."""

import argparse
import contextlib
import json
import logging
import os
import secrets
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from types import FrameType

from footlight.loopback import is_loopback
from footlight_server.farm.ray.environment import (
    LANE_RESOURCE,
    Access,
    ClusterError,
    TlsFiles,
    access_of,
    check_access,
    ray_environment,
)

DEFAULT_PORT = 6380
# [s] For the head to answer a connection; for a node to start; for it to stop; for the cluster to say what it holds.
_REACHING = 5.0
_STARTING = 60.0
_STOPPING = 15.0
_ASKING = 30.0
# What `ray start` prints once the node is up.
_STARTED = b"Ray runtime started"


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """The command line. Exits with a message if it is wrong."""
    parser = argparse.ArgumentParser(prog="footlight cluster", description="The nodes of a Ray cluster that renders.")
    commands = parser.add_subparsers(dest="command", required=True)
    up = commands.add_parser("up", help="start the first node, and stay until Ctrl-C")
    up.add_argument("--host", default="127.0.0.1", metavar="IP", help="address of this node; not loopback: with TLS")
    up.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"of the cluster (default: {DEFAULT_PORT})")
    join = commands.add_parser("join", help="add this machine to a cluster, and stay until Ctrl-C")
    join.add_argument("address", metavar="HOST:PORT", help="of the first node")
    join.add_argument("--host", default="", metavar="IP", help="address of this node (default: Ray's choice)")
    status = commands.add_parser("status", help="say which nodes there are")
    status.add_argument("address", metavar="HOST:PORT", nargs="?", default=f"127.0.0.1:{DEFAULT_PORT}")
    status.add_argument("--json", action="store_true", help="one JSON object on stdout")
    for command in (up, join):
        command.add_argument("--name", default=socket.gethostname(), help="of this node (default: the host's)")
        command.add_argument("--lanes", type=int, default=1, metavar="N", help="tasks at a time (default: 1)")
    for command in (up, join, status):
        command.add_argument("--token-file", type=Path, metavar="FILE", help="the cluster's token, mode 0600")
        command.add_argument("--tls-cert", type=Path, metavar="FILE", help="this node's certificate, PEM")
        command.add_argument("--tls-key", type=Path, metavar="FILE", help="its key, mode 0600")
        command.add_argument("--tls-ca", type=Path, metavar="FILE", help="the authority of all nodes' certificates")
    return parser.parse_args(arguments)


def up(options: argparse.Namespace) -> int:
    """Start a head node in the foreground. Makes a token if there is none. Raises ClusterError."""
    access = _access(options)
    _check_node(options)
    if not 1024 <= options.port <= 9999:
        raise ClusterError(f"--port {options.port}: allowed are 1024 to 9999; those above are Ray's own")
    made = _make_token(access.token)
    check_access(options.host, access)
    if made:
        _say(f"made a token: {access.token}; every node and the server need the same file, mode 0600")
    head = ("--head", f"--node-ip-address={options.host}", f"--port={options.port}", "--no-monitor")
    # Ray opens its folder to everybody, with the sockets that give it commands; the one around it is closed.
    with tempfile.TemporaryDirectory(prefix="footlight-ray-") as directory:
        arguments = [*head, f"--temp-dir={directory}/ray", "--include-dashboard=false"]
        return _stay(options, access, arguments, f"cluster up at {options.host}:{options.port}")


def join(options: argparse.Namespace) -> int:
    """Add a node in the foreground. Raises ClusterError, soon if nothing answers."""
    access = _access(options)
    _check_node(options)
    host = _reach(options.address)
    if is_loopback(host):
        raise ClusterError(
            f"{options.address}: Ray cannot add nodes to a cluster that listens on loopback only; start it with "
            "`footlight cluster up --host IP` and TLS"
        )
    check_access(host, access)
    arguments = [f"--address={options.address}"]
    if options.host:
        arguments.append(f"--node-ip-address={options.host}")
    return _stay(options, access, arguments, f"joined {options.address}")


@dataclass(frozen=True, slots=True)
class Node:
    """A node of the cluster as `status` shows it."""

    name: str
    address: str
    alive: bool
    lanes: int


def status(options: argparse.Namespace) -> int:
    """Print the nodes. Raises ClusterError if the cluster does not answer."""
    access = _access(options)
    host = _reach(options.address)
    check_access(host, access)
    try:
        answer = subprocess.run(
            [sys.executable, "-P", "-m", "footlight_server.cluster", "nodes", options.address],
            env=ray_environment(access, os.environ),
            capture_output=True,
            text=True,
            timeout=_ASKING,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ClusterError(f"{options.address} did not answer within {_ASKING:g} s") from None
    if answer.returncode != 0:
        said = answer.stderr.strip().splitlines()[-1:] or ["no reason was given"]
        raise ClusterError(f"{options.address} cannot be asked: {said[0]}")
    nodes = [Node(**node) for node in json.loads(answer.stdout)]
    if options.json:
        _say(json.dumps({"nodes": [asdict(node) for node in nodes]}, indent=2))
    else:
        for node in nodes:
            state = f"lanes: {node.lanes}" if node.alive else "gone"
            _say(f"{node.name}  {node.address}  {state}")
    return 0


def _nodes(address: str) -> int:
    """What a child of `status` does: ask Ray. It may take the process down, so it is one of its own."""
    import ray  # noqa: PLC0415 - only here

    ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, configure_logging=False)
    nodes = [
        Node(node["NodeName"], node["NodeManagerAddress"], node["Alive"], int(node["Resources"].get(LANE_RESOURCE, 0)))
        for node in ray.nodes()  # type: ignore[no-untyped-call]
    ]
    _say(json.dumps([asdict(node) for node in sorted(nodes, key=lambda node: (not node.alive, node.name))]))
    return 0


def _say(text: str) -> None:
    print(text, flush=True)  # noqa: T201 - this is a command line


def _stay(options: argparse.Namespace, access: Access, arguments: Sequence[str], done: str) -> int:
    """Run a node until we are told to stop or it ends. Raises ClusterError if it does not come up."""
    node = subprocess.Popen(
        [
            _ray(),
            "start",
            "--block",
            f"--node-name={options.name}",
            f"--resources={json.dumps({LANE_RESOURCE: options.lanes})}",
            "--disable-usage-stats",
            *arguments,
        ],
        env=ray_environment(access, os.environ),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    told = threading.Event()

    def stop(_number: int, _frame: FrameType | None) -> None:
        told.set()
        node.terminate()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    try:
        said = _wait_until_started(node)
        _say(f"{done}; lanes: {options.lanes}; Ctrl-C stops this node")
        for line in node.stdout or ():
            said = (said + line)[-4000:]
        if told.is_set():
            return 0
        raise ClusterError(f"the node has ended: {_last_lines(said)}")
    finally:
        _stop(node)


def _wait_until_started(node: subprocess.Popen[bytes]) -> bytes:
    """What it said up to the line that says so. Raises ClusterError."""
    assert node.stdout is not None
    said, deadline = b"", time.monotonic() + _STARTING
    while _STARTED not in said:
        left = deadline - time.monotonic()
        if left <= 0 or not select.select([node.stdout], [], [], left)[0]:
            raise ClusterError(f"the node was not up within {_STARTING:g} s: {_last_lines(said)}")
        data = os.read(node.stdout.fileno(), 65536)
        if not data:
            raise ClusterError(f"the node could not start: {_last_lines(said)}")
        said += data
    return said


def _stop(node: subprocess.Popen[bytes]) -> None:
    """End the node's processes, all of which are in its session."""
    if node.poll() is None:
        node.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            node.wait(_STOPPING)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(node.pid, signal.SIGKILL)
    node.wait()


def _last_lines(said: bytes) -> str:
    return " | ".join(said.decode(errors="replace").strip().splitlines()[-5:]) or "it said nothing"


def _reach(address: str) -> str:
    """The host of HOST:PORT, once something listens there: Ray itself would try for minutes. Raises ClusterError."""
    host, colon, port = address.rpartition(":")
    if not (colon and host and port.isdecimal() and 0 < int(port) < 65536):
        raise ClusterError(f"{address!r} is no address; write HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _REACHING).close()
    except OSError as error:
        raise ClusterError(f"nothing answers at {address}: {error.strerror or error}") from None
    return host.strip("[]")


def _check_node(options: argparse.Namespace) -> None:
    if not 1 <= options.lanes <= 256:
        raise ClusterError(f"--lanes {options.lanes}: allowed are 1 to 256")


def _make_token(path: Path) -> bool:
    """A new token, readable by nobody else, unless there is one."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return False
    with os.fdopen(descriptor, "w") as file:
        file.write(secrets.token_hex(32))
    return True


def _access(options: argparse.Namespace) -> Access:
    given = (options.tls_cert, options.tls_key, options.tls_ca)
    if any(given) and not all(given):
        raise ClusterError("--tls-cert, --tls-key and --tls-ca belong together")
    return access_of(os.environ, options.token_file, TlsFiles(*given) if all(given) else None)


def _ray() -> str:
    """The `ray` command of this Python. Raises ClusterError."""
    command = shutil.which("ray", path=str(Path(sys.executable).parent))
    if find_spec("ray") is None or command is None:
        raise ClusterError("Ray is not installed in this Python: pip install 'footlight-server[ray]'")
    return command


_COMMANDS = {"up": up, "join": join, "status": status}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; leaves the process with status 2 and a message if it cannot be."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given[:1] == ["nodes"]:
        sys.exit(_nodes(given[1]))
    options = parse_arguments(given)
    os.umask(0o077)
    try:
        code = _COMMANDS[options.command](options)
    except (ClusterError, OSError) as error:
        sys.stderr.write(f"footlight cluster: {error}\n")
        sys.exit(2)
    sys.exit(code)


if __name__ == "__main__":
    main()
