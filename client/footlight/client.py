"""The connection to a server: submit, find again, explain. Once with threads, once with asyncio."""

import os
import uuid
from types import TracebackType
from typing import Self

from footlight.channel import Credentials, open_async_channel, open_channel
from footlight.errors import rpc_errors
from footlight.farm import AsyncFarm, Farm
from footlight.session import AsyncSession, Session
from footlight.tokens import AsyncTokens, Tokens
from footlight.upload.blobs import untold, upload_stage, upload_stage_async
from footlight.upload.bundle import BundleRef
from footlight.upload.steps import Told
from footlight.v1 import (
    render_pb2,
    render_service_pb2,
    render_service_pb2_grpc,
    stage_service_pb2,
    stage_service_pb2_grpc,
)

# [s] For calls that answer at once, and for explaining, which opens the stage.
TIMEOUT = 10.0
EXPLAIN_TIMEOUT = 600.0


class Client:
    """A connection to the server at `address`: `host:port` or `unix:/path/to/socket`.

    Beyond this machine, or with `ca`, it is TLS: `ca` is a PEM file with the certificates to trust, `token` says who
    one is, over TLS only, `certificate` and `key` are PEM files for servers that ask for them. `farm` is the
    server's queue of jobs, `tokens` are its tokens; the methods here are about single renders.

    Nothing is sent before the first call. Usable from several threads; close it, or use it in a `with`. `timeout` [s]
    is for calls that answer at once. Every method raises FootlightError, ServerUnavailableError if no server answers.
    """

    def __init__(
        self,
        address: str,
        *,
        token: str = "",
        ca: str | os.PathLike[str] | None = None,
        certificate: str | os.PathLike[str] | None = None,
        key: str | os.PathLike[str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        self.address = address
        self._timeout = timeout
        self._channel = open_channel(address, Credentials(token, ca, certificate, key))
        self.farm = Farm(self._channel, address, timeout)
        self.tokens = Tokens(self._channel, address, timeout)
        self._renders = render_service_pb2_grpc.RenderServiceStub(self._channel)
        self._stages = stage_service_pb2_grpc.StageServiceStub(self._channel)

    def submit(self, spec: render_pb2.RenderSpec) -> Session:
        """Put a render into the server's queue; `render_spec` makes the spec.

        Raises InvalidRequestError naming each option at fault, StageNotFoundError, OutsideRootsError, QueueFullError.
        """
        with rpc_errors(self.address):
            response = self._renders.CreateRender(_create(spec), timeout=self._timeout)
        return self.session(response.render.name)

    def session(self, name: str) -> Session:
        """The render `name` (`renders/{id}`), submitted here or elsewhere."""
        return Session(name, self._channel, self.address, self._timeout)

    def renders(self, count: int = 50) -> list[render_pb2.Render]:
        """At most `count` (up to 1000) renders that the server remembers, newest first."""
        with rpc_errors(self.address):
            request = render_service_pb2.ListRendersRequest(page_size=count)
            return list(self._renders.ListRenders(request, timeout=self._timeout).renders)

    def explain(
        self, spec: render_pb2.RenderSpec, *, timeout: float = EXPLAIN_TIMEOUT
    ) -> stage_service_pb2.ExplainStageResponse:
        """What a render of `spec` would consist of, without rendering. `timeout` [s].

        Raises StageNotFoundError, StageRefusedError, OutsideRootsError, DeadlineError.
        """
        with rpc_errors(self.address):
            request = stage_service_pb2.ExplainStageRequest(spec=spec)
            response: stage_service_pb2.ExplainStageResponse = self._stages.ExplainStage(request, timeout=timeout)
        return response

    def upload(self, stage: str | os.PathLike[str], told: Told = untold) -> BundleRef:
        """Send a stage of this machine with all it refers to, as far as the server does not have it; needs pxr here.

        What is sent never changes. `told(done, total)` hears how many bytes the server has. Raises CollectError (see
        footlight.upload.collect), QuotaError.
        """
        return upload_stage(self._channel, self.address, stage, told)

    def close(self) -> None:
        """Let the connection go; renders on the server go on."""
        self._channel.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class AsyncClient:
    """`Client` for asyncio: the same methods, awaited. To be made inside the running loop."""

    def __init__(
        self,
        address: str,
        *,
        token: str = "",
        ca: str | os.PathLike[str] | None = None,
        certificate: str | os.PathLike[str] | None = None,
        key: str | os.PathLike[str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        self.address = address
        self._timeout = timeout
        self._channel = open_async_channel(address, Credentials(token, ca, certificate, key))
        self.farm = AsyncFarm(self._channel, address, timeout)
        self.tokens = AsyncTokens(self._channel, address, timeout)
        self._renders = render_service_pb2_grpc.RenderServiceStub(self._channel)
        self._stages = stage_service_pb2_grpc.StageServiceStub(self._channel)

    async def submit(self, spec: render_pb2.RenderSpec) -> AsyncSession:
        """As `Client.submit`."""
        with rpc_errors(self.address):
            response = await self._renders.CreateRender(_create(spec), timeout=self._timeout)
        return self.session(response.render.name)

    def session(self, name: str) -> AsyncSession:
        """As `Client.session`."""
        return AsyncSession(name, self._channel, self.address, self._timeout)

    async def renders(self, count: int = 50) -> list[render_pb2.Render]:
        """As `Client.renders`."""
        with rpc_errors(self.address):
            request = render_service_pb2.ListRendersRequest(page_size=count)
            return list((await self._renders.ListRenders(request, timeout=self._timeout)).renders)

    async def explain(
        self,
        spec: render_pb2.RenderSpec,
        *,
        timeout: float = EXPLAIN_TIMEOUT,  # noqa: ASYNC109 gRPC has its own
    ) -> stage_service_pb2.ExplainStageResponse:
        """As `Client.explain`."""
        with rpc_errors(self.address):
            request = stage_service_pb2.ExplainStageRequest(spec=spec)
            response: stage_service_pb2.ExplainStageResponse = await self._stages.ExplainStage(request, timeout=timeout)
        return response

    async def upload(self, stage: str | os.PathLike[str], told: Told = untold) -> BundleRef:
        """As `Client.upload`."""
        return await upload_stage_async(self._channel, self.address, stage, told)

    async def close(self) -> None:
        """As `Client.close`."""
        await self._channel.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()


def _create(spec: render_pb2.RenderSpec) -> render_service_pb2.CreateRenderRequest:
    return render_service_pb2.CreateRenderRequest(spec=spec, request_id=str(uuid.uuid4()))
