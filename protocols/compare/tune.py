"""The study that tunes a learner: successive halving of settings, equal effort for each learner.

K. Jamieson and A. Talwalkar, "Non-stochastic Best Arm Identification and Hyperparameter
Optimization", AISTATS 2016.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.stats import qmc

from ...fields import choice, whole
from ...models import Kinematics
from ...tasks.lives import LIVES, SPOT_FINDING, STAGES, Life, Stage
from ..agents.factory import factory_of, trust
from ..agents.names import recorded_name, short_name
from ..agents.settings import Setting, settings_of
from ..analysis import intervals
from ..errors import InputError, check_name
from ..pages.markdown import mean_cell, table
from ..runs.conditions import Condition
from ..runs.experiment import Experiment, Signals
from ..runs.manifest import UNREADABLE
from ..runs.plan import MOST_ROBOTS, Plan, check_memory
from ..runs.simulation import check_agents
from ..storage import read_json
from .jobs import ArrayJob, simulate_cohort
from .study import STUDY_FILE, Page, RunJobs, Study

# Effects of the MuJoCo body that the kinematic simulator can imitate (docs/physics.md).
LIKE_MUJOCO = Kinematics(felt="pushed", wall="slips", lag=0.08)
_MOST = 1024  # trials
_TOGETHER = 16  # trials in a cohort, if its robots may differ in all tuned settings
_PARTS: Mapping[Stage, str] = {"post": "after training", "training": "during training"}


@dataclasses.dataclass(frozen=True)
class Trial:
    """One choice of a learner's settings, which is tried.

    Attributes:
      number: Number of the trial; 0 has the defaults.
      settings: Values that differ from the defaults, each as NAME=VALUE.
    """

    number: int
    settings: tuple[str, ...]

    def values(self, tuned: Mapping[str, Setting]) -> dict[str, str]:
        """Returns the value of each tuned setting, as text."""
        chosen = dict(word.split("=") for word in self.settings)
        return {name: chosen.get(name, str(setting.default)) for name, setting in tuned.items()}


class Ranked(NamedTuple):
    """A trial with its robots' shares of time at the goal, see `shares_of`.

    Attributes:
      trial: Number of the trial, and its choice of settings.
      early: Each robot's share in each part of its life, shape (parts, robots), in the first
        round.
      late: The same in the second round; None if the trial was not kept.
    """

    trial: Trial
    early: np.ndarray
    late: np.ndarray | None


@dataclasses.dataclass
class Tune(Study):
    """Tunes an agent's settings; its fields are options of `musebot benchmark tune`.

    A robot's value is the share of time at the goal (in wall avoidance: without contact) while it
    learns; in a life with tests, it is the mean of this share and that in the test after training.
    A trial's value is the mean over its robots. If robots may differ in all settings
    (`Setting.each`), sixteen trials share a cohort, and so a core.
    """

    name: ClassVar[str] = "tune"
    folders: ClassVar[tuple[str, ...]] = ("trials",)

    agent: str
    signals: Signals = choice("raw", Signals)
    life: str = SPOT_FINDING.name
    trials: int = whole(16, 1, _MOST)
    kept: int = whole(4, 1, _MOST)
    robots: int = whole(20, 1, MOST_ROBOTS // _TOGETHER)
    seed: int = whole(32001, 0, 2**128 - 2)
    time_scale: float = 1.0

    @property
    def condition(self) -> Condition:
        """Condition (life and agent) of all robots."""
        return Condition(self.life, recorded_name(self.agent))

    def check_options(self) -> None:
        """Raises InputError where an option is invalid; imports no agent."""
        if self.kept > self.trials:
            raise InputError(f"kept must be at most trials, {self.trials}, got {self.kept}")
        check_name("life", self.life, LIVES)
        if self.condition.has_brain:
            raise InputError(f"{self.agent} is a proposer of the brain, which has no settings")
        self.experiment()

    def identity(self) -> Mapping[str, Any]:
        """Returns all options, and the settings of each trial."""
        self.check_options()
        trust(self.condition.proposer)  # the command names it
        for again, trials in ((False, self.drawn()), (True, self.drawn()[: self.kept])):
            for some in self._cohorts(trials):
                experiment = self._experiment(again, some)
                check_memory(Plan.of(experiment, [self.condition], experiment.cohort_size))
        check_agents(Plan.of(self.experiment(), [self.condition], self.robots))
        drawn = [list(trial.settings) for trial in self.drawn()]
        return dataclasses.asdict(self) | {"agent": self.condition.proposer, "drawn": drawn}

    def experiment(self) -> Experiment:
        return self._experiment(True, [Trial(0, ())])

    @functools.cached_property
    def settings(self) -> Mapping[str, Setting]:
        """The settings that are tuned, by name.

        Raises:
          InputError: the agent has no settings, is not trusted or cannot be imported.
        """
        factory = factory_of(self.condition.proposer)
        tuned = {name: one for name, one in settings_of(factory).items() if one.tuned}
        if not tuned:
            raise InputError(f"{self.agent} has no settings to tune")
        return tuned

    def drawn(self) -> list[Trial]:
        """Returns all trials, the defaults first."""
        sobol = qmc.Sobol(len(self.settings), rng=np.random.default_rng(self.seed))
        points = sobol.random(1 << (self.trials - 1).bit_length())[: self.trials]
        trials = [Trial(0, ())]
        for number, point in enumerate(points[1:], 1):
            pairs = zip(self.settings.items(), point.tolist(), strict=True)
            words = (f"{name}={setting.at(share)}" for (name, setting), share in pairs)
            trials.append(Trial(number, tuple(words)))
        return trials

    def work(self, out: Path, run_jobs: RunJobs) -> None:
        run_jobs([self._job(out, False, some) for some in self._cohorts(self.drawn())])
        run_jobs([self._job(out, True, some) for some in self._cohorts(self._kept(out))])

    def ranked(self, out: Path) -> list[Ranked]:
        """Returns the finished trials, best first."""
        early = self._values(out, False, self.drawn())
        late = self._values(out, True, self._kept(out))
        found = [Ranked(trial, values, late.get(trial)) for trial, values in early.items()]
        found.sort(key=lambda one: (-one.early.mean(), one.trial.number))
        return sorted(found, key=lambda one: np.inf if one.late is None else -one.late.mean())

    def best(self, out: Path) -> Trial:
        """Returns the best trial of a finished study.

        Raises:
          InputError: the study is not finished, a file is damaged, or the agent is not trusted.
        """
        ranked = self.ranked(out)
        late = sum(one.late is not None for one in ranked)
        if (len(ranked), late) != (self.trials, self.kept):
            raise InputError(f"{out} is not finished: the command that tunes continues it")
        return ranked[0].trial

    def page(self, out: Path) -> Page:
        experiment = self.experiment()
        life = experiment.life_of(self.life)
        title = ", ".join(filter(None, [life.title, experiment.rehearsal]))
        parts = [words for stage, words in _PARTS.items() if life.steps_of(stage)]
        rows = [["trial", *self.settings, "first round", "second round", *parts]]
        ranked = self.ranked(out)
        for trial, early, late in ranked:
            cells = ["-"] * (1 + len(parts))
            if late is not None:
                means = [mean_cell(shares, intervals.SHARE) for shares in late]
                cells = [f"{late.mean():.3f}", *means]
            values = trial.values(self.settings).values()
            rows.append([str(trial.number), *values, f"{early.mean():.3f}", *cells])
        winner, name = ranked[0].trial, short_name(self.condition.proposer)
        chosen = ["signals=raw"] * (self.signals == "raw")
        chosen += [f"agent.{setting}" for setting in winner.settings]
        words = " ".join([f"--agent {name}", *["--set"] * bool(chosen), *chosen])
        lines = [
            f"## {name}, {self.signals} signals",
            "",
            *table(rows),
            "",
            f"{title}. Values: mean share of time {'' if life.wanted else 'not '}{life.event} "
            f"{' and '.join(parts)}. Robots of a setting: {self._robots(False)}, then "
            f"{self.robots}. The columns after the second round belong to it; brackets hold 95 % "
            "intervals over robots. The best of several trials was also lucky: only runs on other "
            "seeds measure it.",
            "",
            f"Best: trial {winner.number}, `musebot run OUT {words}`",
            "",
        ]
        return Page("\n".join(lines))

    def _robots(self, again: bool) -> int:
        """Returns the number of robots of a trial, in the first round or (`again`) the second."""
        return self.robots if again else max(1, self.robots // 2)

    def _cohorts(self, trials: Sequence[Trial]) -> list[Sequence[Trial]]:
        size = _TOGETHER if all(setting.each for setting in self.settings.values()) else 1
        return [trials[start : start + size] for start in range(0, len(trials), size)]

    def _experiment(self, again: bool, trials: Sequence[Trial]) -> Experiment:
        """Returns the experiment of a cohort, in which each trial has an equal share of robots."""
        words = trials[0].settings
        if len(trials) > 1:
            values = [trial.values(self.settings) for trial in trials]
            words = tuple(f"{n}={','.join(one[n] for one in values)}" for n in self.settings)
        return Experiment(
            seed=self.seed + again,
            cohort_size=self._robots(again) * len(trials),
            time_scale=self.time_scale,
            body="kinematic",
            kinematics=LIKE_MUJOCO,
            signals=self.signals,
            settings=words,
        )

    def _job(self, out: Path, again: bool, trials: Sequence[Trial]) -> ArrayJob:
        numbers = "-".join(f"{trial.number:04}" for trial in trials)
        experiment = self._experiment(again, trials)
        identity = {word: getattr(self, word) for word in ("signals", "life", "time_scale")}
        identity |= {"agent": self.condition.proposer, "seed": experiment.seed}
        return ArrayJob(
            out / "trials" / f"{numbers}-{int(again)}.safetensors",
            functools.partial(simulate_cohort, experiment, self.condition),
            experiment.robot_seconds(sum(experiment.life_of(self.life).steps())),
            identity | {"settings": experiment.settings},
        )

    def _kept(self, out: Path) -> list[Trial]:
        early = self._values(out, False, self.drawn())
        return sorted(early, key=lambda trial: -float(early[trial].mean()))[: self.kept]

    def _values(self, out: Path, again: bool, trials: Sequence[Trial]) -> dict[Trial, np.ndarray]:
        """Returns the shares of time of each finished trial's robots, see `shares_of`."""
        found = {}
        for some in self._cohorts(trials):
            job = self._job(out, again, some)
            if job.done():
                shares = shares_of(job.read(), self._experiment(again, some).life_of(self.life))
                found |= dict(zip(some, np.split(shares, len(some), axis=1), strict=True))
        return found


