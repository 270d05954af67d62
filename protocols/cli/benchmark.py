"""`musebot benchmark`: tunes, simulates and compares learners, and trains a policy by PPO."""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path
from typing import ClassVar

from ..terminal import show_markdown
from .options import argument, executor, option

_OUT = "folder of the files; what is unfinished continues"
_HOW = "how it is computed"
_RAW = "paper, or raw: smell and reward before they saturate (raw)"
_TUNED = "folders of `musebot benchmark tune` (none)"
_SCALE = "factor on every duration, in (0, 1] (1)"


class _Conducted:
    """A command that conducts a study; its options include the study's fields.

    Attributes:
      study: Name of a module in `compare`, and name of the study's class in it.
    """

    study: ClassVar[tuple[str, str]]

    def __call__(self) -> None:
        """Does the remaining work of the study, and prints the study's page."""
        from ..compare.study import conduct

        module, name = self.study
        study = getattr(importlib.import_module(f"..compare.{module}", __package__), name)
        given = vars(self)
        how = ("out", "processes", "ray")
        options = {name: value for name, value in given.items() if name not in how and value != ()}
        chosen = study(**options)
        workers = executor(given.get("processes"), given.get("ray"))
        show_markdown(conduct(chosen, given["out"], workers).markdown)


@dataclasses.dataclass
class Run(_Conducted):
    """Simulate learners with their tuned settings in lives whose world changes; compare them.

    Each learner has one run in each life, with newborns in each world that returns. Learners and
    lives can be added later.
    """

    study = "benchmark", "Benchmark"

    out: Path = argument(_OUT, "OUT")
    life: tuple[str, ...] = option(
        (), "lives that change: body, drift, tasks, senses (body, tasks, drift)", "LIFE"
    )
    agent: tuple[str, ...] = option(
        (), "learners: paper, steady, or of `musebot list agents` (all)", "NAME"
    )
    tuned: tuple[Path, ...] = option((), _TUNED, "FOLDER")
    set: tuple[str, ...] = option((), "other settings, as dqn.rate=0.001", "AGENT.NAME=X")
    signals: str = option("raw", _RAW, "NAME")
    body: str = option("kinematic", "mujoco or kinematic (kinematic)", "NAME")
    robots: int = option(60, "robots of each learner: up to 60 or a multiple; MuJoCo: 30 (60)", "N")
    seed: int = option(61010, "seed of all random streams (61010)", "N")
    time_scale: float = option(1.0, _SCALE, "X")
    backend: str = option(
        "torch", "torch, or numba: simulator and paper's brain compiled (torch)", "NAME", group=_HOW
    )
    processes: int | None = option(None, "processes of this machine (its cores)", "N", group=_HOW)
    ray: str | None = option(None, "Ray cluster instead", "HOST:PORT", group=_HOW)


@dataclasses.dataclass
class Tune(_Conducted):
    """Tune an agent's settings in the kinematic simulator, with equal effort for each agent.

    The first trial has the defaults, the others a Sobol sequence over the ranges. Half the robots
    of each trial are simulated; then the best trials are simulated again, with all robots and
    another seed. A robot's value is its share of time at the goal while it learns; in a life with
    tests, it is the mean of this share and that in the test after training.
    """

    study = "tune", "Tune"

    out: Path = argument(_OUT, "OUT")
    agent: str = option(
        dataclasses.MISSING, "`musebot list agents`, or package.module:factory", "AGENT"
    )
    signals: str = option("raw", _RAW, "NAME")
    life: str = option("spot_finding", "life of all robots (spot_finding)", "LIFE")
    trials: int = option(16, "number of settings that are tried (16)", "N")
    kept: int = option(4, "number of settings that are simulated again (4)", "N")
    robots: int = option(20, "robots of a trial in round two; half in round one (20)", "N")
    seed: int = option(32001, "seed of round one; round two has the next (32001)", "N")
    time_scale: float = option(1.0, _SCALE, "X")
    processes: int | None = option(None, "processes of this machine (its cores)", "N", group=_HOW)
    ray: str | None = option(None, "Ray cluster instead", "HOST:PORT", group=_HOW)


@dataclasses.dataclass
class PPO(_Conducted):
    """Train a policy by PPO on any task.

    Writes OUT/policy.safetensors, which can drive a robot in films and in the window. Needs
    Stable-Baselines3.
    """

    study = "ppo", "PPOTraining"

    out: Path = argument(_OUT, "OUT")
    task: str = option(dataclasses.MISSING, "task that `musebot list tasks` prints", "TASK")
    steps: int = option(
        327_680, "control steps of 16 robots together, a multiple of 4096 (327680)", "N"
    )
    seed: int = option(0, "seed of the policy, its exploration and its episodes (0)", "N")
