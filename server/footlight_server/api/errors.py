"""The one table from exceptions to status codes, and how they are told to a client."""

import functools
import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import grpc
from google.protobuf.any_pb2 import Any as AnyMessage
from google.protobuf.message import Message
from google.rpc import error_details_pb2, status_pb2
from grpc_status import rpc_status

from footlight_server.sessions import errors

log = logging.getLogger(__name__)

DOMAIN = "footlight"

# [bytes] Of what goes into a status. The message travels twice, once with three bytes for each that is not plain.
_LONGEST_MESSAGE = 1000
_LONGEST_FIELD = 150
_LONGEST_DESCRIPTION = 400
_LARGEST_DETAIL = 2000
# [digests] Of 80 bytes each; whoever wants all of them asks FindMissingBlobs.
_MOST_DIGESTS = 10

Handler = Callable[[Any, Any, Any], Awaitable[Any]]

# The protos' comments on the services are the manual of this.
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
    errors.JobNotFoundError: (grpc.StatusCode.NOT_FOUND, "JOB_NOT_FOUND"),
    errors.TaskNotFoundError: (grpc.StatusCode.NOT_FOUND, "TASK_NOT_FOUND"),
    errors.FrameNotFoundError: (grpc.StatusCode.NOT_FOUND, "FRAME_NOT_FOUND"),
    errors.JobEndedError: (grpc.StatusCode.FAILED_PRECONDITION, "JOB_ENDED"),
    errors.JobNotEndedError: (grpc.StatusCode.FAILED_PRECONDITION, "JOB_NOT_ENDED"),
    errors.NotYoursError: (grpc.StatusCode.PERMISSION_DENIED, "NOT_YOURS"),
    errors.QuotaError: (grpc.StatusCode.RESOURCE_EXHAUSTED, "QUOTA"),
    errors.StorageError: (grpc.StatusCode.UNAVAILABLE, "STORAGE"),
    errors.BlobsMissingError: (grpc.StatusCode.FAILED_PRECONDITION, "BLOBS_MISSING"),
    errors.DigestMismatchError: (grpc.StatusCode.INVALID_ARGUMENT, "DIGEST_MISMATCH"),
    errors.WrongOffsetError: (grpc.StatusCode.OUT_OF_RANGE, "WRONG_OFFSET"),
    errors.TokenRequiredError: (grpc.StatusCode.UNAUTHENTICATED, "TOKEN_REQUIRED"),
    errors.ScopeRequiredError: (grpc.StatusCode.PERMISSION_DENIED, "SCOPE_REQUIRED"),
    errors.TokenNotFoundError: (grpc.StatusCode.NOT_FOUND, "TOKEN_NOT_FOUND"),
}


def told(handler: Handler) -> Handler:
    """A handler whose exceptions end the call with their status; those that nobody expects are logged and INTERNAL."""

    @functools.wraps(handler)
    async def telling(service: Any, request: Any, context: grpc.aio.ServicerContext) -> Any:
        try:
            return await handler(service, request, context)
        except errors.ServiceError as error:
            status = status_of(error)
        except Exception as error:
            log.exception("a call failed")
            status = status_of(error)
        return await context.abort_with_status(status)

    return telling


def status_of(error: Exception) -> grpc.Status:
    """What a client is told of an error; INTERNAL for one that is not in the table.

    A status travels in HTTP headers, which peers refuse above 8 KB, so what is too long is cut short.
    """
    code, reason = TABLE.get(type(error), (grpc.StatusCode.INTERNAL, "INTERNAL"))
    # What an unexpected error says may be of files that are none of the client's business; the log has it.
    message = (
        str(error) if type(error) in TABLE else f"a fault of Footlight, see the server's log: {type(error).__name__}"
    )
    status = status_pb2.Status(code=code.value[0], message=_shortened(message, _LONGEST_MESSAGE))
    _pack(status, error_details_pb2.ErrorInfo(reason=reason, domain=DOMAIN))
    if isinstance(error, errors.InvalidFieldsError):
        _pack(status, _bad_request(error.violations))
    if isinstance(error, errors.BlobsMissingError):
        missing = error_details_pb2.PreconditionFailure()
        for digest in error.digests[:_MOST_DIGESTS]:
            missing.violations.add(type="BLOB_MISSING", subject=digest, description="has to be uploaded")
        _pack(status, missing)
    return rpc_status.to_status(status)


def _bad_request(violations: Sequence[errors.FieldViolation]) -> error_details_pb2.BadRequest:
    """All of them, or as many as fit and how many there are besides."""
    request = error_details_pb2.BadRequest()
    for index, violation in enumerate(violations):
        request.field_violations.add(
            field=_shortened(violation.field, _LONGEST_FIELD),
            description=_shortened(violation.description, _LONGEST_DESCRIPTION),
        )
        if request.ByteSize() > _LARGEST_DETAIL and index + 1 < len(violations):
            request.field_violations.add(field="", description=f"and {len(violations) - index - 1} more fields")
            break
    return request


def _shortened(text: str, longest: int) -> str:
    """At most so many bytes of UTF-8, and a sign that there was more."""
    if len(text.encode(errors="replace")) <= longest:
        return text
    return text.encode(errors="replace")[:longest].decode(errors="ignore") + "…"


def _pack(status: status_pb2.Status, detail: Message) -> None:
    packed = AnyMessage()
    packed.Pack(detail)
    status.details.append(packed)
