"""Cores and memory of this machine, or of the container around this process."""

from __future__ import annotations

import contextlib
import math
import os
import sys
from pathlib import Path


def cores() -> int:
    """Returns the number of cores that this process may use; a fraction counts as one."""
    count = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    with contextlib.suppress(OSError, ValueError):  # no limit is set
        quota, period = map(int, Path("/sys/fs/cgroup", "cpu.max").read_text().split())
        count = min(count, math.ceil(quota / period))
    return count


def machine_bytes() -> int:
    """Returns the memory of the machine or container in bytes."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        try:
            total = min(total, int(Path("/sys/fs/cgroup", name).read_text()))
        except (OSError, ValueError):  # no limit is set
            continue
    return total
