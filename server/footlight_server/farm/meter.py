"""Where the farm's work is counted, if anybody counts it."""

from typing import Protocol

from footlight.v1 import stats_pb2


class FarmMeter(Protocol):
    """Told of what has ended; must not raise and must not block."""

    def count_attempt(self, exit_class: str, seconds: float) -> None:
        """An attempt at a task has ended, after so long."""
        ...

    def count_frame(self) -> None:
        """An image was recorded."""
        ...

    def count_work(self, stats: stats_pb2.RenderStats) -> None:
        """Samples were taken, for an image or a part of one; `stats` is what they cost."""
        ...
