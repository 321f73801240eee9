"""Exit codes: stable, and one table from what went wrong to the code. `footlight --help` shows them."""

from enum import IntEnum


class Exit(IntEnum):
    """What the process returns; HELP says what each means."""

    OK = 0
    FAILED = 1
    USAGE = 2
    STAGE = 3
    SERVER = 4
    OUTPUT = 5
    LIMIT = 6
    NOT_FOUND = 7
    DENIED = 8
    STATE = 9
    CANCELLED = 130


HELP = {
    Exit.OK: "done; the image is written, the job that was watched succeeded",
    Exit.FAILED: "the render or the job that was watched failed",
    Exit.USAGE: "an option is not allowed; the message says what is",
    Exit.STAGE: "the stage is missing, unreadable, or holds what cannot be rendered",
    Exit.SERVER: "no server answers, or it takes no more",
    Exit.OUTPUT: "a file cannot be written",
    Exit.LIMIT: "a limit on time, memory or what one user may have was reached",
    Exit.NOT_FOUND: "no such job, task, frame or token",
    Exit.DENIED: "the server asks for a token, or for one that allows more",
    Exit.STATE: "the job has ended, or has not ended, so that this cannot be done",
    Exit.CANCELLED: "cancelled, or left by Ctrl-C",
}

# By the class of footlight.errors, and by the reason of a RenderFailedError.
BY_ERROR = {
    "InvalidRequestError": Exit.USAGE,
    "StageNotFoundError": Exit.STAGE,
    "StageRefusedError": Exit.STAGE,
    "OutsideRootsError": Exit.STAGE,
    "ServerUnavailableError": Exit.SERVER,
    "StorageError": Exit.SERVER,
    "NoServerError": Exit.SERVER,
    "QueueFullError": Exit.SERVER,
    "RenderNotFoundError": Exit.SERVER,
    "DeadlineError": Exit.LIMIT,
    "NotReadingError": Exit.LIMIT,
    "QuotaError": Exit.LIMIT,
    "RenderCancelledError": Exit.CANCELLED,
    "JobCancelledError": Exit.CANCELLED,
    "JobNotFoundError": Exit.NOT_FOUND,
    "TaskNotFoundError": Exit.NOT_FOUND,
    "FrameNotFoundError": Exit.NOT_FOUND,
    "ResultNotReadyError": Exit.NOT_FOUND,
    "TokenNotFoundError": Exit.NOT_FOUND,
    "CredentialsError": Exit.USAGE,
    "NoViewerError": Exit.USAGE,
    "TokenRequiredError": Exit.DENIED,
    "DeniedError": Exit.DENIED,
    "JobEndedError": Exit.STATE,
    "JobNotEndedError": Exit.STATE,
    "CollectError": Exit.STAGE,
}
BY_REASON = {
    "INVALID_ARGUMENT": Exit.USAGE,
    "STAGE_UNREADABLE": Exit.STAGE,
    "SCENE": Exit.STAGE,
    "OUT_OF_MEMORY": Exit.LIMIT,
    "TIMEOUT": Exit.LIMIT,
    "OUTPUT": Exit.OUTPUT,
}


def exit_code(error: Exception) -> Exit:
    """The code for an exception of Footlight or of the file system."""
    if isinstance(error, OSError):
        return Exit.OUTPUT
    faults = [field for field, _ in getattr(error, "fields", ())]
    if len(faults) == 1 and faults[0].endswith("stage_path"):
        return Exit.STAGE
    reason = getattr(error, "reason", None)
    if reason is not None:
        return BY_REASON.get(reason, Exit.FAILED)
    return BY_ERROR.get(type(error).__name__, Exit.FAILED)
