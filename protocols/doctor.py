"""What is installed here, what draws, and what is missing and how to get it."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from importlib import metadata
from types import ModuleType

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

# Nothing of musebot's is imported until it is looked at: the doctor must be well where a
# package is missing.

# What pyproject.toml asks for and has no look of its own below: a module to import, and the
# requirement.
_PACKAGES = {
    "dm-control": ("dm_control.suite.base", "dm-control>=1.0.50"),
    "numpy": ("numpy", "numpy>=2"),
    "scipy": ("scipy.stats", "scipy>=1.15"),
    "safetensors": ("safetensors.numpy", "safetensors"),
    "matplotlib": ("matplotlib.figure", "matplotlib"),
    "pillow": ("PIL.Image", "pillow"),
    "tyro": ("tyro", "tyro"),
    "rich": ("rich", "rich"),
}
EGL_REMEDY = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"
_PROBE_SECONDS = 120  # a first picture takes seconds where a processor draws; a hang must end


class _Missing(Exception):
    """Something needed is not there; the text says what, the remedy how to get it."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.remedy = remedy


@dataclasses.dataclass(frozen=True)
class Finding:
    """A line of the report.

    Attributes:
      name: of what was looked at.
      text: what was found.
      remedy: the command that gets what is missing; empty where nothing needed is.
      good: whether what is needed is there.
    """

    name: str
    text: str
    remedy: str = ""
    good: bool = True


def report() -> int:
    """Prints what was found.

    Returns:
      0 if everything that is needed is there, else 1.
    """
    findings = list(examine())
    table = Table(box=box.SIMPLE_HEAD, show_header=False, pad_edge=False)
    for finding in findings:
        mark = Text("ok", "green") if finding.good else Text("MISSING", "bold red")
        table.add_row(finding.name, mark, Text(finding.text))
    # Where the output is no terminal, width must not cut a command in two.
    console = Console() if sys.stdout.isatty() else Console(width=160)
    console.print(table)
    missing = [finding for finding in findings if not finding.good]
    for finding in missing:
        print(f"{finding.name} is missing; to get it: {finding.remedy}")
    if not missing:
        print("Everything that musebot needs is here.")
    return 1 if missing else 0


def examine() -> Iterable[Finding]:
    """Looks at one thing after another."""
    for name, look in _LOOKS.items():
        try:
            yield Finding(name, look())
        except _Missing as missing:
            yield Finding(name, str(missing), missing.remedy, good=False)


def _python() -> str:
    return f"{platform.python_version()} ({sys.executable})"


def _imported(module: str, package: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except Exception as error:  # a broken installation can raise anything
        raise _Missing(
            f"cannot be imported ({type(error).__name__}: {error})", f"pip install '{package}'"
        ) from error


def _mujoco() -> str:
    version = _imported("mujoco", "mujoco>=3.17,<3.18").__version__
    from ..models import check_versions

    try:
        check_versions()
    except ImportError as error:
        raise _Missing(str(error), "pip install 'mujoco>=3.17,<3.18'") from error
    return version


def _package(name: str) -> str:
    _imported(*_PACKAGES[name])
    return metadata.version(name)


def _torch() -> str:
    torch = _imported("torch", "torch>=2.6")
    return f"{torch.__version__}, {torch.get_num_threads()} threads (a run uses one a process)"


def _egl() -> str:
    if sys.platform != "linux":
        raise _Missing(f"no EGL on {sys.platform}", "make films on Linux")
    # In a process of its own: a driver's crash must not be ours.
    package = f"{__package__}.playback"
    environment = os.environ | {"MUJOCO_GL": "off"}
    try:
        done = subprocess.run(
            [sys.executable, "-m", f"{package}.offscreen"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
        )
    except subprocess.TimeoutExpired as error:
        raise _Missing(f"no picture within {_PROBE_SECONDS} s", EGL_REMEDY) from error
    if done.returncode < 0:
        raise _Missing(f"the driver crashed (signal {-done.returncode})", EGL_REMEDY)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no reason given"]
        raise _Missing(lines[-1], EGL_REMEDY)
    found = json.loads(done.stdout.splitlines()[-1])
    return f"{found['renderer']}, {found['ms']:.0f} ms a picture of 640 x 480"


def _ray() -> str:
    # Not needed but for clusters: never missing.
    try:
        return metadata.version("ray")
    except metadata.PackageNotFoundError:
        return "none, so no `musebot run --engine ray`; pip install 'musebot[cluster]' gets it"


def _display() -> str:
    # Not needed but for one verb: never missing.
    if sys.platform != "linux":
        return "as the system has it"
    names = [name for name in ("DISPLAY", "WAYLAND_DISPLAY") if os.environ.get(name)]
    found = ", ".join(f"{name}={os.environ[name]}" for name in names)
    return found or "none, so no `musebot explore`; `musebot film` works without"


def _ffmpeg() -> str:
    module = _imported("imageio_ffmpeg", "imageio-ffmpeg")
    try:
        return module.get_ffmpeg_version()
    except RuntimeError as error:
        remedy = "pip install --force-reinstall imageio-ffmpeg"
        raise _Missing(str(error), remedy) from error


def _cores() -> str:
    free = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    return f"{free} of {os.cpu_count()} for this process"


def _memory() -> str:
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        total, free = (page * os.sysconf(f"SC_{n}PHYS_PAGES") for n in ("", "AV"))
    except (ValueError, OSError, AttributeError):
        return "unknown"
    return f"{total / 2**30:.1f} GiB, {free / 2**30:.1f} of it free"


def _physics() -> str:
    try:
        from .. import tasks

        physics = tasks.load("arena", "wall_avoidance").physics
    except Exception as error:  # dm_control and MuJoCo that do not go together say it in many ways
        reason = f"the arena does not compile ({type(error).__name__}: {error})"
        raise _Missing(reason, "see mujoco and dm-control, above") from error
    import mujoco

    model, data = physics.model.ptr, physics.data.ptr
    data.ctrl[:] = 0.3, 0.5
    steps, times = 2000, []
    for _ in range(3):
        began = time.perf_counter()
        mujoco.mj_step(model, data, nstep=steps)
        times.append((time.perf_counter() - began) / steps)
    fastest = min(times)
    rate = model.opt.timestep / fastest
    return (
        f"{1e6 * fastest:.1f} \N{MICRO SIGN}s a step of the arena, {rate:,.0f} x real time a core"
    )


_LOOKS: dict[str, Callable[[], str]] = {
    "Python": _python,
    "mujoco": _mujoco,
    "torch": _torch,
    **{name: functools.partial(_package, name) for name in _PACKAGES},
    "ray": _ray,
    "EGL": _egl,
    "imageio-ffmpeg": _ffmpeg,
    "display": _display,
    "cores": _cores,
    "memory": _memory,
    "physics": _physics,
}
