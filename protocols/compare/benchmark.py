"""The benchmark: learners in lives whose world changes, with newborn robots as controls."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from ...controller import BRAINS, PROPOSERS
from ...fields import choice, whole
from ...models import Kinematics
from ...tasks.lives import BODY, CHANGING_TASK, DRIFT, LIVES, Life
from ..agents.factory import factory_of, trust
from ..agents.names import LOWER, OWN, UPPER, recorded_name, short_name
from ..agents.settings import settings_from
from ..analysis.adaptation import Adaptation, Bounds, shares_of
from ..errors import InputError, check_name
from ..runs.conditions import Condition
from ..runs.experiment import Backend, Body, Experiment, Signals
from ..runs.plan import MOST_ROBOTS, Plan
from ..runs.run import Run
from ..runs.run_files import read_run
from .bounds import Matrix, bounds_job, tried_worlds
from .lives_page import Column, Row, page
from .study import Page, RunJobs, Study, simulate_runs
from .tune import LIKE_MUJOCO, read_tunings

LEARNERS = tuple(name for name in OWN if name not in (LOWER, UPPER))
HEADLINE = (BODY.name, CHANGING_TASK.name, DRIFT.name)
_BRAINS = "paper", "steady"  # by default; any brain may be given
# Robots of a cohort. In MuJoCo, 30 can become 60 later; large kinematic cohorts are cheaper.
_COHORTS: Mapping[str, int] = {"mujoco": 30, "kinematic": 60}


@dataclasses.dataclass
class Benchmark(Study):
    """Simulates learners with tuned settings in lives whose world changes, and compares them.

    Its fields are options of `musebot benchmark run`. Each learner has one run in each life. In a
    life whose worlds return, the run also simulates newborns in each world.
    """

    name: ClassVar[str] = "benchmark"
    folders: ClassVar[tuple[str, ...]] = ("bounds",)

    life: tuple[str, ...] = HEADLINE
    agent: tuple[str, ...] = (*_BRAINS, *LEARNERS)
    tuned: tuple[Path, ...] = ()
    set: tuple[str, ...] = ()
    signals: Signals = choice("raw", Signals)
    robots: int = whole(60, 1, MOST_ROBOTS)
    seed: int = 61010
    body: Body = choice("kinematic", Body)
    time_scale: float = 1.0
    backend: Backend = choice("torch", Backend)

    def identity(self) -> Mapping[str, Any]:
        """Returns the options that all runs share; learners and lives may be added later."""
        most = _COHORTS[self.body]
        if self.robots > most and self.robots % most:
            raise InputError(f"robots above {most} must be a multiple of {most}, got {self.robots}")
        changing = [name for name, life in LIVES.items() if not life.tested]
        for name in self.life:
            check_name("built-in changing life", name, changing)
        _ = self._chosen  # refuses unknown learners and settings
        shared = ("seed", "body", "time_scale", "backend", "signals")
        return {name: getattr(self, name) for name in shared}

    def experiment(self) -> Experiment:
        return self._experiment({})

    def plans(self) -> Mapping[str, Plan]:
        return {folder: plan for folder, (*_, plan) in self._runs.items()}

    @property
    def _lives(self) -> list[str]:
        return list(dict.fromkeys(self.life))

    @functools.cached_property
    def _runs(self) -> Mapping[str, tuple[str, str, Plan]]:
        """The life, the learner's short name and the plan of each run, by the run's folder."""
        found = {}
        for life in self._lives:
            for name in self._learners:
                proposers, fields = self._driver(name)
                lives = [life, *newborn_lives(LIVES[life])]
                conditions = [Condition(one, driver) for one in lives for driver in proposers]
                plan = Plan.of(self._experiment(fields), conditions, self.robots)
                short = short_name(name)
                found[f"{life}-{short.replace(':', '-')}"] = life, short, plan
        if not found:
            raise InputError("at least one learner and a life are needed")
        return found

    def _experiment(self, fields: Mapping[str, Any]) -> Experiment:
        kinematics = Kinematics()
        if self.body == "kinematic":
            kinematics = dataclasses.replace(LIKE_MUJOCO, pieces=1)
        return Experiment(
            seed=self.seed,
            cohort_size=min(self.robots, _COHORTS[self.body]),
            body=self.body,
            kinematics=kinematics,
            time_scale=self.time_scale,
            **fields,
        )

    def _driver(self, name: str) -> tuple[Sequence[str], dict[str, Any]]:
        """Returns a learner's proposers (an agent: its name), and the fields of its experiment."""
        # In MuJoCo, Numba compiles only the paper's brain.
        compiled = name == "paper" or self.body == "kinematic"
        shared = {"backend": self.backend if compiled else "torch"}
        if name == "paper":
            return PROPOSERS, {**shared, "brain": BRAINS[name]}
        if name in BRAINS:
            brain = BRAINS[name]
            if self.signals == "paper":
                brain = dataclasses.replace(brain, raw_signals=False, raw_reward=False)
            return ("creative",), {**shared, "brain": brain}
        tuned = self._settings.get((name, self.signals), ())
        words = [*tuned, *self._chosen.get(short_name(name), ())]
        by_name = {word.partition("=")[0]: word for word in words}  # chosen ones replace tuned
        settings = tuple(by_name.values())
        return (name,), {**shared, "signals": self.signals, "settings": settings}

    @functools.cached_property
    def _chosen(self) -> Mapping[str, Sequence[str]]:
        """The settings that the command chooses, by the short name of their agent."""
        found: dict[str, list[str]] = {}
        for word in self.set:
            name, _, value = word.partition("=")
            agent, _, setting = name.rpartition(".")
            found.setdefault(agent, []).append(f"{setting}={value}")
        known = [short_name(name) for name in self._learners if name not in BRAINS]
        for agent, words in found.items():
            check_name("learner with settings", agent, known)
            settings_from(words)  # one value each
        return found

    @functools.cached_property
    def _learners(self) -> list[str]:
        """Names of brains, and recorded names of agents, whose code is trusted from now on."""
        names = [name if name in BRAINS else recorded_name(name) for name in self.agent]
        for name in names:
            if short_name(name) in (LOWER, UPPER, *PROPOSERS):
                raise InputError(f"{short_name(name)} is no learner of the benchmark")
            if name not in BRAINS:
                trust(name)
                factory_of(name)
        return list(dict.fromkeys(names))

    @functools.cached_property
    def _settings(self) -> Mapping[tuple[str, str], tuple[str, ...]]:
        """The best settings of each tuned agent of the command, by recorded name and signals."""
        return {  # no other agent's code may run
            key: study.best(folder).settings
            for key, (folder, study) in read_tunings(self.tuned).items()
            if key[0] in self._learners
        }

    def work(self, out: Path, run_jobs: RunJobs) -> None:
        bounds = [bounds_job(out, self.experiment(), life) for life in self._lives]
        simulate_runs(out, self.plans(), run_jobs, bounds)

    def page(self, out: Path) -> Page:
        columns = []
        for name in self._lives:
            life = self.experiment().life_of(name)
            job = bounds_job(out, self.experiment(), name)
            matrix = Matrix(tried_worlds(life), job.read()["shares"])
            rows = []
            for folder, (own, learner, _) in self._runs.items():
                if own == name:
                    run = read_run(out / folder, networks=False)  # a kept study may lack them
                    rows += _rows(learner, run, life, matrix.bounds(life))
            columns.append(Column(life, matrix, rows))
        return page(columns, self.time_scale)


def newborn_lives(life: Life) -> list[str]:
    """Returns names of newborns' lives in the worlds after the first; empty if no world returns."""
    if len(life.worlds) == len(life.phases):
        return []
    worlds = [phase.world for phase in life.phases]
    return [f"{life.name}@{worlds.index(world) + 1}" for world in life.worlds[1:]]


def _rows(learner: str, run: Run, life: Life, bounds: Bounds) -> list[Row]:
    """Returns a learner's rows: one for an agent, or one for each proposer of a brain."""
    rows = []
    for proposer in run.proposers(life.name):
        curves = shares_of(run, Condition(life.name, proposer))
        old = Adaptation.of(curves, life, bounds)
        # In the first phase all are newborns.
        controls = [old] + [
            Adaptation.of(
                shares_of(run, Condition(name, proposer)),
                run.experiment.life_of(name),
                bounds.of_world(number),
            )
            for number, name in enumerate(newborn_lives(life), 1)
        ]
        newborns = [one.recovery[:, 0] for one in controls]
        name = f"{learner}, {proposer}" if proposer in PROPOSERS else learner
        rows.append(Row(name, curves, old, newborns))
    return rows
