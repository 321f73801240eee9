"""Which lanes rest after they lost a worker: a machine that starts none would otherwise run through a whole queue."""

import math

from footlight_server.farm.model import ExitClass

# [s] After the first loss, doubled with each further one in a row, up to the longest.
FIRST, LONGEST = 1.0, 60.0
# They say nothing about the lane.
_NEUTRAL = frozenset({ExitClass.PREEMPTED, ExitClass.CANCELLED})


class Rests:
    """Times are [s, any clock that only goes forward]."""

    def __init__(self) -> None:
        # lane -> losses in a row, and when it may be used again.
        self._lanes: dict[str, tuple[int, float]] = {}

    def note(self, lane: str, how: ExitClass, now: float) -> None:
        """An attempt on the lane ended at `now`."""
        if how is ExitClass.LOST:
            losses = self._lanes.get(lane, (0, 0.0))[0] + 1
            self._lanes[lane] = losses, now + min(FIRST * 2.0 ** min(losses - 1, 30), LONGEST)
        elif how not in _NEUTRAL:
            self._lanes.pop(lane, None)

    def over(self, lane: str, now: float) -> bool:
        """The lane does not rest."""
        return self._lanes.get(lane, (0, -math.inf))[1] <= now

    def next_end(self, now: float) -> float:
        """When the next lane has rested; infinity if none rests."""
        return min((until for _, until in self._lanes.values() if until > now), default=math.inf)
