"""Where the server finds a stage: at its path there, or among what is uploaded."""

from pathlib import Path

from footlight.cli.progress import transfer_view
from footlight.cli.report import FIRST, note
from footlight.client import Client
from footlight.paths import PathMap
from footlight.v1 import render_pb2


def place(client: Client, spec: render_pb2.RenderSpec, stage: Path, paths: PathMap, *, upload: bool) -> None:
    """Put into the spec how the server finds `stage`, after sending it if it is to be uploaded."""
    if not upload:
        spec.stage_path = paths.to_server(stage)
        return
    with transfer_view("uploading") as told:
        bundle = client.upload(stage, told)
    bundle.into(spec)
    note(f"uploaded as {bundle.digest}")
    for reference in bundle.unresolved[:FIRST]:
        note(f"remark: {reference}: referred to, but not there")
    if (more := len(bundle.unresolved) - FIRST) > 0:
        note(f"… and {more} more that are not there")
