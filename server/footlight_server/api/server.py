"""The gRPC server: its options, its services, its end."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import grpc
from grpc_health.v1 import health, health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

_OPTIONS = (
    # A second server on the same port would take half of the calls.
    ("grpc.so_reuseport", 0),
    # Clients ping every 30 s; the default of 5 min would cut them off.
    ("grpc.http2.min_recv_ping_interval_without_data_ms", 15_000),
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.keepalive_permit_without_calls", 1),
    # Strangers may connect and say nothing: for the default of 120 s until TLS is agreed on, for ever afterwards.
    ("grpc.server_handshake_timeout_ms", 10_000),
    ("grpc.max_connection_idle_ms", 600_000),
    # Specs are small, and uploads come in pieces; what is larger is neither.
    ("grpc.max_receive_message_length", 1 << 20),
)
_MOST_CALLS = 1000


@dataclass(frozen=True, slots=True)
class Service:
    """The handlers of one service, its full name, and the generated function that adds them to a server."""

    name: str
    handlers: object
    add: Callable[[object, grpc.aio.Server], None]


class Health:
    """What whoever asks is told, at all addresses."""

    def __init__(self, services: Sequence[Service]) -> None:
        self.handlers = health.aio.HealthServicer()
        self._names = ("", *(service.name for service in services))

    async def serving(self) -> None:
        """All services are there."""
        for name in self._names:
            await self.handlers.set(name, health_pb2.HealthCheckResponse.SERVING)

    async def draining(self) -> None:
        """NOT_SERVING from now on."""
        await self.handlers.enter_graceful_shutdown()


class GrpcServer:
    """Listens at one address from `start` to `stop`. `gates`: what calls pass through, the outermost first."""

    def __init__(
        self, services: Sequence[Service], health_service: Health, gates: Sequence[grpc.aio.ServerInterceptor]
    ) -> None:
        self._server = grpc.aio.server(options=_OPTIONS, maximum_concurrent_rpcs=_MOST_CALLS, interceptors=gates)
        for service in services:
            service.add(service.handlers, self._server)
        health_pb2_grpc.add_HealthServicer_to_server(health_service.handlers, self._server)
        names = (*(service.name for service in services), health.SERVICE_NAME, reflection.SERVICE_NAME)
        reflection.enable_server_reflection(names, self._server)

    async def start(self, address: str, credentials: grpc.ServerCredentials | None = None) -> str:
        """Listen, with TLS if there are credentials; the address with the port that was chosen.

        Raises RuntimeError if it cannot be listened on.
        """
        try:
            if credentials is None:
                port = self._server.add_insecure_port(address)
            else:
                port = self._server.add_secure_port(address, credentials)
        except RuntimeError as error:
            raise RuntimeError(f"--listen {address}: in use, or no address of this machine") from error
        await self._server.start()
        if address.startswith("unix:"):
            return address
        return f"{address.rpartition(':')[0]}:{port}"

    async def stop(self, grace: float) -> None:
        """Take no more calls; cut off after `grace` [s] those that are not done."""
        await self._server.stop(grace)