def shares_of(arrays: Mapping[str, np.ndarray], life: Life) -> np.ndarray:
    """Returns each robot's shares of time at the goal, shape (parts, B).

    The parts are the test after training, if the life has one, and training. An invalid robot has 0
    in all parts. `arrays` is what `jobs.simulate_cohort` returned.
    """
    shares = []
    for part in _PARTS:
        if steps := life.steps_of(part):
            share = np.clip(arrays["events"][:, STAGES.index(part)] / steps, 0, 1)
            wanted = share if life.wanted else 1 - share
            shares.append(np.where(arrays["valid"], wanted, 0.0))
    return np.array(shares)


def _read_tuning(folder: Path) -> Tune:
    """Reads a study from its folder; nothing that the folder names is imported."""
    path = folder / STUDY_FILE
    try:
        held = read_json(path)
        if held["study"] != Tune.name:
            raise ValueError("it holds another study")
        known = held["identity"]
        study = Tune(**{field.name: known[field.name] for field in dataclasses.fields(Tune)})
        study.check_options()
    except (*UNREADABLE, InputError, OSError) as error:
        text = repr(error) if isinstance(error, KeyError) else " ".join(str(error).split())
        raise InputError(f"{path} is no study `tune` of musebot's ({text:.200})") from error
    return study


def read_tunings(folders: Sequence[Path]) -> dict[tuple[str, str], tuple[Path, Tune]]:
    """Returns studies `tune` and their folders, by recorded name of the agent and signals.

    Raises:
      InputError: a folder holds no such study, or an agent was tuned twice with the same signals.
    """
    found: dict[tuple[str, str], tuple[Path, Tune]] = {}
    for folder in folders:
        study = _read_tuning(folder)
        key = recorded_name(study.agent), study.signals
        if key in found:
            raise InputError(f"{study.agent} with {study.signals} signals was tuned twice")
        found[key] = folder, study
    return found
