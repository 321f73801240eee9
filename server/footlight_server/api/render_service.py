"""RenderService: the handlers; each checks, asks the sessions, answers."""

import asyncio
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias
from weakref import WeakKeyDictionary

import grpc

from footlight.v1 import render_pb2, render_service_pb2, render_service_pb2_grpc, tile_pb2
from footlight_server.api.auth import caller
from footlight_server.api.errors import told
from footlight_server.api.owner import check_owner
from footlight_server.api.spec import complete_spec
from footlight_server.api.stage_files import stage_files
from footlight_server.api.streams import ClientGoneError, send, send_file
from footlight_server.sessions.encoding import Batch, Encoding
from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError, QuotaError, ResultNotReadyError
from footlight_server.sessions.session import Session
from footlight_server.sessions.sessions import Sessions
from footlight_server.sessions.viewer import MAX_RATE, Viewer
from footlight_server.settings import Settings

if TYPE_CHECKING:
    from footlight_server.blobs.bundle import BundleStore

_DEFAULT_PAGE = 50
_LARGEST_PAGE = 1000
_LONGEST_REQUEST_ID = 128
# [batches] More than this on the way helps nobody.
_MOST_CREDIT = 64
# [s] For the first message of WatchRender.
_FIRST_MESSAGE = 30.0
_NUMBER = re.compile(r"[0-9]{1,18}", re.ASCII)
# A render is never started anew under the same name, so its tiles are all of one image.
_EPOCH = 1

_ENCODINGS = {
    tile_pb2.TILE_ENCODING_UNSPECIFIED: Encoding.HALF_SHUFFLE_ZSTD,
    tile_pb2.TILE_ENCODING_HALF_SHUFFLE_ZSTD: Encoding.HALF_SHUFFLE_ZSTD,
    tile_pb2.TILE_ENCODING_FLOAT: Encoding.FLOAT,
}

Context: TypeAlias = grpc.aio.ServicerContext


class RenderService(render_service_pb2_grpc.RenderServiceServicer):  # type: ignore[misc]
    """Knows gRPC and the sessions, nothing of workers. `bundles`: None where nothing can be uploaded."""

    def __init__(self, sessions: Sessions, settings: Settings, bundles: "BundleStore | None" = None) -> None:
        self._sessions = sessions
        self._settings = settings
        self._bundles = bundles
        # Whose they are, for as long as they are remembered.
        self._owners: WeakKeyDictionary[Session, str] = WeakKeyDictionary()

    @told
    async def CreateRender(
        self, request: render_service_pb2.CreateRenderRequest, context: Context
    ) -> render_service_pb2.CreateRenderResponse:
        """Check and accept."""
        if len(request.request_id) > _LONGEST_REQUEST_ID:
            raise _invalid("request_id", f"longer than {_LONGEST_REQUEST_ID} characters")
        spec = complete_spec(request.spec)
        files = await stage_files(spec, self._settings, self._bundles)
        user = caller(context).user
        # Two users may hit on the same request_id, and neither shall get the other's render.
        request_id = f"{request.request_id} of {user}" if request.request_id else ""
        if not self._sessions.knows(request_id):
            self._check_quota(user)
        session = self._sessions.create(spec, request_id, files)
        self._owners.setdefault(session, user)
        return render_service_pb2.CreateRenderResponse(render=session.render)

    @told
    async def GetRender(
        self, request: render_service_pb2.GetRenderRequest, context: Context
    ) -> render_service_pb2.GetRenderResponse:
        """As it is now."""
        return render_service_pb2.GetRenderResponse(render=self._sessions.get(request.name).render)

    @told
    async def ListRenders(
        self, request: render_service_pb2.ListRendersRequest, context: Context
    ) -> render_service_pb2.ListRendersResponse:
        """A page of them."""
        if request.page_token and not _NUMBER.fullmatch(request.page_token):
            raise _invalid("page_token", "not a token of this server")
        if request.page_size > _LARGEST_PAGE:
            raise _invalid("page_size", f"{request.page_size}: at most {_LARGEST_PAGE} are allowed")
        newest = int(request.page_token) if request.page_token else None
        page = self._sessions.page(request.page_size or _DEFAULT_PAGE, newest)
        return render_service_pb2.ListRendersResponse(renders=page.renders, next_page_token=page.next_token)

    @told
    async def CancelRender(
        self, request: render_service_pb2.CancelRenderRequest, context: Context
    ) -> render_service_pb2.CancelRenderResponse:
        """Have it end."""
        known = self._sessions.get(request.name)
        check_owner(caller(context), self._owners.get(known, ""), request.name)
        session = self._sessions.cancel(request.name, keep=request.keep_partial)
        return render_service_pb2.CancelRenderResponse(render=session.render)

    @told
    async def WatchRender(
        self, requests: AsyncIterator[render_service_pb2.WatchRenderRequest], context: Context
    ) -> None:
        """Events and tiles until the render ends."""
        session, subscribe = await self._subscription(requests)
        rate = min(subscribe.max_rate or MAX_RATE, MAX_RATE)
        credit = min(subscribe.credits, _MOST_CREDIT)
        with session.viewing(subscribe.aovs, _ENCODINGS[subscribe.encoding], credit, rate) as viewer:
            grants = asyncio.create_task(_take_grants(requests, viewer))
            try:
                await _serve(viewer, context)
            except ClientGoneError:
                return
            finally:
                grants.cancel()

    @told
    async def GetResult(self, request: render_service_pb2.GetResultRequest, context: Context) -> None:
        """The image file in pieces."""
        session = self._sessions.get(request.name)
        path = _result_path(session, request.format)
        try:
            await send_file(context, path, request.offset, _result_piece)
        except FileNotFoundError:
            raise ResultNotReadyError(f"the result of {session.name} is gone") from None
        except ClientGoneError:
            return

    def _check_quota(self, user: str) -> None:
        """Renders count as jobs of a frame do. Raises QuotaError."""
        most = self._settings.quota.jobs
        if most and sum(owner == user and not session.ended for session, owner in self._owners.items()) >= most:
            raise QuotaError(f"{user} has {most} renders that have not ended; that is the most")

    async def _subscription(
        self, requests: AsyncIterator[render_service_pb2.WatchRenderRequest]
    ) -> tuple[Session, render_service_pb2.Subscribe]:
        """What the first message asks for."""
        try:
            async with asyncio.timeout(_FIRST_MESSAGE):
                first = await anext(requests, None)
        except TimeoutError:
            first = None
        if first is None or not first.HasField("subscribe"):
            raise _invalid("subscribe", "has to come first")
        subscribe = first.subscribe
        session = self._sessions.get(subscribe.name)
        if subscribe.encoding not in _ENCODINGS:
            raise _invalid("subscribe.encoding", f"{subscribe.encoding}: not a TileEncoding of this server")
        there = ["color", "alpha", *session.render.spec.aovs]
        for aov in subscribe.aovs:
            if aov not in there:
                raise _invalid("subscribe.aovs", f"{aov!r}: this render has {', '.join(dict.fromkeys(there))}")
        return session, subscribe


