"""The study that tunes a learner: successive halving of settings, equal effort for each learner.

K. Jamieson and A. Talwalkar, "Non-stochastic Best Arm Identification and Hyperparameter
Optimization", AISTATS 2016.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
import tyro
from scipy.stats import qmc

from ...controller.parameters import shown
from ...models import Kinematics
from ..agents.factory import factory_of
from ..agents.names import name_in_track, recorded_name, short_name
from ..agents.settings import Setting, settings_of
from ..agents.trust import trust
from ..analysis import intervals
from ..cli.shared_options import BODY_EFFECTS, TASK_CHOICES, BodyKinematicsOption, option
from ..errors import InputError
from ..lives.budget import check_memory
from ..lives.conditions import PAPER_TASKS, Condition, check_proposer
from ..lives.experiment import Experiment, Signals, experiment_from
from ..lives.jobs import Job
from ..lives.manifest import UNREADABLE
from ..lives.overrides import overrides_of, with_overrides
from ..lives.plan import Plan
from ..pages.markdown import mean_cell, table
from ..storage import read_json
from .evaluation import EvaluationJob
from .study import STUDY_FILE, Page, Study, check_positive

FOLDER = "trials"
_MOST = 1024  # trials
_TOGETHER = 16  # trials in a cohort, where robots may differ in all tuned settings
_SHARES = {
    "wall_avoidance": "Share of time without contact",
    "spot_finding": "Share of time in the spot",
}


@dataclasses.dataclass(frozen=True)
class Trial:
    """Settings of a learner that are tried.

    Attributes:
      number: Number of the trial; 0 has the defaults.
      settings: Values that differ from the defaults, as NAME=VALUE.
    """

    number: int
    settings: tuple[str, ...]

    def values(self, tuned: Mapping[str, Setting]) -> dict[str, str]:
        """Returns the value of each tuned setting, as it is written."""
        chosen = dict(word.split("=") for word in self.settings)
        return {name: chosen.get(name, str(setting.default)) for name, setting in tuned.items()}


@dataclasses.dataclass
class Tune(Study):
    """Tune an agent's settings in the kinematic simulator, with equal effort for each.

    The first trial has the defaults, the others a Sobol sequence over the ranges. Half the robots
    of each trial are simulated; then the best trials are simulated again, with all robots and on a
    fresh seed. A robot's value is the mean of two shares of time in the spot, or without contact:
    in the test after training, and during training. These two make the benchmark's score, too. A
    trial's value is the mean over its robots. Sixteen trials share a cohort, which keeps one core
    busy, if robots may differ in all settings (`Setting.each`).
    """

    name: ClassVar[str] = "tune"

    agent: Annotated[str, tyro.conf.arg(metavar="AGENT")]
    """name of the agent, or a factory of yours as package.module:factory"""
    signals: Signals = "paper"
    """raw: smell and reward before they saturate"""
    task: Annotated[str, option(TASK_CHOICES, "spot_finding")] = "spot_finding"
    """task of all robots"""
    trials: int = 16
    """number of settings that are tried"""
    kept: int = 4
    """number of settings that are simulated again"""
    robots: int = 20
    """number of robots of a trial in the second round; half as many in the first, at least 1"""
    seed: int = 32001
    """seed of the first round; the second round has the next one"""
    kinematics: BodyKinematicsOption = BODY_EFFECTS
    """parameters of the kinematic simulator"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Returns the study that a folder holds; imports nothing that the folder names.

        Raises:
          InputError: the folder holds no study that tunes.
        """
        path = folder / STUDY_FILE
        try:
            held = read_json(path)
            details, full = held["details"], experiment_from(held["experiments"]["trials"])
            agent, kept, trials = details["agent"], details["kept"], len(details["trials"])
            if held["study"] != cls.name or type(agent) is not str or type(kept) is not int:
                raise ValueError("it holds another study, or is damaged")
            check_proposer(agent)
            task = Condition(details["task"], agent).task
        except (*UNREADABLE, InputError, OSError) as error:
            raise InputError(f"{path} is no study `tune` of musebot's ({error!r:.200})") from error
        return cls(
            agent=agent,
            signals=full.signals,
            task=task,
            trials=trials,
            kept=kept,
            robots=full.cohort_size,
            seed=full.seed - 1,
            kinematics=tuple(overrides_of(full.kinematics, Kinematics())),
            time_scale=full.time_scale,
        )

    def best(self, out: Path) -> Trial:
        """Returns the best trial of a finished study.

        Raises:
          InputError: it is not finished, a file is damaged, or its agent is not trusted.
        """
        if not all(job.done() for jobs in self.stages(out) for job in jobs):
            raise InputError(f"{out} is not finished: `musebot study tune` continues it")
        return self.ranked(out)[0][0]

    @property
    def effort(self) -> str:
        """What was tried, in words."""
        task = f" in {self.task}" if self.task != "spot_finding" else ""
        usual, own = (with_overrides(Kinematics(), x) for x in (BODY_EFFECTS, self.kinematics))
        other = f", {' '.join(self.kinematics)}" if own != usual else ""
        scale = f", durations times {self.time_scale:g}" if self.time_scale != 1 else ""
        return (
            f"{self.trials} settings{task}, then the best {self.kept}; robots of a setting: "
            f"{self._robots(False)}, then {self.robots}{other}{scale}"
        )

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`: that of the second round."""
        trust(recorded_name(self.agent))  # the command names it
        drawn = self.drawn()
        for again, trials in ((False, drawn), (True, drawn[: self.kept])):
            for some in self._cohorts(trials):
                experiment = self._round(again, some)
                check_memory(Plan.of(experiment, [self._condition], experiment.cohort_size))
        return {"trials": self._round(True, [Trial(0, ())])}

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
        if self.seed < 0:
            raise InputError(f"the seed must not be negative, got {shown(self.seed)}")
        name = recorded_name(self.agent)
        if self.task not in PAPER_TASKS:
            tasks = ", ".join(PAPER_TASKS)
            raise InputError(f"the task must be one of {tasks}, got {self.task!r:.60}")
        if self._condition.has_brain:
            raise InputError(f"{name} is a proposer of the brain: `musebot study evolve` tunes it")
        tuned = {n: s for n, s in settings_of(factory_of(name)).items() if s.tuned}
        if not tuned:
            raise InputError(f"{self.agent} has no settings to tune")
        return tuned

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`."""
        drawn = [list(trial.settings) for trial in self.drawn()]
        return {
            "agent": recorded_name(self.agent),
            "task": self.task,
            "kept": self.kept,
            "trials": drawn,
        }

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
        """See `Study.stages`: all trials, then the best again."""
        yield self._jobs(out, False, self.drawn())
        yield self._jobs(out, True, self._kept_trials(out))

    def ranked(self, out: Path) -> list[tuple[Trial, np.ndarray, np.ndarray | None]]:
        """Returns the finished trials, best first, with each robot's shares in both rounds.

        Shares have the shape (2, robots of the round), after training and during training; None
        where a trial has no second round.
        """
        early = self._values(out, False, self.drawn())
        later = self._values(out, True, self._kept_trials(out))
        found = [(trial, values, later.get(trial)) for trial, values in early.items()]
        return sorted(
            found,
            key=lambda one: (-_mean_or_least(one[2]), -float(one[1].mean()), one[0].number),
        )

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        ranked = self.ranked(out)
        rows = [
            [
                "trial",
                *self.settings,
                "first round",
                "second round",
                "after training",
                "during training",
            ]
        ]
        for trial, early, later in ranked:
            rows.append(
                [
                    str(trial.number),
                    *trial.values(self.settings).values(),
                    f"{early.mean():.3f}",
                    *_cells(later),
                ]
            )
        brackets = any("[" in cell for row in rows[1:] for cell in row[-2:])
        intervals = "; brackets hold 95 % intervals over robots" if brackets else ""
        winner, name = ranked[0][0], short_name(recorded_name(self.agent))
        chosen = f" --agent-set {' '.join(winner.settings)}" if winner.settings else ""
        lines = [
            f"## {name}, {self.signals} signals",
            "",
            *table(rows),
            "",
            f"{_SHARES[self.task]}: mean of two shares, in the test after training and during "
            f"training. Robots of a setting: {self._robots(False)}, then {self.robots}. The last "
            f"two columns belong to the second round{intervals}. The "
            "best of several trials was also lucky: only runs on other seeds measure it.",
            "",
            f"Best: trial {winner.number}, `musebot run OUT --agent {name}{chosen} --signals "
            f"{self.signals}`",
            "",
        ]
        return Page("\n".join(lines))

    @property
    def _condition(self) -> Condition:
        return Condition(self.task, recorded_name(self.agent))

    def _robots(self, again: bool) -> int:
        """Returns the number of robots of a trial, in the first round or when simulated again."""
        return self.robots if again else max(1, self.robots // 2)

    def _cohorts(self, trials: Sequence[Trial]) -> list[Sequence[Trial]]:
        size = _TOGETHER if all(setting.each for setting in self.settings.values()) else 1
        return [trials[start : start + size] for start in range(0, len(trials), size)]

    def _round(self, again: bool, trials: Sequence[Trial]) -> Experiment:
        """Returns the experiment of the trials of a cohort, with equal shares of its robots."""
        words = trials[0].settings
        if len(trials) > 1:
            values = [trial.values(self.settings) for trial in trials]
            words = tuple(
                f"{name}={','.join(one[name] for one in values)}" for name in self.settings
            )
        return Experiment(
            seed=self.seed + again,
            cohort_size=self._robots(again) * len(trials),
            time_scale=self.time_scale,
            body="kinematic",
            kinematics=with_overrides(Kinematics(), self.kinematics),
            signals=self.signals,
            settings=words,
        )

    def _jobs(self, out: Path, again: bool, trials: Sequence[Trial]) -> list[EvaluationJob]:
        return [self._job(out, again, some) for some in self._cohorts(trials)]

    def _job(self, out: Path, again: bool, trials: Sequence[Trial]) -> EvaluationJob:
        name = "-".join(f"{trial.number:04}" for trial in trials)
        path = out / FOLDER / f"{name}-{int(again)}.safetensors"
        return EvaluationJob(path, self._round(again, trials), self._condition)

    def _kept_trials(self, out: Path) -> list[Trial]:
        early = self._values(out, False, self.drawn())
        return sorted(early, key=lambda trial: -float(early[trial].mean()))[: self.kept]

    def _values(self, out: Path, again: bool, trials: Sequence[Trial]) -> dict[Trial, np.ndarray]:
        """Returns the shares of each finished trial's robots, shape (2, robots)."""
        found = {}
        for some in self._cohorts(trials):
            job = self._job(out, again, some)
            if not job.done():
                continue
            shares = np.array([job.shares("post"), job.shares("training")])
            if not job.experiment.schedule(self.task).wanted:
                shares = 1 - shares
            found |= dict(zip(some, np.split(shares, len(some), axis=1), strict=True))
        return found


def tunings(folders: Sequence[Path]) -> dict[str, tuple[Path, Tune]]:
    """Returns the studies that tune, with their folders, by `name_in_track`.

    Raises:
      InputError: a folder holds no such study, or an agent was tuned twice in a track.
    """
    found: dict[str, tuple[Path, Tune]] = {}
    for folder in folders:
        study = Tune.read(folder)
        key = name_in_track(study.agent, study.signals)
        if key in found:
            raise InputError(f"{study.agent} with {study.signals} signals was tuned twice")
        found[key] = folder, study
    return found


class Effort(NamedTuple):
    """The effort of a study that tunes.

    Attributes:
      words: What was tried, in words.
      tried: The settings of each trial, sorted.
    """

    words: str
    tried: frozenset[tuple[str, ...]]


def efforts(folders: Sequence[Path]) -> dict[str, Effort]:
    """Returns the effort of each study that tunes, by `name_in_track`."""
    found = {}
    for key, (folder, study) in tunings(folders).items():
        trials = read_json(folder / STUDY_FILE)["details"]["trials"]
        tried = frozenset(tuple(sorted(map(str, settings))) for settings in trials)
        found[key] = Effort(study.effort, tried)
    return found


def _mean_or_least(values: np.ndarray | None) -> float:
    """Returns the mean of values; minus infinity for none."""
    return -np.inf if values is None else float(values.mean())


def _cells(values: np.ndarray | None) -> list[str]:
    if values is None:
        return ["-"] * 3
    means = [mean_cell(shares, intervals.SHARE) for shares in values]
    return [f"{values.mean():.3f}", *means]
