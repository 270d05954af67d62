"""Checks of the installation: versions, rendering, hardware, and the remedy for what is missing."""

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
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import metadata

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from ..errors import EGL_REMEDY
from ..machine import cores, machine_bytes
from ..terminal import say

# Musebot's own modules are imported by the check that needs them: the doctor must also work
# where a package is missing.

Probe = Callable[[], str]  # returns what was found, or raises Missing
_WIDTH = 18  # of the column of names

# Modules of other names, and modules that load a package's compiled part.
_MODULES = {
    "absl-py": "absl",
    "dm-control": "dm_control.suite.base",
    "dm-tree": "tree",
    "matplotlib": "matplotlib.figure",
    "pyyaml": "yaml",
    "pillow": "PIL.Image",
    "protobuf": "google.protobuf",
    "pyopengl": "OpenGL",
    "safetensors": "safetensors.numpy",
    "scipy": "scipy.stats",
}
_OPTIONAL = {  # package: extra of musebot, and what needs it
    "cmaes": ("evolve", "`musebot study evolve`"),
    "ray": ("cluster", "`musebot run --engine ray`"),
    "gymnasium": ("gym", "the Gymnasium interfaces"),
    "mujoco-warp": ("warp", "`musebot run --physics warp`"),
    "moviepy": ("gym", "Gymnasium's recorders of films"),
    "stable-baselines3": ("baselines", "training by PPO"),
    "tensorboard": ("tensorboard", "`musebot run --log tensorboard`"),
}
# Seen with CUDA builds of torch and Mesa's EGL (`models.rendering.load_triton`).
_TORCH_AFTER_EGL = """
import mujoco.egl
context = mujoco.egl.GLContext(64, 64)
context.make_current()
import torch._dynamo
"""
_INSTALLATION = "install what the line names (docs/install.md)"
_PROBE_SECONDS = 120  # the first image takes seconds without a graphics card; a hang must end


class Missing(Exception):
    """Something required is missing.

    Attributes:
      remedy: Command that installs it.
    """

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.remedy = remedy


class Fragile(Missing):
    """Nothing is missing, but something fails unless the remedy is followed."""


@dataclasses.dataclass(frozen=True)
class Check:
    """A line of the report.

    Attributes:
      name: Name of what was checked.
      text: Description of what was found.
      remedy: Command that installs what is missing, or what helps against a failure; or empty.
      passed: Whether nothing required is missing.
    """

    name: str
    text: str
    remedy: str = ""
    passed: bool = True


def report(probes: Mapping[str, Probe] | None = None) -> int:
    """Prints each check as soon as it is done.

    Args:
      probes: Functions that check one thing each, by name; None for all checks.

    Returns:
      Exit status: 0 if nothing required is missing, else 1.
    """
    checks = []
    for check in examine(all_probes() if probes is None else probes):
        checks.append(check)
        mark = "ok" if check.passed else "MISSING"
        if check.passed and check.remedy:
            mark = "WARNING"
        say(f"{check.name:{_WIDTH}} {mark:8} {check.text}")
        if sys.stdout:
            sys.stdout.flush()
    say("")
    for check in checks:
        if check.remedy:
            say(f"{check.name}: {check.text}. Remedy: {check.remedy}")
    if all(check.passed for check in checks):
        say("Nothing that musebot requires is missing.")
        return 0
    return 1


def examine(probes: Mapping[str, Probe]) -> Iterator[Check]:
    """Runs one probe after another."""
    for name, probe in probes.items():
        try:
            yield Check(name, probe())
        except Missing as missing:
            passed = isinstance(missing, Fragile)
            yield Check(name, str(missing), missing.remedy, passed)


def all_probes() -> dict[str, Probe]:
    """Returns every probe by its name, in the order of the report."""
    lines = _requirements()
    packages = {"musebot": _not_installed} if lines is None else package_probes(lines)
    return {
        "Python": _python,
        **packages,
        **{name: functools.partial(_optional, name) for name in _OPTIONAL},
        "EGL": _egl,
        "torch after EGL": _torch_after_egl,
        "display": _display,
        "cores": _cores,
        "memory": _memory,
        "physics": _physics,
    }


def package_probes(lines: Iterable[str]) -> dict[str, Probe]:
    """Returns a probe for each required package.

    Args:
      lines: Requirements in the form of PEP 508. Those of extras other than `brain`, and of other
        platforms and Python versions, are left out.
    """
    requirements = [Requirement(line) for line in lines]
    return {
        requirement.name: functools.partial(_package, requirement)
        for requirement in requirements
        if requirement.marker is None or requirement.marker.evaluate({"extra": "brain"})
    }


def _not_installed() -> str:
    raise Missing("not installed, so its requirements are unknown", "pip install -e .")


def _python() -> str:
    return f"{platform.python_version()} ({sys.executable})"


