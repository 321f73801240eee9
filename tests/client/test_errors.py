"""Every reason that the .proto lists becomes an exception of its own, with what the server said."""

import re
from pathlib import Path

import grpc
import pytest
from google.protobuf import any_pb2
from google.rpc import error_details_pb2, status_pb2

from footlight import errors
from footlight.cli.exits import BY_ERROR, BY_REASON, Exit, exit_code
from footlight.errors import (
    _BY_REASON,
    FootlightError,
    InvalidRequestError,
    JobCancelledError,
    JobFailedError,
    ProtocolError,
    RenderFailedError,
    ServerUnavailableError,
    from_rpc,
)
from footlight.private import NoServerError
from footlight.v1 import job_pb2, render_pb2

PROTOS = sorted((Path(__file__).parents[2] / "proto" / "footlight" / "v1").glob("*_service.proto"))


class FailedCall(grpc.RpcError):  # type: ignore[misc]
    """As a grpc.Call after a failure."""

    def __init__(self, code: grpc.StatusCode, details: str, *, status: status_pb2.Status | None = None) -> None:
        self._code, self._details, self._status = code, details, status

    def code(self) -> grpc.StatusCode:
        return self._code

    def details(self) -> str:
        return self._details

    def trailing_metadata(self) -> tuple[tuple[str, bytes], ...]:
        return (("grpc-status-details-bin", self._status.SerializeToString()),) if self._status else ()


def failed(code: grpc.StatusCode, message: str, reason: str, **fields: str) -> FailedCall:
    status = status_pb2.Status(code=code.value[0], message=message)
    faults = [error_details_pb2.BadRequest.FieldViolation(field=name, description=why) for name, why in fields.items()]
    for detail in (
        error_details_pb2.ErrorInfo(reason=reason, domain="footlight"),
        error_details_pb2.BadRequest(field_violations=faults),
    ):
        packed = any_pb2.Any()
        packed.Pack(detail)
        status.details.append(packed)
    return FailedCall(code, message, status=status)


def table() -> list[tuple[str, str]]:
    text = "".join(proto.read_text() for proto in PROTOS)
    return re.findall(r"^//   ([A-Z_]+) +([A-Z_]+)\b", text, re.MULTILINE)


@pytest.mark.parametrize(("code", "reason"), table())
def test_the_table_of_the_proto_is_ours(code: str, reason: str) -> None:
    error = from_rpc(failed(grpc.StatusCode[code], "what happened", reason), "here")
    assert type(error) is _BY_REASON[reason]
    assert "what happened" in str(error)


def test_the_table_is_complete() -> None:
    assert {reason for _, reason in table()} == set(_BY_REASON)


def test_fields_at_fault_are_named() -> None:
    error = from_rpc(
        failed(grpc.StatusCode.INVALID_ARGUMENT, "bad", "INVALID_FIELD", spp="0 is not 1 to 9", seed="x"), "h"
    )
    assert isinstance(error, InvalidRequestError)
    assert str(error) == "spp: 0 is not 1 to 9; seed: x"
    assert error.fields == (("spp", "0 is not 1 to 9"), ("seed", "x"))


def test_no_server_names_the_address() -> None:
    error = from_rpc(FailedCall(grpc.StatusCode.UNAVAILABLE, "connection refused"), "localhost:1")
    assert isinstance(error, ServerUnavailableError)
    assert "localhost:1" in str(error)


def test_details_that_contradict_the_status_are_left_alone() -> None:
    status = status_pb2.Status(code=3, message="other")
    error = from_rpc(FailedCall(grpc.StatusCode.INTERNAL, "this", status=status), "h")
    assert type(error) is ProtocolError


def test_every_error_has_an_exit_code() -> None:
    def below(kind: type[FootlightError]) -> list[type[FootlightError]]:
        return [kind, *(deeper for child in kind.__subclasses__() for deeper in below(child))]

    assert NoServerError in below(FootlightError)
    reasons = [name.removeprefix("FAILURE_REASON_") for name in render_pb2.FailureReason.keys()]  # noqa: SIM118
    assert set(BY_REASON) <= set(reasons)
    for name in render_pb2.FailureReason.keys():  # noqa: SIM118
        failure = render_pb2.Failure(reason=render_pb2.FailureReason.Value(name), message="m")
        assert exit_code(RenderFailedError(failure)) not in (Exit.OK, Exit.CANCELLED)
    failed = JobFailedError(job_pb2.Job(name="jobs/1"))
    cancelled = JobCancelledError(job_pb2.Job(name="jobs/1"))
    assert (exit_code(failed), exit_code(cancelled)) == (Exit.FAILED, Exit.CANCELLED)
    assert {name for name in BY_ERROR if not hasattr(errors, name)} == {
        "NoServerError",
        "CollectError",
        "NoViewerError",
    }
    assert exit_code(OSError(28, "No space left on device", "a.exr")) is Exit.OUTPUT


def test_a_job_that_failed_says_how_much_and_the_first_reason() -> None:
    job = job_pb2.Job(name="jobs/12", frames_done=3, frames_total=5, tasks=job_pb2.TaskCounts(failed=1))
    task = job_pb2.Task(last_attempt=job_pb2.Attempt(message="/World/Nobody is not a camera"))
    assert str(JobFailedError(job)) == "jobs/12 failed: 1 task failed, 3 of 5 frames rendered"
    assert str(JobFailedError(job, (task,))).endswith("; /World/Nobody is not a camera")
