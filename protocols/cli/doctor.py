"""`musebot doctor`: reports what is installed, what renders, what is missing, how to get it."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata

from packaging.requirements import Requirement

from ...extras import EGL_REMEDY
from ..errors import InputError, RunError
from ..machine import cores, machine_bytes
from ..terminal import say
from .options import option

# Musebot's own modules are imported by the check that needs them: the doctor must also work
# where a package is missing.

Probe = Callable[[], str]  # returns what was found, or raises Missing

_OPTIONAL = {  # package: extra of musebot, and what needs it
    "torch": ("brain", "robots that learn"),
    "numba": ("numba", "`musebot run --set backend=numba`"),
    "ray": ("cluster", "`musebot run --ray`"),
    "gymnasium": ("gym", "the Gymnasium interfaces"),
    "mujoco-warp": ("warp", "`musebot run --set physics=warp`"),
    "moviepy": ("gym", "Gymnasium's recorders of films"),
    "stable-baselines3": ("baselines", "training by PPO"),
    "tensorboard": ("tensorboard", "`musebot run --tensorboard`"),
}
_INSTALLATION = "install what the line names (docs/install.md)"
_PROBE_SECONDS = 120  # the first image takes seconds without a graphics card; a driver may hang


@dataclasses.dataclass
class Doctor:
    """Report what is installed, what renders, and what is missing and how to get it.

    With --agent, check instead that an agent obeys the interface; this takes seconds.
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
        elif report(all_probes()):
            raise RunError("something that musebot requires is missing here")

    def _check_agent(self, name: str) -> None:
        from ...controller.parameters import PROPOSERS
        from ..agents.contract import check_agent
        from ..runs.local import prepare_process

        if name in PROPOSERS:
            raise InputError(f"{name} is a proposer of the brain, not an agent")
        prepare_process()  # one thread of torch, as in a run
        broken = check_agent(name, self.set)
        for sentence in broken:
            say(sentence)
        if broken:
            raise RunError(f"{name} failed {len(broken)} checks")
        say(f"{name} passed all checks")


class Missing(Exception):
    """Something required is missing, or (mark "WARNING") something optional may fail."""

    def __init__(self, text: str, remedy: str, mark: str = "MISSING") -> None:
        super().__init__(text)
        self.remedy, self.mark = remedy, mark


def report(probes: Mapping[str, Probe]) -> int:
    """Prints each check when it is done, then remedies; returns the number of missing things."""
    missing, remedies = 0, []
    for name, probe in probes.items():
        mark = "ok"
        try:
            text = probe()
        except Missing as problem:
            text, mark = str(problem), problem.mark
            remedies.append(f"{name}: {text}. Remedy: {problem.remedy}")
            missing += mark == "MISSING"
        say(f"{name:18} {mark:8} {text}")
        if sys.stdout:
            sys.stdout.flush()
    for line in ("", *remedies, *(["Nothing that musebot requires is missing."] * (not missing))):
        say(line)
    return missing


def all_probes() -> dict[str, Probe]:
    """Returns every probe by its name, in the order of the report."""
    return {
        "Python": lambda: f"{platform.python_version()} ({sys.executable})",
        **package_probes(metadata.requires("musebot") or []),
        "EGL": _egl,
        "cores": lambda: f"{cores()} of {os.cpu_count()} for this process",
        "memory": lambda: f"{machine_bytes() / 2**30:.1f} GiB",
        "physics": _physics,
    }


def package_probes(lines: Iterable[str]) -> dict[str, Probe]:
    """Returns a probe for each required package, then for each optional one.

    Args:
      lines: Requirements in the form of PEP 508. Those for this platform and Python version are
        required if they have no extra, or if they have the extra `brain` and torch is installed. Of
        the rest, packages in `_OPTIONAL` are optional; others have no probe.
    """
    brain = "brain" if importlib.util.find_spec("torch") else ""
    probes: dict[str, Probe] = {}
    optional: dict[str, Probe] = {}
    for one in map(Requirement, lines):
        if one.marker is None or one.marker.evaluate({"extra": brain}):
            probes[one.name] = functools.partial(_package, one)
        elif one.name in _OPTIONAL:
            optional[one.name] = functools.partial(_package, one, *_OPTIONAL[one.name])
    return probes | {name: probe for name, probe in optional.items() if name not in probes}


def _package(requirement: Requirement, extra: str = "", use: str = "") -> str:
    """Returns the installed version of a package; `use`, what needs it, makes it optional."""
    extras = f"[{','.join(sorted(requirement.extras))}]" if requirement.extras else ""
    remedy = f"pip install '{requirement.name}{extras}{requirement.specifier}'"
    if use:
        remedy = f"pip install 'musebot[{extra}]'"
    try:
        version = metadata.version(requirement.name)
    except metadata.PackageNotFoundError as error:
        if use:
            return f"not installed, optional; for {use}: {remedy}"
        raise Missing("not installed", remedy) from error
    if not requirement.specifier.contains(version, prereleases=True):
        text = f"{f'for {use} its ' * bool(use)}version must be {requirement.specifier}"
        raise Missing(f"{text}, got {version}", remedy, "WARNING" if use else "MISSING")
    return version


def _egl() -> str:
    if sys.platform != "linux":
        raise Missing(f"no EGL on {sys.platform}", "make films on Linux")
    # In a process of its own, because a graphics driver can crash.
    words = [sys.executable, "-P", "-m", "musebot.protocols.pages.offscreen"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=_PROBE_SECONDS)
    except subprocess.TimeoutExpired as error:
        raise Missing(f"no image within {_PROBE_SECONDS} s", EGL_REMEDY) from error
    if done.returncode < 0:
        raise Missing(f"the driver crashed (signal {-done.returncode})", EGL_REMEDY)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        packages = "ModuleNotFoundError" in reason
        raise Missing(reason, _INSTALLATION if packages else EGL_REMEDY)
    return done.stdout.splitlines()[-1]


def _physics() -> str:
    try:
        from ... import tasks

        tasks.load("arena", "wall_avoidance")
    except Exception as error:  # incompatible versions of dm_control and MuJoCo raise anything
        reason = f"the arena does not compile ({type(error).__name__}: {error})"
        absent = isinstance(error, ImportError)
        remedy = _INSTALLATION if absent else "see mujoco and dm-control above"
        raise Missing(reason, remedy) from error
    return "the arena compiles"
