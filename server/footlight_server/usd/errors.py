"""What can go wrong with a stage as a whole; everything smaller is a line in the report."""


class StageError(Exception):
    """The stage cannot be rendered; the message names the file or prim and the reason."""

    def __init__(self, message: str, prim_path: str = "") -> None:
        super().__init__(message)
        self.prim_path = prim_path


class StageNotFoundError(StageError):
    """There is no such file."""


class StageUnreadableError(StageError):
    """The file is there and may not be read: rights, a directory, outside the allowed roots."""


class StageMalformedError(StageError):
    """The file is not a stage, or a broken one."""


class StageLimitError(StageError):
    """The stage is larger than the limits allow."""


class CameraError(StageError):
    """The camera asked for is not there or cannot be rendered with."""
