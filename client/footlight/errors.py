"""What can go wrong, as exceptions: one table from gRPC's status details to types."""

import contextlib
from collections.abc import Iterator

import grpc
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from footlight.v1 import job_pb2, render_pb2


class FootlightError(Exception):
    """Anything Footlight reports; the message is for people."""


class ServerUnavailableError(FootlightError):
    """No server answers at the address, or it is shutting down. Try again later."""


class StorageError(ServerUnavailableError):
    """The server's database is locked or its disk is full; nothing happened. Try again later."""


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


class NotReadingError(DeadlineError):
    """A stream was cut off because nothing was read from it for long; what it told of goes on. Subscribe again."""


class WorkerFailedError(FootlightError):
    """The worker that was to explain the stage crashed or ran out of memory. A retry may meet the same end."""


class ProtocolError(FootlightError):
    """The server sent what its protocol does not allow, or failed inside. Please report it."""


class JobNotFoundError(FootlightError):
    """The server knows no such job, or it is pruned."""


class TaskNotFoundError(FootlightError):
    """The job has no such task, or the task no such attempt."""


class FrameNotFoundError(FootlightError):
    """The layer has no such frame, or there is no image of it yet."""


class JobEndedError(FootlightError):
    """The job has ended, so that it cannot be paused or resumed."""


class JobNotEndedError(FootlightError):
    """The job has not ended, so that it cannot be pruned."""


class QuotaError(FootlightError):
    """More than this user may have on the server. Try again when some of it is done or gone."""


class CredentialsError(FootlightError):
    """A certificate or key that was named cannot be used."""


class TokenRequiredError(FootlightError):
    """The server asks for a token, and there was none, or one that it does not know or that is revoked."""


class DeniedError(FootlightError):
    """The token does not allow it, or the job is another user's."""


class TokenNotFoundError(FootlightError):
    """The server knows no such token."""


class BlobsMissingError(FootlightError):
    """An uploaded stage is not whole on the server. Upload it again."""


class DigestMismatchError(FootlightError):
    """Uploaded bytes arrived as others than they were named. Upload them again."""


class WrongOffsetError(FootlightError):
    """An upload went on at another place than where it stands."""


class JobFailedError(FootlightError):
    """The job has ended and tasks of it have failed; `job` is its last state, `tasks` are some of those that failed."""

    def __init__(self, job: job_pb2.Job, tasks: tuple[job_pb2.Task, ...] = ()) -> None:
        first = next((task.last_attempt.message for task in tasks if task.last_attempt.message), "")
        super().__init__(
            f"{job.name} failed: {_count(job.tasks.failed, 'task')} failed, "
            f"{job.frames_done} of {_count(job.frames_total, 'frame')} rendered" + (f"; {first}" if first else "")
        )
        self.job = job
        self.tasks = tasks


class JobCancelledError(FootlightError):
    """The job was cancelled; `job` is its last state."""

    def __init__(self, job: job_pb2.Job) -> None:
        super().__init__(f"{job.name} was cancelled, {job.frames_done} of {_count(job.frames_total, 'frame')} rendered")
        self.job = job


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


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


# By google.rpc.ErrorInfo.reason; the tables at the services in the .proto files.
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
    "NOT_READING": NotReadingError,
    "WORKER_FAILED": WorkerFailedError,
    "SHUTTING_DOWN": ServerUnavailableError,
    "INTERNAL": ProtocolError,
    "JOB_NOT_FOUND": JobNotFoundError,
    "TASK_NOT_FOUND": TaskNotFoundError,
    "FRAME_NOT_FOUND": FrameNotFoundError,
    "JOB_ENDED": JobEndedError,
    "JOB_NOT_ENDED": JobNotEndedError,
    "BLOBS_MISSING": BlobsMissingError,
    "NOT_YOURS": DeniedError,
    "QUOTA": QuotaError,
    "STORAGE": StorageError,
    "DIGEST_MISMATCH": DigestMismatchError,
    "WRONG_OFFSET": WrongOffsetError,
    "TOKEN_REQUIRED": TokenRequiredError,
    "SCOPE_REQUIRED": DeniedError,
    "TOKEN_NOT_FOUND": TokenNotFoundError,
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
        return ServerUnavailableError(f"no Footlight server answers at {address}: {_cause(message)}")
    return kind(message)


_UNTRUSTED = "its certificate is not signed by one that is trusted; `ca` names others"
# What gRPC and its TLS say -> what it means.
_CAUSES = {
    "WRONG_VERSION_NUMBER": "it does not speak TLS, which `ca`, and any address beyond this machine, asks for",
    "CERTIFICATE_VERIFY_FAILED": _UNTRUSTED,
    "certificate signature failure": _UNTRUSTED,
    "Hostname Verification Check failed": "its certificate is for another name",
    "Failed to create security handshaker": "the certificates or the key given here are not usable",
}
_HANG_UP = "Socket closed"


def _cause(message: str) -> str:
    """The end of gRPC's chain of reasons, which is what failed: `Connection refused`."""
    for sign, meaning in _CAUSES.items():
        if sign in message:
            return meaning
    if message == _HANG_UP:
        return "the connection broke"
    if message.endswith(_HANG_UP):  # while the connection was made
        return "it hangs up; if it speaks TLS, `ca` has to name the certificates to trust"
    return message.rpartition("last error: UNKNOWN: ")[2].rpartition("Failed to connect to remote host: ")[2]


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
