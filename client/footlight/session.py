"""One render on a server: watch it, wait for it, cancel it, fetch its image. Once with threads, once with asyncio."""

import asyncio
import contextlib
import os
import queue
from collections.abc import AsyncIterator, Iterable, Iterator
from pathlib import Path
from typing import Literal

import grpc

from footlight.errors import ProtocolError, RenderCancelledError, RenderFailedError, rpc_errors
from footlight.files import replacing
from footlight.image import TileBatch, decode_batch
from footlight.pieces import Pieces
from footlight.resume import Patience, resumed, resumed_async
from footlight.spec import by_name
from footlight.v1 import render_pb2, render_service_pb2, render_service_pb2_grpc, tile_pb2

Event = render_pb2.Render | render_pb2.Progress | TileBatch
Format = Literal["exr", "png"]

# The .proto names the default; 2 batches keep the server busy while one is being read.
CREDITS = 2

# [s] That a broken stream is tried again: a network may stumble; a server that ended has forgotten its renders.
PATIENCE = 10.0

_ENDED = {
    render_pb2.RENDER_STATE_SUCCEEDED,
    render_pb2.RENDER_STATE_FAILED,
    render_pb2.RENDER_STATE_CANCELLED,
}
_FORMATS = {"exr": render_service_pb2.RESULT_FORMAT_EXR, "png": render_service_pb2.RESULT_FORMAT_PNG}
_GRANT = render_service_pb2.WatchRenderRequest(grant=render_service_pb2.Grant(credits=1))


def has_ended(render: render_pb2.Render) -> bool:
    """The render is in one of the states that end."""
    return render.state in _ENDED


def outcome(render: render_pb2.Render) -> render_pb2.Render:
    """`render` if it succeeded; raises RenderFailedError or RenderCancelledError otherwise."""
    if render.state == render_pb2.RENDER_STATE_FAILED:
        raise RenderFailedError(render.failure)
    if render.state == render_pb2.RENDER_STATE_CANCELLED:
        raise RenderCancelledError(render.name, has_result=render.has_result)
    return render


class Session:
    """A render by name. Made by `Client.submit` and `Client.session`; good until the client is closed.

    Every method raises FootlightError (see footlight.errors): ServerUnavailableError if the server is gone,
    RenderNotFoundError if it has forgotten the render.
    """

    def __init__(self, name: str, channel: grpc.Channel, address: str, timeout: float) -> None:
        self.name = name
        self._stub = render_service_pb2_grpc.RenderServiceStub(channel)
        self._address = address
        self._timeout = timeout

    def get(self) -> render_pb2.Render:
        """The render as it is now."""
        with rpc_errors(self._address):
            request = render_service_pb2.GetRenderRequest(name=self.name)
            response = self._stub.GetRender(request, timeout=self._timeout)
        return _render(response)

    def events(self, aovs: Iterable[str] = ("color",), *, exact: bool = False) -> Iterator[Event]:
        """What happens until the render ends: `Render` at every new state, `Progress`, and `TileBatch`.

        The first event is the render as it is. `aovs` are those to get tiles of, none for no tiles; each has to be
        `color` or one the render was asked for. Tiles are half precision, or float32 if `exact`. A consumer that is
        slow gets fewer, newer tiles. A stream that breaks is opened again, for PATIENCE [s]; then the render and its
        image as they are come again. Ending the iteration early leaves the render running.
        """
        subscribe = _subscribe(self.name, list(aovs), exact=exact)
        requests: queue.SimpleQueue[render_service_pb2.WatchRenderRequest | None] = queue.SimpleQueue()

        def call() -> object:
            nonlocal requests
            requests.put(None)  # lets go of the broken stream's thread
            requests = queue.SimpleQueue()
            requests.put(subscribe)
            return self._stub.WatchRender(iter(requests.get, None))

        try:
            for response in resumed(self._address, Patience(PATIENCE), call):
                event = _event(response)
                yield event
                if isinstance(event, TileBatch):
                    requests.put(_GRANT)
        finally:
            requests.put(None)

    def wait(self) -> render_pb2.Render:
        """The render once it has succeeded, with its statistics.

        Raises RenderFailedError, RenderCancelledError.
        """
        last = None
        for event in self.events(()):
            if isinstance(event, render_pb2.Render):
                last = event
        return _last(self.name, last)

    def cancel(self, *, keep_partial: bool = False) -> render_pb2.Render:
        """Stop the render; with `keep_partial` the image so far can be fetched once it has ended."""
        with rpc_errors(self._address):
            request = _cancel(self.name, keep_partial=keep_partial)
            response = self._stub.CancelRender(request, timeout=self._timeout)
        return _render(response)

    def result(self, image_format: Format = "exr") -> bytes:
        """The image file, float32 EXR or 8-bit PNG. Raises ResultNotReadyError if there is none."""
        return b"".join(self.pieces(image_format))

    def save(self, path: str | os.PathLike[str], image_format: Format = "exr") -> None:
        """Fetch the image file to `path`, which appears whole or not at all. Raises OSError naming it."""
        with replacing(Path(path)) as temporary, temporary.open("wb") as file:
            for piece in self.pieces(image_format):
                file.write(piece)

    def pieces(self, image_format: Format = "exr") -> Iterator[bytes]:
        """The image file in pieces of at most 256 KB, in order. Raises ResultNotReadyError."""
        assemble = Pieces()
        with rpc_errors(self._address):
            for response in self._stub.GetResult(_result(self.name, image_format)):
                yield assemble(response)
        assemble.check()


