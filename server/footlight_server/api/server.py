"""The gRPC server: its options, its services, its end."""

import grpc
from grpc_health.v1 import health, health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

from footlight.v1 import (
    render_service_pb2,
    render_service_pb2_grpc,
    stage_service_pb2,
    stage_service_pb2_grpc,
)
from footlight_server.api.render_service import RenderService
from footlight_server.api.stage_service import StageService
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings

_RENDER = render_service_pb2.DESCRIPTOR.services_by_name["RenderService"].full_name
_STAGE = stage_service_pb2.DESCRIPTOR.services_by_name["StageService"].full_name

_OPTIONS = (
    # A second server on the same port would take half of the calls.
    ("grpc.so_reuseport", 0),
    # Clients ping every 30 s; the default of 5 min would cut them off.
    ("grpc.http2.min_recv_ping_interval_without_data_ms", 15_000),
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.keepalive_permit_without_calls", 1),
    # Specs are small; what is larger is no spec.
    ("grpc.max_receive_message_length", 1 << 20),
)
_MOST_CALLS = 1000


class GrpcServer:
    """Listens from `start` to `stop`."""

    def __init__(self, sessions: Sessions, settings: Settings) -> None:
        self._server = grpc.aio.server(options=_OPTIONS, maximum_concurrent_rpcs=_MOST_CALLS)
        self._health = health.aio.HealthServicer()
        render_service_pb2_grpc.add_RenderServiceServicer_to_server(RenderService(sessions, settings), self._server)
        stage_service_pb2_grpc.add_StageServiceServicer_to_server(StageService(sessions, settings), self._server)
        health_pb2_grpc.add_HealthServicer_to_server(self._health, self._server)
        names = (_RENDER, _STAGE, health.SERVICE_NAME, reflection.SERVICE_NAME)
        reflection.enable_server_reflection(names, self._server)

    async def start(self, address: str) -> str:
        """Listen; the address with the port that was chosen. Raises RuntimeError if it cannot be listened on."""
        port = self._server.add_insecure_port(address)
        await self._server.start()
        for name in ("", _RENDER, _STAGE):
            await self._health.set(name, health_pb2.HealthCheckResponse.SERVING)
        if address.startswith("unix:"):
            return address
        return f"{address.rpartition(':')[0]}:{port}"

    async def drain(self) -> None:
        """Say NOT_SERVING to whoever asks."""
        await self._health.enter_graceful_shutdown()

    async def stop(self, grace: float) -> None:
        """Take no more calls; cut off after `grace` [s] those that are not done."""
        await self._server.stop(grace)
