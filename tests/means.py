"""The means to confine that this machine has: where containers or policies forbid one, its tests are left out."""

from functools import cache

import pytest

from footlight_server.workers import sandbox
from footlight_server.workers.sandbox import SandboxName

MEANS = [SandboxName.BUBBLEWRAP, SandboxName.LANDLOCK]


@cache
def lacking(means: SandboxName) -> str:
    """Why it cannot be had here; empty if it can."""
    return sandbox._try(means)


def require(means: SandboxName) -> None:
    """Leave the test out where there is no such thing. A machine that has none of them fails."""
    assert not all(lacking(each) for each in MEANS), [lacking(each) for each in MEANS]
    if lacking(means):
        pytest.skip(f"{means}: {lacking(means)}")