class AsyncSession:
    """`Session` for asyncio: the same methods, awaited, and the same errors."""

    def __init__(self, name: str, channel: grpc.aio.Channel, address: str, timeout: float) -> None:
        self.name = name
        self._stub = render_service_pb2_grpc.RenderServiceStub(channel)
        self._address = address
        self._timeout = timeout

    async def get(self) -> render_pb2.Render:
        """The render as it is now."""
        with rpc_errors(self._address):
            request = render_service_pb2.GetRenderRequest(name=self.name)
            response = await self._stub.GetRender(request, timeout=self._timeout)
        return _render(response)

    async def events(self, aovs: Iterable[str] = ("color",), *, exact: bool = False) -> AsyncIterator[Event]:
        """As `Session.events`."""
        subscribe = _subscribe(self.name, list(aovs), exact=exact)
        requests: asyncio.Queue[render_service_pb2.WatchRenderRequest | None] = asyncio.Queue()

        def call() -> object:
            nonlocal requests
            requests.put_nowait(None)  # lets go of the broken stream's task
            requests = asyncio.Queue()
            requests.put_nowait(subscribe)
            return self._stub.WatchRender(_until_none(requests))

        try:
            async with contextlib.aclosing(resumed_async(self._address, Patience(PATIENCE), call)) as responses:
                async for response in responses:
                    event = _event(response)
                    yield event
                    if isinstance(event, TileBatch):
                        requests.put_nowait(_GRANT)
        finally:
            requests.put_nowait(None)

    async def wait(self) -> render_pb2.Render:
        """As `Session.wait`."""
        last = None
        async for event in self.events(()):
            if isinstance(event, render_pb2.Render):
                last = event
        return _last(self.name, last)

    async def cancel(self, *, keep_partial: bool = False) -> render_pb2.Render:
        """As `Session.cancel`."""
        with rpc_errors(self._address):
            request = _cancel(self.name, keep_partial=keep_partial)
            response = await self._stub.CancelRender(request, timeout=self._timeout)
        return _render(response)

    async def result(self, image_format: Format = "exr") -> bytes:
        """As `Session.result`."""
        return b"".join([piece async for piece in self.pieces(image_format)])

    async def save(self, path: str | os.PathLike[str], image_format: Format = "exr") -> None:
        """As `Session.save`. Writing blocks the loop for a piece at a time."""
        with replacing(Path(path)) as temporary, temporary.open("wb") as file:
            async for piece in self.pieces(image_format):
                file.write(piece)

    async def pieces(self, image_format: Format = "exr") -> AsyncIterator[bytes]:
        """As `Session.pieces`."""
        assemble = Pieces()
        with rpc_errors(self._address):
            async for response in self._stub.GetResult(_result(self.name, image_format)):
                yield assemble(response)
        assemble.check()


async def _until_none(
    requests: asyncio.Queue[render_service_pb2.WatchRenderRequest | None],
) -> AsyncIterator[render_service_pb2.WatchRenderRequest]:
    while (request := await requests.get()) is not None:
        yield request


def _subscribe(name: str, aovs: Iterable[str], *, exact: bool) -> render_service_pb2.WatchRenderRequest:
    encoding = tile_pb2.TILE_ENCODING_FLOAT if exact else tile_pb2.TILE_ENCODING_HALF_SHUFFLE_ZSTD
    return render_service_pb2.WatchRenderRequest(
        subscribe=render_service_pb2.Subscribe(name=name, aovs=aovs, encoding=encoding, credits=CREDITS)
    )


def _event(response: render_service_pb2.WatchRenderResponse) -> Event:
    match response.WhichOneof("event"):
        case "render":
            return response.render
        case "progress":
            return response.progress
        case "tiles":
            return decode_batch(response.tiles)
        case _:
            raise ProtocolError("the server sent an event this client does not know; update the client")


def _last(name: str, render: render_pb2.Render | None) -> render_pb2.Render:
    if render is None or not has_ended(render):
        raise ProtocolError(f"the events of {name} ended before it did")
    return outcome(render)


def _render(
    response: render_service_pb2.GetRenderResponse | render_service_pb2.CancelRenderResponse,
) -> render_pb2.Render:
    return response.render


def _cancel(name: str, *, keep_partial: bool) -> render_service_pb2.CancelRenderRequest:
    return render_service_pb2.CancelRenderRequest(name=name, keep_partial=keep_partial)


def _result(name: str, image_format: Format) -> render_service_pb2.GetResultRequest:
    return render_service_pb2.GetResultRequest(name=name, format=by_name(_FORMATS, "image_format", image_format))
