"""The one table from exceptions to status codes, and how they are told to a client."""

import functools
import logging
from collections.abc import Awaitable, Callable
from typing import Any

import grpc
from google.protobuf.any_pb2 import Any as AnyMessage
from google.rpc import error_details_pb2, status_pb2
from grpc_status import rpc_status

from footlight_server.sessions import errors

log = logging.getLogger(__name__)

DOMAIN = "footlight"

Handler = Callable[[Any, Any, Any], Awaitable[Any]]

# The proto's comment on RenderService is the manual of this.
TABLE: dict[type[Exception], tuple[grpc.StatusCode, str]] = {
    errors.InvalidFieldsError: (grpc.StatusCode.INVALID_ARGUMENT, "INVALID_FIELD"),
    errors.RenderNotFoundError: (grpc.StatusCode.NOT_FOUND, "RENDER_NOT_FOUND"),
    errors.StageNotFoundError: (grpc.StatusCode.NOT_FOUND, "STAGE_NOT_FOUND"),
    errors.OutsideRootsError: (grpc.StatusCode.PERMISSION_DENIED, "OUTSIDE_ROOTS"),
    errors.ResultNotReadyError: (grpc.StatusCode.FAILED_PRECONDITION, "RESULT_NOT_READY"),
    errors.StageRefusedError: (grpc.StatusCode.FAILED_PRECONDITION, "STAGE_REFUSED"),
    errors.RequestIdReusedError: (grpc.StatusCode.ALREADY_EXISTS, "REQUEST_ID_REUSED"),
    errors.QueueFullError: (grpc.StatusCode.RESOURCE_EXHAUSTED, "QUEUE_FULL"),
    errors.WorkerFailedError: (grpc.StatusCode.ABORTED, "WORKER_FAILED"),
    errors.TimeLimitError: (grpc.StatusCode.DEADLINE_EXCEEDED, "TIME_LIMIT"),
    errors.ViewerSilentError: (grpc.StatusCode.DEADLINE_EXCEEDED, "NOT_READING"),
    errors.ShuttingDownError: (grpc.StatusCode.UNAVAILABLE, "SHUTTING_DOWN"),
}


def told(handler: Handler) -> Handler:
    """A handler whose exceptions end the call with their status; those that nobody expects are logged and INTERNAL."""

    @functools.wraps(handler)
    async def telling(service: Any, request: Any, context: grpc.aio.ServicerContext) -> Any:
        try:
            return await handler(service, request, context)
        except errors.ServiceError as error:
            code, reason = TABLE[type(error)]
            status = _status(code, reason, error)
        except Exception as error:
            log.exception("a call failed")
            status = _status(grpc.StatusCode.INTERNAL, "INTERNAL", error)
        return await context.abort_with_status(status)

    return telling


def _status(code: grpc.StatusCode, reason: str, error: Exception) -> grpc.Status:
    message = str(error) if isinstance(error, errors.ServiceError) else f"{type(error).__name__}: {error}"
    status = status_pb2.Status(code=code.value[0], message=message)
    _pack(status, error_details_pb2.ErrorInfo(reason=reason, domain=DOMAIN))
    if isinstance(error, errors.InvalidFieldsError):
        request = error_details_pb2.BadRequest()
        for violation in error.violations:
            request.field_violations.add(field=violation.field, description=violation.description)
        _pack(status, request)
    return rpc_status.to_status(status)


def _pack(status: status_pb2.Status, detail: error_details_pb2.ErrorInfo | error_details_pb2.BadRequest) -> None:
    packed = AnyMessage()
    packed.Pack(detail)
    status.details.append(packed)
