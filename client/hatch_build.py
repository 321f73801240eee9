"""Generates the protobuf and gRPC code of the client from ../proto, for wheels, editable installs and `make proto`."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CLIENT = Path(__file__).parent
PROTO = CLIENT.parent / "proto"


def generate() -> None:
    """Write *_pb2.py, *_pb2.pyi and *_pb2_grpc.py next to the packages they belong to; raises if protoc does."""
    sources = sorted(str(path.relative_to(PROTO)) for path in PROTO.rglob("*.proto"))
    outputs = [f"--{kind}_out={CLIENT}" for kind in ("python", "pyi", "grpc_python")]
    subprocess.run([sys.executable, "-m", "grpc_tools.protoc", f"--proto_path={PROTO}", *outputs, *sources], check=True)


class ProtoHook(BuildHookInterface):  # type: ignore[type-arg]
    """The build hook that hatchling runs before it packs a wheel or an editable install."""

    PLUGIN_NAME = "proto"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
        """Generate the code."""
        generate()


if __name__ == "__main__":
    generate()
