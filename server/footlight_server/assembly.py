"""What stands behind the services of a server, put together. A private server has the least of it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from footlight.v1 import render_service_pb2, render_service_pb2_grpc, stage_service_pb2, stage_service_pb2_grpc
from footlight_server.api.render_service import RenderService
from footlight_server.api.server import Service
from footlight_server.api.stage_service import StageService
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings

if TYPE_CHECKING:
    from footlight_server.api.job_service import JobService
    from footlight_server.api.token_gate import TokenGate
    from footlight_server.farm.dispatcher import Farm


@dataclass(frozen=True, slots=True)
class Parts:
    """What a server is made of. Whoever has it closes `farm`, then `sessions`, then `jobs`.

    Attributes:
        sessions: the renders that somebody waits for.
        services: what clients call.
        farm: the queue's tasks; None in a private server.
        gate: for addresses that others reach; None in a private server, which has none.
        jobs: whose watchers are told of the end before their calls are cut off; None in a private server.
    """

    sessions: Sessions
    services: tuple[Service, ...]
    farm: "Farm | None" = None
    gate: "TokenGate | None" = None
    jobs: "JobService | None" = None


def private_parts(settings: Settings) -> Parts:
    """A server that renders while its one client waits, and keeps nothing."""
    sessions = Sessions(settings)
    return Parts(sessions, render_services(RenderService(sessions, settings), StageService(sessions, settings)))


def render_services(renders: RenderService, stages: StageService) -> tuple[Service, ...]:
    """What a private server has, and every other."""
    return (
        Service(
            render_service_pb2.DESCRIPTOR.services_by_name["RenderService"].full_name,
            renders,
            render_service_pb2_grpc.add_RenderServiceServicer_to_server,
        ),
        Service(
            stage_service_pb2.DESCRIPTOR.services_by_name["StageService"].full_name,
            stages,
            stage_service_pb2_grpc.add_StageServiceServicer_to_server,
        ),
    )
