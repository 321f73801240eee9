"""What a worker process may use: its environment, and limits it sets on itself before it reads a stage."""

import ctypes
import os
import resource
import signal
from collections.abc import Mapping
from pathlib import Path

_PR_SET_PDEATHSIG = 1
# What a worker needs to know of the machine. USD's own variables (PXR_PLUGINPATH_NAME, PXR_AR_DEFAULT_SEARCH_PATH,
# TF_*), PYTHONPATH and LD_* would let the surroundings decide what code and which files a stage reaches.
_KEPT = ("FOOTLIGHT_INSTRUCTION_SET", "HOME", "LANG", "LC_ALL", "LC_CTYPE", "OCIO", "PATH", "TMPDIR", "TZ")


def worker_environment(surroundings: Mapping[str, str]) -> dict[str, str]:
    """The environment of a worker process."""
    kept = {name: surroundings[name] for name in _KEPT if name in surroundings}
    # Maps of crate files turn into SIGBUS when a file is truncated while open; reads turn into errors. OpenBLAS would
    # start threads when it is loaded: no matrix here is large enough for them, and confinement has to begin with one.
    return kept | {"USDC_USE_PREAD": "1", "OPENBLAS_NUM_THREADS": "1"}


def die_with_parent() -> None:
    """Have the kernel kill this process when the server ends, however it does."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def set_limits(memory_bytes: int, cpu_seconds: int) -> None:
    """Limit private memory and CPU time (SIGXCPU), both from now on, and core files. 0: no limit.

    RLIMIT_DATA and not RLIMIT_AS: of address space a process with threads reserves gigabytes that it never touches.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory_bytes:
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        limit = private_memory() + memory_bytes
        limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    if cpu_seconds:
        used = resource.getrusage(resource.RUSAGE_SELF)
        soft = int(used.ru_utime + used.ru_stime) + cpu_seconds
        resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.RLIM_INFINITY))


def lift_cpu_limit() -> None:
    """Rendering may take as long as it takes."""
    resource.setrlimit(resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def physical_memory() -> int:
    """[bytes] Of the machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def private_memory() -> int:
    """[bytes] Of private writable memory that this process has mapped, touched or not: what RLIMIT_DATA counts."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5]) * resource.getpagesize()


def peak_memory() -> int:
    """[bytes] The most this process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
