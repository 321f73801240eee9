"""What a client can get wrong, or meet; api/ maps each to a status code."""

from dataclasses import dataclass


class ServiceError(Exception):
    """Base of all errors that a client is told."""


class RenderNotFoundError(ServiceError):
    """No such render, or it is forgotten."""


class StageNotFoundError(ServiceError):
    """No such file."""


class OutsideRootsError(ServiceError):
    """The stage does not lie below a root of this server."""


class ResultNotReadyError(ServiceError):
    """The render has no such image, or not yet."""


class StageRefusedError(ServiceError):
    """The stage cannot be opened or translated."""


class RequestIdReusedError(ServiceError):
    """The request_id named a different render before."""


class QueueFullError(ServiceError):
    """Too many renders wait."""


class TimeLimitError(ServiceError):
    """It took longer than the server allows."""


class ShuttingDownError(ServiceError):
    """The server is stopping."""


class WorkerFailedError(ServiceError):
    """The worker died, ran out of memory, or met a fault of ours."""


class ViewerSilentError(ServiceError):
    """A viewer did not read what it was sent."""


@dataclass(frozen=True, slots=True)
class FieldViolation:
    """A field by its path in the request, and what is allowed."""

    field: str
    description: str


class InvalidFieldsError(ServiceError):
    """Fields outside what is allowed."""

    def __init__(self, violations: list[FieldViolation]) -> None:
        super().__init__("; ".join(f"{v.field}: {v.description}" for v in violations))
        self.violations = violations
