"""The system calls a confined worker may not make, as a seccomp filter."""

import errno
import os
from collections.abc import Iterator
from types import ModuleType

# clone(2): without it the new one is a process.
_CLONE_THREAD = 0x10000
# ioctl(2) that types into a terminal; and one that pastes into a console.
_TERMINAL_INPUT = (0x5412, 0x541C)

# Nothing harmless does these: the process is killed (SIGSYS).
_DEADLY = """
    execve execveat ptrace process_vm_readv process_vm_writev process_madvise kcmp
    pidfd_open pidfd_getfd pidfd_send_signal bpf perf_event_open userfaultfd
    io_uring_setup io_uring_enter io_uring_register
    mount umount2 pivot_root chroot move_mount open_tree fsopen fsconfig fsmount fspick mount_setattr unshare setns
    keyctl add_key request_key open_by_handle_at fanotify_init quotactl quotactl_fd lookup_dcookie nfsservctl
    kexec_load kexec_file_load init_module finit_module delete_module iopl ioperm modify_ldt vhangup syslog
    swapon swapoff reboot acct settimeofday clock_settime sethostname setdomainname
""".split()  # noqa: SIM905 - a list of words
# Libraries may try these and cope: they fail with EPERM. Landlock leaves out attributes of files, and sockets but TCP.
_REFUSED = """
    socket socketpair connect bind listen accept accept4 fork vfork tkill
    chmod fchmodat fchmodat2 chown fchown lchown fchownat utime utimes utimensat futimesat truncate
    setxattr lsetxattr fsetxattr removexattr lremovexattr fremovexattr
    mknod mknodat link linkat symlink symlinkat name_to_handle_at
    setuid setgid setreuid setregid setresuid setresgid setgroups setfsuid setfsgid personality
    setpriority ioprio_set sched_setaffinity sched_setscheduler sched_setparam sched_setattr move_pages migrate_pages
    shmget shmat msgget semget mq_open adjtimex clock_adjtime
""".split()  # noqa: SIM905 - a list of words
# Allowed to this very process only: the first argument says which.
_OF_OWN_PROCESS = ["kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo"]
# From the first on every machine has the same numbers (Linux 5.1). What the library has not heard of is newer than this
# list, and does not exist here either.
_SINCE, _UNTIL = 424, 512


def load_library() -> ModuleType:
    """Import pyseccomp. It starts a program to find its library, so it has to come before the filter."""
    import pyseccomp  # type: ignore[import-untyped] # noqa: PLC0415 - when needed, and where it is

    module: ModuleType = pyseccomp
    return module


def restrict() -> None:
    """Load the filter; it holds for this thread and those it starts, for ever. Raises OSError, ValueError."""
    seccomp = load_library()
    refused = seccomp.ERRNO(errno.EPERM)
    rules = seccomp.SyscallFilter(seccomp.ALLOW)
    for name in _known(seccomp, _DEADLY):
        rules.add_rule(seccomp.KILL_PROCESS, name)
    for name in _known(seccomp, _REFUSED):
        rules.add_rule(refused, name)
    for name in _known(seccomp, _OF_OWN_PROCESS):
        rules.add_rule(refused, name, seccomp.Arg(0, seccomp.NE, os.getpid()))
    rules.add_rule(refused, "prlimit64", seccomp.Arg(0, seccomp.NE, 0))
    rules.add_rule(refused, "clone", seccomp.Arg(0, seccomp.MASKED_EQ, _CLONE_THREAD, 0))
    # Its flags lie in memory, where a filter cannot look. Told that there is no such call, the C library uses clone.
    for number in (seccomp.resolve_syscall(seccomp.system_arch(), "clone3"), *_unknown(seccomp)):
        rules.add_rule(seccomp.ERRNO(errno.ENOSYS), number)
    for request in _TERMINAL_INPUT:
        rules.add_rule(refused, "ioctl", seccomp.Arg(1, seccomp.MASKED_EQ, 0xFFFFFFFF, request))
    rules.load()


def _known(seccomp: ModuleType, names: list[str]) -> list[str]:
    """Those that the installed library has heard of."""
    return [name for name in names if seccomp.resolve_syscall(seccomp.system_arch(), name) != -1]


def _unknown(seccomp: ModuleType) -> Iterator[int]:
    """Numbers of calls that it has not heard of."""
    for number in range(_SINCE, _UNTIL):
        try:
            seccomp.resolve_syscall(seccomp.system_arch(), number)
        except ValueError:
            yield number
