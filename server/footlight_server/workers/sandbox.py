"""How this machine confines workers whose stage is not trusted: chosen once, by trying it."""

import os
import subprocess
import sys
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from tempfile import TemporaryDirectory

from footlight.worker.v1 import worker_pb2
from footlight_server.workers import bubblewrap
from footlight_server.workers.limits import worker_environment

# [s] Longer, and the means is of no use.
_TRIAL = 20.0
# Confines itself if it is told to, and reaches for what lies outside.
_TRIAL_MODULE = "footlight_server.workers.trial"


class SandboxName(StrEnum):
    """The means there are, best first."""

    BUBBLEWRAP = "bubblewrap"
    LANDLOCK = "landlock"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Sandbox:
    """A means to confine workers. `reason`: why it is not a better one; empty for the best."""

    name: SandboxName
    reason: str = ""

    @property
    def refusal(self) -> str:
        """Why a stage that is not trusted cannot be opened here; empty if it can."""
        if self.name is not SandboxName.NONE:
            return ""
        return (
            f"stages that are not trusted are refused here, since their workers cannot be confined: {self.reason}; "
            "a server started with --trust-scenes opens them all the same"
        )

    @property
    def summary(self) -> str:
        """One line for the log."""
        because = f" ({self.reason})" if self.reason else ""
        return self.refusal or f"workers of stages that are not trusted are confined by {self.name}{because}"


@cache
def choose_sandbox() -> Sandbox:
    """The best that works here. Blocks for up to a second the first time; the answer is kept."""
    why_not: list[str] = []
    for name in (SandboxName.BUBBLEWRAP, SandboxName.LANDLOCK):
        reason = _try(name)
        if not reason:
            return Sandbox(name, "; ".join(why_not))
        why_not.append(f"{name}: {reason}")
    return Sandbox(SandboxName.NONE, "; ".join(why_not))


def _try(name: SandboxName) -> str:
    """Run a child as a worker would be; why that does not confine it, empty if it does."""
    with TemporaryDirectory(prefix="footlight-sandbox-") as outside, TemporaryDirectory(prefix="footlight-") as inside:
        command = [sys.executable, "-P", "-m", _TRIAL_MODULE, name, inside, outside]
        environment = worker_environment(os.environ)
        if name is SandboxName.BUBBLEWRAP:
            if (found := bubblewrap.find_program()) is None:
                return "not installed"
            command = bubblewrap.command(found, worker_pb2.Confinement(write_paths=[inside]), command)
            environment = bubblewrap.environment(os.environ)
        try:
            done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=_TRIAL, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return str(error)
    if done.returncode == 0 and done.stdout == "confined\n":
        return ""
    return " ".join((done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]) or f"left with {done.returncode}"
