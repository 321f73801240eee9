"""What can go wrong, as exceptions: one table from gRPC's status details to types."""

import contextlib
from collections.abc import Iterator

import grpc
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from footlight.v1 import render_pb2


class FootlightError(Exception):
    """Anything Footlight reports; the message is for people."""


class ServerUnavailableError(FootlightError):
    """No server answers at the address, or it is shutting down. Try again later."""


class InvalidRequestError(FootlightError):
    """Options outside what is allowed; `fields` names each with what is wrong."""

    def __init__(self, message: str, fields: tuple[tuple[str, str], ...] = ()) -> None:
        super().__init__("; ".join(f"{field}: {why}" for field, why in fields) or message)
        self.fields = fields


class RenderNotFoundError(FootlightError):
    """The server knows no such render, or has forgotten it."""


class StageNotFoundError(FootlightError):
    """There is no such stage file on the server's machine."""


class OutsideRootsError(FootlightError):
    """The stage does not lie below one of the server's --root directories."""


class ResultNotReadyError(FootlightError):
    """The render has no such image, or not yet."""


class StageRefusedError(FootlightError):
    """The stage cannot be opened or holds what cannot be rendered."""


class QueueFullError(FootlightError):
    """Too many renders wait on the server. Try again later."""


class DeadlineError(FootlightError):
    """The server did not answer in time, or opening the stage took longer than it allows."""


class WorkerFailedError(FootlightError):
    """The worker that was to explain the stage crashed or ran out of memory. A retry may meet the same end."""


class ProtocolError(FootlightError):
    """The server sent what its protocol does not allow, or failed inside. Please report it."""


class RenderCancelledError(FootlightError):
    """The render was cancelled; `has_result` says whether the image so far was kept."""

    def __init__(self, name: str, *, has_result: bool) -> None:
        super().__init__(f"{name} was cancelled")
        self.has_result = has_result


class RenderFailedError(FootlightError):
    """The render ended without an image.

    `reason` is the name in footlight.v1.FailureReason without its prefix, `STAGE_UNREADABLE` for one; `prim_path`
    is the prim at fault or empty.
    """

    def __init__(self, failure: render_pb2.Failure) -> None:
        super().__init__(failure.message)
        name: str = render_pb2.FailureReason.Name(failure.reason)
        self.reason = name.removeprefix("FAILURE_REASON_")
        self.prim_path = failure.prim_path


# By google.rpc.ErrorInfo.reason; the table at RenderService in render_service.proto.
_BY_REASON: dict[str, type[FootlightError]] = {
    "INVALID_FIELD": InvalidRequestError,
    "REQUEST_ID_REUSED": InvalidRequestError,
    "RENDER_NOT_FOUND": RenderNotFoundError,
    "STAGE_NOT_FOUND": StageNotFoundError,
    "OUTSIDE_ROOTS": OutsideRootsError,
    "RESULT_NOT_READY": ResultNotReadyError,
    "STAGE_REFUSED": StageRefusedError,
    "QUEUE_FULL": QueueFullError,
    "TIME_LIMIT": DeadlineError,
    "NOT_READING": DeadlineError,
    "WORKER_FAILED": WorkerFailedError,
    "SHUTTING_DOWN": ServerUnavailableError,
    "INTERNAL": ProtocolError,
}

# For errors that come from gRPC itself and carry no details.
_BY_CODE: dict[grpc.StatusCode, type[FootlightError]] = {
    grpc.StatusCode.UNAVAILABLE: ServerUnavailableError,
    grpc.StatusCode.DEADLINE_EXCEEDED: DeadlineError,
    grpc.StatusCode.INVALID_ARGUMENT: InvalidRequestError,
}


def from_rpc(error: grpc.RpcError, address: str) -> FootlightError:
    """The exception for a failed call, by its google.rpc details or else by its code."""
    reason, fields = _details(error)
    kind = _BY_REASON.get(reason) or _BY_CODE.get(error.code(), ProtocolError)
    message = error.details() or error.code().name
    if kind is InvalidRequestError:
        return InvalidRequestError(message, fields)
    if kind is ServerUnavailableError and not reason:
        return ServerUnavailableError(f"no Footlight server answers at {address}: {message}")
    return kind(message)


def _details(error: grpc.RpcError) -> tuple[str, tuple[tuple[str, str], ...]]:
    """ErrorInfo's reason and BadRequest's fields; empty where the status has none."""
    status = None
    with contextlib.suppress(ValueError):  # details that contradict the status
        status = rpc_status.from_call(error)
    info, bad = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
    for detail in status.details if status else ():
        detail.Unpack(info)
        detail.Unpack(bad)
    return info.reason, tuple((fault.field, fault.description) for fault in bad.field_violations)


@contextlib.contextmanager
def rpc_errors(address: str) -> Iterator[None]:
    """Calls inside raise FootlightError instead of grpc.RpcError."""
    try:
        yield
    except grpc.RpcError as error:
        raise from_rpc(error, address) from error
