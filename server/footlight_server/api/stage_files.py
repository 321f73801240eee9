"""Where the stage of a render is: a file on the server's machine, or one of an uploaded bundle."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from footlight.v1 import render_pb2
from footlight_server.api.spec import check_stage
from footlight_server.api.streams import patiently
from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError
from footlight_server.settings import Settings

if TYPE_CHECKING:
    from footlight_server.blobs.bundle import BundleStore


async def stage_files(spec: render_pb2.RenderSpec, settings: Settings, bundles: "BundleStore | None") -> Path | None:
    """The directory of the spec's bundle, laid out; None if it names none and the stage is where it says.

    Raises what is wrong with either: OutsideRootsError, StageNotFoundError, BlobsMissingError, InvalidFieldsError.
    """
    if not spec.bundle:
        await patiently(asyncio.to_thread(check_stage, spec.stage_path, settings.roots))
        return None
    if bundles is None:
        raise InvalidFieldsError([FieldViolation("spec.bundle", "this server takes no uploads")])
    await bundles.keep(spec.bundle, spec.stage_path)
    return await bundles.materialise(spec.bundle)