def _package(requirement: Requirement) -> str:
    extras = f"[{','.join(sorted(requirement.extras))}]" if requirement.extras else ""
    remedy = f"pip install '{requirement.name}{extras}{requirement.specifier}'"
    name = canonicalize_name(requirement.name)
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError as error:
        raise Missing("not installed", remedy) from error
    if not requirement.specifier.contains(version, prereleases=True):
        raise Missing(f"version must be {requirement.specifier}, got {version}", remedy)
    try:
        importlib.import_module(_MODULES.get(name, name.replace("-", "_")))
    except Exception as error:  # a broken installation can raise anything
        reason = f"cannot be imported ({type(error).__name__}: {error})"
        raise Missing(reason, f"{remedy} --force-reinstall") from error
    details = _DETAILS.get(name)
    return details(version, remedy) if details else version


def _mujoco(version: str, remedy: str) -> str:
    from ...models import check_versions

    try:
        check_versions()
    except ImportError as error:
        raise Missing(str(error), remedy) from error
    return version


def _torch(version: str, remedy: str) -> str:
    import torch

    return f"{version}, {torch.get_num_threads()} threads (a run uses one a process)"


def _ffmpeg(version: str, remedy: str) -> str:
    import imageio_ffmpeg

    try:
        return f"{version}, ffmpeg {imageio_ffmpeg.get_ffmpeg_version()}"
    except RuntimeError as error:
        raise Missing(str(error), f"{remedy} --force-reinstall") from error


_DETAILS = {"mujoco": _mujoco, "torch": _torch, "imageio-ffmpeg": _ffmpeg}


def _optional(name: str) -> str:
    extra, use = _OPTIONAL[name]
    remedy = f"pip install 'musebot[{extra}]'"
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return f"not installed, optional; for {use}: {remedy}"
    for one in map(Requirement, _requirements() or ()):
        if one.name == name and not one.specifier.contains(version, prereleases=True):
            raise Fragile(f"for {use} its version must be {one.specifier}, got {version}", remedy)
    return version


def _requirements() -> list[str] | None:
    """Returns the requirements of musebot and its extras; None if it is not installed."""
    try:
        return metadata.requires("musebot") or []
    except metadata.PackageNotFoundError:
        return None


def _egl() -> str:
    if sys.platform != "linux":
        raise Missing(f"no EGL on {sys.platform}", "make films on Linux")
    done = _child(["-m", "musebot.protocols.pages.offscreen"])
    if done.returncode < 0:
        raise Missing(f"the driver crashed (signal {-done.returncode})", EGL_REMEDY)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no reason given"]
        packages = "ModuleNotFoundError" in lines[-1]
        raise Missing(lines[-1], _INSTALLATION if packages else EGL_REMEDY)
    found = json.loads(done.stdout.splitlines()[-1])
    return f"{found['renderer']}, {found['ms']:.0f} ms an image of 640 x 480"


def _torch_after_egl() -> str:
    done = _child(["-c", _TORCH_AFTER_EGL])
    if done.returncode < 0:
        raise Fragile(
            f"importing torch._dynamo after another program's picture crashes (signal "
            f"{-done.returncode}); after musebot's it does not",
            "import triton before the first picture, or install a CPU build of torch",
        )
    return "no crash" if done.returncode == 0 else "not tested, because EGL or torch is missing"


def _child(arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """Runs Python in a process of its own, because a graphics driver can crash."""
    try:
        return subprocess.run(
            [sys.executable, *arguments],
            env=os.environ | {"MUJOCO_GL": "off"},
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
        )
    except subprocess.TimeoutExpired as error:
        raise Missing(f"no image within {_PROBE_SECONDS} s", EGL_REMEDY) from error


def _display() -> str:
    # Never missing: only one verb needs it.
    if sys.platform != "linux":
        return "provided by the system"
    names = [name for name in ("DISPLAY", "WAYLAND_DISPLAY") if os.environ.get(name)]
    found = ", ".join(f"{name}={os.environ[name]}" for name in names)
    return found or "none: `musebot explore` needs one, `musebot film` does not"


def _cores() -> str:
    return f"{cores()} of {os.cpu_count()} for this process"


def _memory() -> str:
    try:
        return f"{machine_bytes() / 2**30:.1f} GiB"
    except (ValueError, OSError, AttributeError):
        return "unknown"


def _physics() -> str:
    try:
        from ... import tasks

        physics = tasks.load("arena", "wall_avoidance").physics
    except Exception as error:  # incompatible versions of dm_control and MuJoCo raise anything
        reason = f"the arena does not compile ({type(error).__name__}: {error})"
        absent = isinstance(error, ImportError)
        remedy = _INSTALLATION if absent else "see mujoco and dm-control above"
        raise Missing(reason, remedy) from error
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
