"""StageService: what would be rendered, without rendering."""

from typing import TYPE_CHECKING

import grpc

from footlight.v1 import render_pb2, stage_service_pb2, stage_service_pb2_grpc
from footlight_server.api.errors import told
from footlight_server.api.spec import complete_spec
from footlight_server.api.stage_files import stage_files
from footlight_server.sessions.errors import (
    FieldViolation,
    InvalidFieldsError,
    ServiceError,
    ShuttingDownError,
    StageRefusedError,
    TimeLimitError,
    WorkerFailedError,
)
from footlight_server.sessions.sessions import Sessions
from footlight_server.settings import Settings

if TYPE_CHECKING:
    from footlight_server.blobs.bundle import BundleStore


class StageService(stage_service_pb2_grpc.StageServiceServicer):  # type: ignore[misc]
    """Explains through a worker, as a render without samples."""

    def __init__(self, sessions: Sessions, settings: Settings, bundles: "BundleStore | None" = None) -> None:
        self._sessions = sessions
        self._settings = settings
        self._bundles = bundles

    @told
    async def ExplainStage(
        self, request: stage_service_pb2.ExplainStageRequest, context: grpc.aio.ServicerContext
    ) -> stage_service_pb2.ExplainStageResponse:
        """Translate and report."""
        del context
        spec = complete_spec(request.spec)
        files = await stage_files(spec, self._settings, self._bundles)
        render = await self._sessions.explain(spec, files)
        if render.state != render_pb2.RENDER_STATE_SUCCEEDED:
            raise _refusal(render)
        return stage_service_pb2.ExplainStageResponse(report=render.report, spec=render.spec)


def _refusal(render: render_pb2.Render) -> ServiceError:
    """The error that a render without samples ended in."""
    message = render.failure.message
    match render.failure.reason:
        case render_pb2.FAILURE_REASON_UNSPECIFIED:
            return ShuttingDownError("the server is stopping")
        case render_pb2.FAILURE_REASON_INVALID_ARGUMENT:
            return InvalidFieldsError([FieldViolation("spec", message)])
        case render_pb2.FAILURE_REASON_STAGE_UNREADABLE | render_pb2.FAILURE_REASON_SCENE:
            return StageRefusedError(message)
        case render_pb2.FAILURE_REASON_TIMEOUT:
            return TimeLimitError(message)
        case _:
            return WorkerFailedError(message)
