"""Shuts the worker process in before it opens a stage that is not trusted: Landlock for files, seccomp for calls.

Both bind the thread that asks for them and those it starts, so the process must have one thread only.
"""

import ctypes
import os
import resource
from pathlib import Path
from typing import TYPE_CHECKING

from footlight.worker.v1 import worker_pb2
from footlight_server.workers import syscalls
from footlight_server.workers.runtime import runtime_paths

if TYPE_CHECKING:
    from py_landlock import AccessFs

# [files] Crate files stay open while a stage is.
_OPEN_FILES = 4096
# [bytes] Above the largest image there can be: 2^28 pixels of 16 float32 channels.
_FILE_SIZE = 1 << 34
_CAPABILITY_VERSION_3 = 0x20080522


class ConfinementError(Exception):
    """This process cannot be shut in; it must not open the stage."""


def confine(confinement: worker_pb2.Confinement) -> None:
    """From here on this process reaches only what it runs on and what `confinement` names. Raises ConfinementError."""
    threads = len(os.listdir("/proc/self/task"))  # noqa: PTH208 - numbers, not paths
    if threads != 1:
        raise ConfinementError(f"the worker has {threads} threads, of which one would be confined")
    try:
        syscalls.load_library()
        _seal_limits()
        if not confinement.outside:
            _restrict_files(confinement)
        _drop_capabilities()
        syscalls.restrict()
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        raise ConfinementError(f"the worker cannot be confined: {error}") from error


def _restrict_files(confinement: worker_pb2.Confinement) -> None:
    from py_landlock import AccessFs, Landlock, LandlockError  # noqa: PLC0415 - on machines that have it, when needed

    read = AccessFs.READ_FILE | AccessFs.READ_DIR
    make = AccessFs.MAKE_REG | AccessFs.MAKE_DIR | AccessFs.REMOVE_FILE
    write = read | make | AccessFs.WRITE_FILE | AccessFs.TRUNCATE
    try:
        # Not strict: what a kernel cannot restrict is left to the filter of system calls.
        rules = Landlock(strict=False)
        for path in (*runtime_paths(), *map(Path, confinement.read_paths)):
            rules.add_path_rule(path, access=_fitting(path, read))
        for path in map(Path, confinement.write_paths):
            rules.add_path_rule(path, access=_fitting(path, write))
        rules.apply()
    except LandlockError as error:
        raise ConfinementError(f"the worker cannot be confined by Landlock: {error}") from error


def _fitting(path: Path, access: "AccessFs") -> "AccessFs":
    from py_landlock import AccessFs  # noqa: PLC0415

    return access if path.is_dir() else access & (AccessFs.READ_FILE | AccessFs.WRITE_FILE | AccessFs.TRUNCATE)


def _seal_limits() -> None:
    """Limits that it cannot raise again."""
    data, _ = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (data, data))
    for which, most in ((resource.RLIMIT_NOFILE, _OPEN_FILES), (resource.RLIMIT_FSIZE, _FILE_SIZE)):
        _, hard = resource.getrlimit(which)
        limit = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(which, (limit, limit))


def _drop_capabilities() -> None:
    """A server that runs as root has no root for a worker. capset(2), version 3: two sets of three 32-bit words."""
    libc = ctypes.CDLL(None, use_errno=True)
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION_3, 0)
    if libc.capset(header, (ctypes.c_uint32 * 6)()) != 0:
        raise OSError(ctypes.get_errno(), "capset")
