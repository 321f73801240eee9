"""Which lanes a job and a task may use, by what has failed where; never none of those that are there."""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet


def usable_lanes(live: Sequence[str], failed_tasks: Mapping[str, int], block_after: int) -> tuple[str, ...]:
    """The lanes that a job uses. `failed_tasks`: how many of its tasks failed on each lane, where any did.

    A lane is blocked after `block_after` of them; if that are all, the least failed is used all the same.
    """
    usable = tuple(lane for lane in live if failed_tasks.get(lane, 0) < block_after)
    if usable or not live:
        return usable
    return (min(live, key=lambda lane: (failed_tasks.get(lane, 0), lane)),)


def may_take(lane: str, usable: Sequence[str], failed_on: AbstractSet[str]) -> bool:
    """Whether a task may be given to a lane. `failed_on`: where it failed before; again only if it did everywhere."""
    return lane in usable and (lane not in failed_on or all(other in failed_on for other in usable))
