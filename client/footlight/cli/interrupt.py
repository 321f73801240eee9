"""Ctrl-C: the first cancels the render on the server, the second leaves at once."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from footlight.cli.report import note
from footlight.errors import FootlightError
from footlight.session import Session

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def cancelling(session: Session, *, keep_partial: bool) -> Iterator[None]:
    """Within the block a signal cancels `session`; the events then end by themselves."""

    def cancel() -> None:
        note("cancelling; Ctrl-C again leaves at once")
        # If this fails the connection is gone, and the events end with that error.
        with contextlib.suppress(FootlightError):
            session.cancel(keep_partial=keep_partial)

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        for number in SIGNALS:
            signal.signal(number, signal.default_int_handler)
        # In a thread of its own: the signal may have come in the middle of a gRPC call, with its locks held.
        threading.Thread(target=cancel, daemon=True).start()

    before = {number: signal.signal(number, on_signal) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
