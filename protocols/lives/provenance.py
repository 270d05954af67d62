"""Which versions, commit and processor a result was made with."""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

from ... import __version__

_REQUIRED = ("mujoco", "dm-control", "numpy", "scipy", "torch")  # those that compute results


def machine() -> dict[str, Any]:
    """Returns the versions, the processor and the system of this process, for JSON."""
    return {
        "python": platform.python_version(),
        "musebot": __version__,
        "commit": _commit(),
        **{name: metadata.version(name) for name in _REQUIRED},
        **_versions("mujoco-warp", "warp-lang", "cmaes"),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "platform": platform.platform(),
    }


def _versions(*names: str) -> dict[str, str]:
    """Returns the versions of those optional packages that are installed."""
    found = {}
    for name in names:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


@functools.cache
def _commit() -> str | None:
    """Returns the commit of this package, with "-dirty" if files differ; None without Git."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():  # an installed copy, perhaps inside another repository
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        found = subprocess.run(
            command, cwd=root, capture_output=True, text=True, check=True, timeout=10
        )
        return found.stdout.strip() or None
    return None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()
