"""How much memory processes hold, as the kernel tells."""

import os
from pathlib import Path

_PAGE = os.sysconf("SC_PAGE_SIZE")


def resident_memory(pid: int) -> int:
    """[bytes] That a process holds, or one it has started if that holds more; 0 if it is gone.

    Not their sum: for a moment a process that is just being started shares all memory of its parent.
    """
    try:
        held = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * _PAGE
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    except (OSError, IndexError):
        return 0
    return max(held, *(resident_memory(int(child)) for child in children), 0)
