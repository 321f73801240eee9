"""RenderService: the handlers; each checks, asks the sessions, answers."""

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable
from pathlib import Path
from typing import TypeAlias, TypeVar

import grpc

from footlight.v1 import render_pb2, render_service_pb2, render_service_pb2_grpc, tile_pb2
from footlight_server.api.errors import told
from footlight_server.api.spec import check_stage, complete_spec
from footlight_server.api.streams import CHUNK_BYTES, ClientGoneError, send
from footlight_server.sessions.encoding import Batch, Encoding
from footlight_server.sessions.errors import FieldViolation, InvalidFieldsError, ResultNotReadyError, TimeLimitError
from footlight_server.sessions.session import Session
from footlight_server.sessions.sessions import Sessions
from footlight_server.sessions.viewer import MAX_RATE, Viewer
from footlight_server.settings import Settings

_DEFAULT_PAGE = 50
_LARGEST_PAGE = 1000
_LONGEST_REQUEST_ID = 128
# [batches] More than this on the way helps nobody.
_MOST_CREDIT = 64
# [s] For the first message of WatchRender; for the file system to answer.
_FIRST_MESSAGE = 30.0
_FILE_PATIENCE = 30.0
# A render is never started anew under the same name, so its tiles are all of one image.
_EPOCH = 1

_ENCODINGS = {
    tile_pb2.TILE_ENCODING_UNSPECIFIED: Encoding.HALF_SHUFFLE_ZSTD,
    tile_pb2.TILE_ENCODING_HALF_SHUFFLE_ZSTD: Encoding.HALF_SHUFFLE_ZSTD,
    tile_pb2.TILE_ENCODING_FLOAT: Encoding.FLOAT,
}

Context: TypeAlias = grpc.aio.ServicerContext
T = TypeVar("T")


class RenderService(render_service_pb2_grpc.RenderServiceServicer):  # type: ignore[misc]
    """Knows gRPC and the sessions, nothing of workers."""

    def __init__(self, sessions: Sessions, settings: Settings) -> None:
        self._sessions = sessions
        self._settings = settings

    @told
    async def CreateRender(
        self, request: render_service_pb2.CreateRenderRequest, context: Context
    ) -> render_service_pb2.CreateRenderResponse:
        """Check and accept."""
        if len(request.request_id) > _LONGEST_REQUEST_ID:
            raise _invalid("request_id", f"longer than {_LONGEST_REQUEST_ID} characters")
        spec = complete_spec(request.spec)
        await _patiently(asyncio.to_thread(check_stage, spec.stage_path, self._settings.roots))
        session = self._sessions.create(spec, request.request_id)
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
        if request.page_token and not request.page_token.isdecimal():
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
            await _send_file(path, request.offset, context)
        except FileNotFoundError:
            raise ResultNotReadyError(f"the result of {session.name} is gone") from None
        except ClientGoneError:
            return

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


async def _patiently(work: Awaitable[T]) -> T:
    """What the file system answers. Raises TimeLimitError if it does not."""
    try:
        async with asyncio.timeout(_FILE_PATIENCE):
            return await work
    except TimeoutError:
        raise TimeLimitError(f"the file system did not answer for {_FILE_PATIENCE:g} s") from None


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


async def _send_file(path: Path, offset: int, context: Context) -> None:
    """The file from `offset` on. Raises FileNotFoundError before anything is sent."""
    file = await _patiently(asyncio.to_thread(path.open, "rb"))
    try:
        total = os.fstat(file.fileno()).st_size
        if offset > total:
            raise _invalid("offset", f"{offset}: the file has {total} bytes")
        await _patiently(asyncio.to_thread(file.seek, offset))
        while data := await _patiently(asyncio.to_thread(file.read, CHUNK_BYTES)):
            await send(context, render_service_pb2.GetResultResponse(total_bytes=total, offset=offset, data=data))
            offset += len(data)
    finally:
        file.close()
