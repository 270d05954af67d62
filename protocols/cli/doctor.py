"""`musebot doctor`: what is installed here, what renders, what is missing, and how to get it."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import importlib.util
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from ..errors import EGL_REMEDY, InputError, RunError
from ..machine import cores, machine_bytes
from ..terminal import say
from .options import option

# Musebot's own modules are imported by the check that needs them: the doctor must also work
# where a package is missing.

Probe = Callable[[], str]  # returns what was found, or raises Missing

# Modules of other names, and modules that load a package's compiled part.
_MODULES = {
    "absl-py": "absl",
    "dm-control": "dm_control.suite.base",
    "dm-tree": "tree",
    "markdown-it-py": "markdown_it",
    "matplotlib": "matplotlib.figure",
    "pillow": "PIL.Image",
    "protobuf": "google.protobuf",
    "pyopengl": "OpenGL",
    "safetensors": "safetensors.numpy",
    "scipy": "scipy.stats",
}
_OPTIONAL = {  # package: extra of musebot, and what needs it
    "torch": ("brain", "robots that learn"),
    "ray": ("cluster", "`musebot run --ray`"),
    "gymnasium": ("gym", "the Gymnasium interfaces"),
    "mujoco-warp": ("warp", "`musebot run --set physics=warp`"),
    "moviepy": ("gym", "Gymnasium's recorders of films"),
    "stable-baselines3": ("baselines", "training by PPO"),
    "tensorboard": ("tensorboard", "`musebot run --tensorboard`"),
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


@dataclasses.dataclass
class Doctor:
    """Report what is installed, what renders, and what is missing and how to get it.

    With --agent, check instead that an agent keeps to the interface; that takes seconds.
    """

    agent: str | None = option(
        None, "a name that `musebot list agents` prints, or package.module:factory", "AGENT"
    )
    set: tuple[str, ...] = option((), "settings of the agent to change", "NAME=VALUE")

    def __call__(self) -> None:
        """Prints a line for each check.

        Raises:
          InputError: the agent cannot be made.
          RunError: something is missing, or the agent fails a check.
        """
        if self.agent is not None:
            self._check_agent(self.agent)
        elif self.set:
            raise InputError("--set changes settings of the agent: it needs --agent")
        elif report():
            raise RunError("something that musebot requires is missing here")

    def _check_agent(self, name: str) -> None:
        from ...controller.parameters import PROPOSERS
        from ..agents.contract import check_agent
        from ..lives.local import prepare_process

        if name in PROPOSERS:
            raise InputError(f"{name} is a proposer of the brain, not an agent")
        prepare_process()  # one thread of torch, as in a run
        broken = check_agent(name, self.set)
        for sentence in broken:
            say(sentence)
        if broken:
            raise RunError(f"{name} broke {len(broken)} laws of agents")
        say(f"{name} passed all checks")


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


def report(probes: Mapping[str, Probe] | None = None) -> int:
    """Prints each check as soon as it is done, and in the end the remedies.

    Args:
      probes: Functions that check one thing each, by name; None for all checks.

    Returns:
      Number of required things that are missing.
    """
    missing, remedies = 0, []
    for name, probe in (all_probes() if probes is None else probes).items():
        mark = "ok"
        try:
            text = probe()
        except Missing as problem:
            text = str(problem)
            remedies.append(f"{name}: {text}. Remedy: {problem.remedy}")
            mark = "WARNING" if isinstance(problem, Fragile) else "MISSING"
            missing += mark == "MISSING"
        say(f"{name:18} {mark:8} {text}")
        if sys.stdout:
            sys.stdout.flush()
    say("")
    for remedy in remedies:
        say(remedy)
    if not missing:
        say("Nothing that musebot requires is missing.")
    return missing


def all_probes() -> dict[str, Probe]:
    """Returns every probe by its name, in the order of the report."""
    try:
        packages = package_probes(metadata.requires("musebot") or [])
    except metadata.PackageNotFoundError:
        packages = {"musebot": _not_installed}
    return {
        "Python": lambda: f"{platform.python_version()} ({sys.executable})",
        **packages,
        **{name: functools.partial(_optional, name) for name in _OPTIONAL if name not in packages},
        "EGL": _egl,
        "torch after EGL": _torch_after_egl,
        "display": _display,
        "cores": lambda: f"{cores()} of {os.cpu_count()} for this process",
        "memory": lambda: f"{machine_bytes() / 2**30:.1f} GiB",
        "physics": _physics,
    }


def package_probes(lines: Iterable[str]) -> dict[str, Probe]:
    """Returns a probe for each required package.

    Args:
      lines: Requirements in the form of PEP 508. Those of other platforms and Python versions, and
        of extras, are left out; those of the extra `brain` count where torch is installed.
    """
    extra = "brain" if importlib.util.find_spec("torch") else ""
    return {
        one.name: functools.partial(_package, one)
        for one in map(Requirement, lines)
        if one.marker is None or one.marker.evaluate({"extra": extra})
    }


def _not_installed() -> str:
    raise Missing("not installed, so its requirements are unknown", "pip install -e .")


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
        details = _DETAILS.get(name)
        return details(version) if details else version
    except Exception as error:  # a broken installation can raise anything
        reason = f"cannot be used ({type(error).__name__}: {error})"
        raise Missing(reason, f"{remedy} --force-reinstall") from error


def _mujoco(version: str) -> str:
    from ...models import check_versions

    check_versions()
    return version


def _torch(version: str) -> str:
    import torch

    return f"{version}, {torch.get_num_threads()} threads (a run uses one a process)"


def _ffmpeg(version: str) -> str:
    import imageio_ffmpeg

    return f"{version}, ffmpeg {imageio_ffmpeg.get_ffmpeg_version()}"


_DETAILS = {"mujoco": _mujoco, "torch": _torch, "imageio-ffmpeg": _ffmpeg}


def _optional(name: str) -> str:
    extra, use = _OPTIONAL[name]
    remedy = f"pip install 'musebot[{extra}]'"
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return f"not installed, optional; for {use}: {remedy}"
    for one in map(Requirement, metadata.requires("musebot") or ()):
        if one.name == name and not one.specifier.contains(version, prereleases=True):
            raise Fragile(f"for {use} its version must be {one.specifier}, got {version}", remedy)
    return version


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
    rate = model.opt.timestep / min(times)
    return f"{1e6 * min(times):.1f} us a step of the arena, {rate:,.0f} x real time a core"