def _invalid(field: str, description: str) -> InvalidFieldsError:
    return InvalidFieldsError([FieldViolation(field, description)])


async def _take_grants(requests: AsyncIterator[render_service_pb2.WatchRenderRequest], viewer: Viewer) -> None:
    """More credit, until the client closes its half of the stream. Cancelled when the render has ended."""
    async for request in requests:
        viewer.grant(min(request.grant.credits, _MOST_CREDIT))


async def _serve(viewer: Viewer, context: Context) -> None:
    """Send what the viewer is owed until the render has ended."""
    sequence = 0
    while (item := await viewer.next()) is not None:
        if isinstance(item, render_pb2.Render):
            response = render_service_pb2.WatchRenderResponse(render=item)
        elif isinstance(item, render_pb2.Progress):
            response = render_service_pb2.WatchRenderResponse(progress=item)
        else:
            sequence += 1
            response = render_service_pb2.WatchRenderResponse(tiles=_batch(item, sequence))
        await send(context, response)


def _batch(tiles: Batch, sequence: int) -> tile_pb2.TileBatch:
    batch = tile_pb2.TileBatch(
        epoch=_EPOCH, sequence=sequence, image_width=tiles.image_width, image_height=tiles.image_height
    )
    for tile in tiles.tiles:
        batch.tiles.add(
            aov=tile.aov,
            x=tile.x,
            y=tile.y,
            width=tile.width,
            height=tile.height,
            channels=tile.channels,
            samples=tile.version.samples,
            scale=tile.version.scale,
            encoding=tile_pb2.TileEncoding.Value(f"TILE_ENCODING_{tile.encoding.name}"),
            data=tile.data,
        )
    return batch


def _result_piece(total: int, offset: int, data: bytes) -> render_service_pb2.GetResultResponse:
    return render_service_pb2.GetResultResponse(total_bytes=total, offset=offset, data=data)


def _result_path(session: Session, wanted: render_service_pb2.ResultFormat) -> Path:
    render = session.render
    if not render.has_result:
        state = render_pb2.RenderState.Name(render.state).removeprefix("RENDER_STATE_")
        raise ResultNotReadyError(f"{session.name} has no image; its state is {state}")
    if wanted == render_service_pb2.RESULT_FORMAT_PNG:
        if not render.spec.HasField("png"):
            raise ResultNotReadyError(f"{session.name} was asked for without a PNG")
        return session.png_path
    return session.exr_path
