"""StageService: what would be rendered, without rendering."""

import asyncio

import grpc

from footlight.v1 import render_pb2, stage_service_pb2, stage_service_pb2_grpc
from footlight_server.api.errors import told
from footlight_server.api.spec import check_stage, complete_spec
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


class StageService(stage_service_pb2_grpc.StageServiceServicer):  # type: ignore[misc]
    """Explains through a worker, as a render without samples."""

    def __init__(self, sessions: Sessions, settings: Settings) -> None:
        self._sessions = sessions
        self._settings = settings

    @told
    async def ExplainStage(
        self, request: stage_service_pb2.ExplainStageRequest, context: grpc.aio.ServicerContext
    ) -> stage_service_pb2.ExplainStageResponse:
        """Translate and report."""
        del context
        spec = complete_spec(request.spec)
        await asyncio.to_thread(check_stage, spec.stage_path, self._settings.roots)
        render = await self._sessions.explain(spec)
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
