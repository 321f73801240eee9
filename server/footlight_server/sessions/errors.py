"""What a client can get wrong, or meet; api/ maps each to a status code."""

from collections.abc import Sequence
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
    """The request_id named a different render or job before."""


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


class JobNotFoundError(ServiceError):
    """No such job, or it is pruned."""


class TaskNotFoundError(ServiceError):
    """No such task or attempt."""


class FrameNotFoundError(ServiceError):
    """The layer has no such frame, or no image yet."""


class JobEndedError(ServiceError):
    """The job has ended; there is nothing to pause or resume."""


class JobNotEndedError(ServiceError):
    """The job has not ended; it cannot be pruned."""


class NotYoursError(ServiceError):
    """The job is another user's."""


class QuotaError(ServiceError):
    """More than this user may have."""


class StorageError(ServiceError):
    """The database, or the disk below it, does not answer or does not take more: it is locked, or the disk is full."""


class DigestMismatchError(ServiceError):
    """The bytes are not what their digest says."""


class WrongOffsetError(ServiceError):
    """The bytes do not begin where the upload stands."""


class TokenRequiredError(ServiceError):
    """No token, or one that is unknown, revoked or out of date."""


class ScopeRequiredError(ServiceError):
    """The token does not allow this."""


class TokenNotFoundError(ServiceError):
    """No such token."""


class BlobsMissingError(ServiceError):
    """A bundle is not whole. `digests`: `{sha256}/{size}` of what is missing."""

    def __init__(self, message: str, digests: Sequence[str]) -> None:
        super().__init__(message)
        self.digests = tuple(digests)


@dataclass(frozen=True, slots=True)
class FieldViolation:
    """A field by its path in the request, and what is allowed."""

    field: str
    description: str


class InvalidFieldsError(ServiceError):
    """Fields outside what is allowed."""

    def __init__(self, violations: Sequence[FieldViolation]) -> None:
        super().__init__("; ".join(f"{v.field}: {v.description}" for v in violations))
        self.violations = list(violations)


class DatabaseRefusedError(Exception):
    """The database cannot be this server's, which therefore does not start; clients are never told."""


class DatabaseBusyError(DatabaseRefusedError):
    """A server that lives owns the database."""
