"""The study that tunes a learner: successive halving of settings, equal effort for each learner.

K. Jamieson and A. Talwalkar, "Non-stochastic Best Arm Identification and Hyperparameter
Optimization", AISTATS 2016.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from scipy.stats import qmc

from ....models import Kinematics
from ...agents.factory import factory_of
from ...agents.names import recorded_name, short_name
from ...agents.settings import Setting, settings_of
from ...agents.trust import trust
from ...analysis import intervals
from ...errors import InputError
from ...experiment.budget import check_memory
from ...experiment.conditions import PAPER_TASKS, Condition
from ...experiment.experiment import Experiment, Signals
from ...experiment.overrides import with_overrides
from ...experiment.plan import Plan
from ...reporting.markdown import bracket, table
from ...shared_options import KinematicsOption, option
from ...simulation.jobs import Job
from ...storage import resolved
from ..evolve.evaluation import EvaluationJob
from ..study import Page, Study, check_positive

FOLDER = "trials"
_EARLY = 0.25  # factor on the durations of the first round
_MOST = 1024  # trials


@dataclasses.dataclass(frozen=True)
class Trial:
    """Settings of a learner that are tried.

    Attributes:
      number: Number of the trial; 0 has the defaults.
      settings: Values that differ from the defaults, as NAME=VALUE.
    """

    number: int
    settings: tuple[str, ...]


@dataclasses.dataclass
class Tune(Study):
    """Tune an agent's settings in the kinematic simulator, with equal effort for each.

    The first trial has the defaults, the others a Sobol sequence over the ranges. All live a
    quarter of the paper's durations, and settings that count steps of a life are a quarter too; the
    best live whole lives on a fresh seed. A trial's value is the mean over both tasks of the share
    of time in the spot, or without contact, after training.
    """

    name: ClassVar[str] = "tune"

    agent: Annotated[str, option("AGENT", "required")] = ""
    """name of the agent, or a factory of yours as package.module:factory"""
    signals: Signals = "paper"
    """raw: smell and reward before they saturate"""
    trials: int = 16
    """number of settings that are tried"""
    kept: int = 4
    """number of settings that live whole lives"""
    robots: int = 20
    """number of robots of a trial in each task"""
    seed: int = 32001
    """seed of the first round; the second round has the next one"""
    kinematics: KinematicsOption = ("felt=pushed", "wall=turns", "lag=0.08")
    """parameters of the kinematic simulator"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`: the experiment of whole lives."""
        _ = self.settings
        whole = self._round(1, ())
        check_memory(Plan.of(whole, self._conditions, self.robots))
        return {"whole": whole}

    @functools.cached_property
    def settings(self) -> Mapping[str, Setting]:
        """The settings that are tuned, by name.

        Raises:
          InputError: an option is invalid, or the agent has no settings.
        """
        check_positive(_MOST, trials=self.trials, kept=self.kept)
        check_positive(robots=self.robots)
        if self.kept > self.trials:
            raise InputError(f"kept must be at most trials, {self.trials}, got {self.kept}")
        if not self.agent:
            raise InputError("the study needs the name of an agent: --agent AGENT")
        name = recorded_name(self.agent)
        trust(name)
        if Condition(PAPER_TASKS[0], name).has_brain:
            raise InputError(f"{name} is a proposer of the brain: `musebot study evolve` tunes it")
        tuned = {n: s for n, s in settings_of(factory_of(name)).items() if s.tuned}
        if not tuned:
            raise InputError(f"{self.agent} has no settings to tune")
        return tuned

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`."""
        drawn = [list(trial.settings) for trial in self.drawn()]
        return {"agent": recorded_name(self.agent), "kept": self.kept, "trials": drawn}

    def drawn(self) -> list[Trial]:
        """Returns all trials, the defaults first."""
        sobol = qmc.Sobol(len(self.settings), rng=np.random.default_rng(self.seed))
        points = sobol.random(1 << (self.trials - 1).bit_length())[: self.trials]
        trials = [Trial(0, ())]
        for number, point in enumerate(points[1:], 1):
            words = (
                f"{name}={setting.at(float(share))}"
                for (name, setting), share in zip(self.settings.items(), point, strict=True)
            )
            trials.append(Trial(number, tuple(words)))
        return trials

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / FOLDER]

    def check(self, out: Path) -> None:
        """See `Study.check`: reads the files of all jobs."""
        self.ranked(out)

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: all trials for a quarter of the time, then the best."""
        yield [job for trial in self.drawn() for job in self._jobs(out, 0, trial)]
        yield [job for trial in self._best(out) for job in self._jobs(out, 1, trial)]

    def ranked(self, out: Path) -> list[tuple[Trial, np.ndarray, np.ndarray | None]]:
        """Returns the finished trials, best first, with each robot's values in both rounds.

        Values have the shape (tasks, robots); None where a trial has no second round yet.
        """
        found = []
        for trial in self.drawn():
            early = self._values(self._jobs(out, 0, trial))
            if early is not None:
                found.append((trial, early, self._values(self._jobs(out, 1, trial))))
        return sorted(
            found,
            key=lambda one: (-_mean_or_least(one[2]), -float(one[1].mean()), one[0].number),
        )

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        ranked = self.ranked(out)
        rows = [["trial", *self.settings, "a quarter", "whole lives", *PAPER_TASKS]]
        for trial, early, whole in ranked:
            values = {n: s.default for n, s in self.settings.items()}
            values |= {word.partition("=")[0]: word.partition("=")[2] for word in trial.settings}
            rows.append(
                [
                    str(trial.number),
                    *map(str, values.values()),
                    f"{early.mean():.3f}",
                    *_cells(whole),
                ]
            )
        winner, name = ranked[0][0], short_name(recorded_name(self.agent))
        chosen = f" --agent-set {' '.join(winner.settings)}" if winner.settings else ""
        lines = [
            f"## {name}, {self.signals} signals",
            "",
            *table(rows),
            "",
            "Value of a trial: mean over both tasks of the share of time in the spot, or without "
            f"contact, in the test after training; {self.robots} robots a task. The columns of "
            "the tasks belong to whole lives; brackets hold 95 % intervals over robots. The best "
            "of several trials was also lucky: only runs on other seeds measure it.",
            "",
            f"Best: trial {winner.number}, `musebot run OUT --agent {name}{chosen} --signals "
            f"{self.signals}`",
            "",
        ]
        return Page("\n".join(lines))

    @property
    def _conditions(self) -> list[Condition]:
        return [Condition(task, recorded_name(self.agent)) for task in PAPER_TASKS]

    def _round(self, number: int, settings: tuple[str, ...]) -> Experiment:
        if number == 0:
            factory = factory_of(recorded_name(self.agent))
            settings += tuple(
                f"{name}={setting.shortened(_EARLY):g}"
                for name, setting in settings_of(factory).items()
                if setting.duration
            )
        return Experiment(
            seed=self.seed + number,
            cohort_size=self.robots,
            time_scale=self.time_scale * (1.0 if number else _EARLY),
            body="kinematic",
            kinematics=with_overrides(Kinematics(), self.kinematics),
            signals=self.signals,
            settings=settings,
        )

    def _jobs(self, out: Path, number: int, trial: Trial) -> list[EvaluationJob]:
        experiment = self._round(number, trial.settings)
        return [
            EvaluationJob(
                resolved(out) / FOLDER / f"{trial.number:04}-{number}-{c.task}.safetensors",
                experiment,
                c,
            )
            for c in self._conditions
        ]

    def _best(self, out: Path) -> list[Trial]:
        early = [
            (float(values.mean()), trial)
            for trial in self.drawn()
            if (values := self._values(self._jobs(out, 0, trial))) is not None
        ]
        return [trial for _, trial in sorted(early, key=lambda one: -one[0])[: self.kept]]

    def _values(self, jobs: Sequence[EvaluationJob]) -> np.ndarray | None:
        """Returns the value of each robot, shape (tasks, robots); None if a job is not done."""
        if not all(job.done() for job in jobs):
            return None
        values = []
        for job in jobs:
            wanted = job.experiment.schedule(job.condition.task).wanted
            values.append(job.shares() if wanted else 1 - job.shares())
        return np.array(values)


def _mean_or_least(values: np.ndarray | None) -> float:
    """Returns the mean of values; minus infinity for none."""
    return -np.inf if values is None else float(values.mean())


def _cells(whole: np.ndarray | None) -> list[str]:
    if whole is None:
        return ["-"] * (1 + len(PAPER_TASKS))
    means = [
        f"{task.mean():.3f} {bracket(intervals.mean(task, intervals.SHARE))}".strip()
        for task in whole
    ]
    return [f"{whole.mean():.3f}", *means]
