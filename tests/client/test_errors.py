"""Every reason that the .proto lists becomes an exception of its own, with what the server said."""

import re
from pathlib import Path

import grpc
import pytest
from google.protobuf import any_pb2
from google.rpc import error_details_pb2, status_pb2

from footlight.cli.exits import BY_REASON, Exit, exit_code
from footlight.errors import (
    _BY_REASON,
    FootlightError,
    InvalidRequestError,
    ProtocolError,
    RenderFailedError,
    ServerUnavailableError,
    from_rpc,
)
from footlight.private import NoServerError
from footlight.v1 import render_pb2

PROTO = Path(__file__).parents[2] / "proto" / "footlight" / "v1" / "render_service.proto"


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
    return re.findall(r"^//   ([A-Z_]+) +([A-Z_]+)\b", PROTO.read_text(), re.MULTILINE)


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
    assert exit_code(OSError(28, "No space left on device", "a.exr")) is Exit.OUTPUT
