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
    CANCELLED = 130


HELP = {
    Exit.OK: "the image is written",
    Exit.FAILED: "the render failed: a crash, or a fault of Footlight",
    Exit.USAGE: "an option is not allowed; the message says what is",
    Exit.STAGE: "the stage is missing, unreadable, or holds what cannot be rendered",
    Exit.SERVER: "no server answers, or it takes no more renders",
    Exit.OUTPUT: "a file cannot be written",
    Exit.LIMIT: "a limit on time or memory was reached",
    Exit.CANCELLED: "cancelled by Ctrl-C, with or without a partial image",
}

# By the class of footlight.errors, and by the reason of a RenderFailedError.
BY_ERROR = {
    "InvalidRequestError": Exit.USAGE,
    "StageNotFoundError": Exit.STAGE,
    "StageRefusedError": Exit.STAGE,
    "OutsideRootsError": Exit.STAGE,
    "ServerUnavailableError": Exit.SERVER,
    "NoServerError": Exit.SERVER,
    "QueueFullError": Exit.SERVER,
    "RenderNotFoundError": Exit.SERVER,
    "DeadlineError": Exit.LIMIT,
    "RenderCancelledError": Exit.CANCELLED,
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
    if [field for field, _ in getattr(error, "fields", ())] == ["spec.stage_path"]:
        return Exit.STAGE
    reason = getattr(error, "reason", None)
    if reason is not None:
        return BY_REASON.get(reason, Exit.FAILED)
    return BY_ERROR.get(type(error).__name__, Exit.FAILED)
