"""The studies that rank learners: in the same lives, or in finished runs."""

from __future__ import annotations

import abc
import dataclasses
import functools
import itertools
import re
import time
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...controller import BRAINS, PROPOSERS
from ...models import Kinematics
from ...tasks.arena import CONTROL_TIMESTEP
from ...tasks.lives import PAPER_LIVES
from ..agents.factory import factory_of, trust
from ..agents.names import (
    LOWER,
    OWN,
    TRAINED_BEFORE,
    UPPER,
    is_own,
    recorded_name,
    short_name,
)
from ..agents.senses import random_signals, senses_of
from ..errors import InputError
from ..lives.cohort import make_agent
from ..lives.conditions import Condition
from ..lives.config import with_overrides
from ..lives.experiment import Body, Experiment, Signals
from ..lives.plan import Plan
from ..lives.run import Run
from ..lives.run_files import read_runs
from ..terminal import notice
from .boards import Board, Entry, boards
from .jobs import ArrayJob, Arrays, Progress
from .leaderboard_page import page
from .study import Page, RunJobs, Study, check_positive, simulate_runs
from .tune import BODY_EFFECTS, read_tunings

LEARNERS = tuple(name for name in OWN if name not in (TRAINED_BEFORE, LOWER, UPPER))
TIMED = 60, 500
"""Robots and control steps of the measurement of costs."""

RANKED = (*PAPER_LIVES, "spot_finding_walls")
_BRAINS = "paper", "steady"
_PAPER_ALONE = "paper", recorded_name(TRAINED_BEFORE)  # have no raw signals
# In MuJoCo 30 robots can become 60 later. Kinematic robots are cheaper in larger cohorts.
_COHORTS: Mapping[str, int] = {"mujoco": 30, "kinematic": 60}
_NONE: Mapping[str, Any] = {}


class Ranking(Study):
    """A study whose page ranks the learners of some runs, and says what they cost."""

    folders: ClassVar[tuple[str, ...]] = ("costs",)
    tuned: tuple[Path, ...]

    @abc.abstractmethod
    def boards(self, out: Path) -> dict[Board, list[Entry]]:
        """Returns the boards of the finished runs."""

    def work(self, out: Path, run_jobs: RunJobs) -> None:
        """Measures what our own learners cost; `ppo` has as many robots as policies."""
        rows = [(board, entry) for board, own in self.boards(out).items() for entry in own]
        own = [row for row in rows if is_own(row[1].condition.proposer)]
        run_jobs([_cost_job(out, *row) for row in own if row[1].name != TRAINED_BEFORE])

    def page(self, out: Path) -> Page:
        found = self.boards(out)
        jobs = {(b, e.name): _cost_job(out, b, e) for b, own in found.items() for e in own}
        costs = {row: job.read()["costs"] for row, job in jobs.items() if job.done()}
        return page(found, costs, read_tunings(self.tuned))


@dataclasses.dataclass
class Leaderboard(Ranking):
    """Ranks learners in finished runs; its fields are options of `musebot benchmark rank`."""

    name: ClassVar[str] = "leaderboard"

    runs: tuple[Path, ...]
    tuned: tuple[Path, ...] = ()

    @functools.cached_property
    def _runs(self) -> list[Run]:
        return read_runs(self.runs, networks=False)

    def identity(self) -> Mapping[str, Any]:
        boards(self._runs)  # refuses runs that make none
        efforts = {" ".join(key): one.study.effort for key, one in read_tunings(self.tuned).items()}
        runs = {run.name: dataclasses.asdict(run.experiment) for run in self._runs}
        return {"runs": runs, "tuned": efforts}

    def boards(self, out: Path) -> dict[Board, list[Entry]]:
        return boards(self._runs)


@dataclasses.dataclass
class Benchmark(Ranking):
    """Simulates learners in the same lives, each with its tuned settings, and ranks them.

    Its fields are options of `musebot benchmark run`. On each board each learner has one run per
    track. The bounds have one run per board, which counts in both tracks.
    """

    name: ClassVar[str] = "benchmark"

    tuned: tuple[Path, ...] = ()
    agent: tuple[str, ...] = (*_BRAINS, *LEARNERS)
    signals: tuple[Signals, ...] = ("paper", "raw")
    life: tuple[str, ...] = RANKED
    robots: int = 60
    seed: int = 32010
    body: Body = "mujoco"
    time_scale: float = 1.0

    def identity(self) -> Mapping[str, Any]:
        """Returns what all runs share: learners, tracks and lives may be added later."""
        check_positive(robots=self.robots)
        most = _COHORTS[self.body]
        if self.robots > most and self.robots % most:
            raise InputError(f"robots above {most} must be a multiple of {most}, got {self.robots}")
        return {"seed": self.seed, "body": self.body, "time_scale": self.time_scale}

    def plans(self) -> Mapping[str, Plan]:
        found = {}
        for life in self.life:
            bounds = tuple(map(recorded_name, (LOWER, UPPER)))
            found[f"{life}-bounds"] = self._plan(life, bounds)
            for name, signals in itertools.product(self._learners, self.signals):
                if signals == "paper" or name not in _PAPER_ALONE:
                    row = f"{life}-{short_name(name).replace(':', '-')}-{signals}"
                    found[row] = self._plan(life, *self._driver(name, signals))
        if all(name.endswith("-bounds") for name in found):
            raise InputError("at least one learner, a track that it has and a life are needed")
        return found

    def _driver(self, name: str, signals: Signals) -> tuple[tuple[str, ...], dict[str, Any]]:
        """Returns a learner's proposers, and the fields of its experiment."""
        if name == "paper":
            return PROPOSERS, {"brain": BRAINS[name]}
        if name == "steady":
            raw = signals == "raw"
            brain = dataclasses.replace(BRAINS[name], raw_signals=raw, raw_reward=raw)
            return ("creative",), {"brain": brain}
        settings = self._settings.get((name, signals), ())
        return (name,), {"signals": signals, "settings": settings}

    def _plan(self, life: str, proposers: Sequence[str], fields: Mapping[str, Any] = _NONE) -> Plan:
        """Returns the plan of some proposers or agents in a life."""
        effects = BODY_EFFECTS if self.body == "kinematic" else ()
        experiment = Experiment(
            seed=self.seed,
            cohort_size=min(self.robots, _COHORTS[self.body]),
            body=self.body,
            kinematics=with_overrides(Kinematics(), effects),
            time_scale=self.time_scale,
            **fields,
        )
        conditions = [Condition(life, one) for one in proposers]
        return Plan.of(experiment, conditions, self.robots)

    @functools.cached_property
    def _learners(self) -> list[str]:
        """The brains, and the agents as runs record them; their code may run from now on."""
        names = [name if name in _BRAINS else recorded_name(name) for name in self.agent]
        for name in names:
            if short_name(name) in (LOWER, UPPER, *PROPOSERS):
                raise InputError(f"{short_name(name)} is no learner of the benchmark")
            if name not in _BRAINS:
                trust(name)
                factory_of(name)
        return list(dict.fromkeys(names))

    @functools.cached_property
    def _settings(self) -> Mapping[tuple[str, str], tuple[str, ...]]:
        """The best settings of each tuned agent of the command, by recorded name and signals."""
        tunings = read_tunings(self.tuned)
        return {  # no other agent's code may run
            key: one.study.best(one.folder).settings
            for key, one in tunings.items()
            if key[0] in self._learners
        }

    def check(self, out: Path) -> None:
        """Says which learners are not tuned."""
        for name, signals in itertools.product(self._learners, self.signals if self.tuned else ()):
            if name not in (*_BRAINS, *_PAPER_ALONE) and (name, signals) not in self._settings:
                notice(f"{short_name(name)} was not tuned with {signals} signals: its defaults")

    def work(self, out: Path, run_jobs: RunJobs) -> None:
        simulate_runs(out, self.plans(), run_jobs)
        super().work(out, run_jobs)

    def boards(self, out: Path) -> dict[Board, list[Entry]]:
        found = boards(read_runs([out / name for name in self.plans()], networks=False))
        return {board: entries for board, entries in found.items() if board.signals in self.signals}


def _cost_job(out: Path, board: Board, entry: Entry) -> ArrayJob:
    """Returns the job that measures what a learner costs."""
    words = f"{board.name}-{entry.name}"
    name = f"{re.sub(r'[^A-Za-z0-9]+', '-', words)[:100]}-{zlib.crc32(words.encode()):08x}"
    return ArrayJob(
        out / "costs" / f"{name}.safetensors",
        functools.partial(costs, entry.experiment, entry.condition),
        2 * TIMED[0] * TIMED[1] * CONTROL_TIMESTEP,
        {"costs": ("F64", (3,))},
        {"board": board.name, "command": entry.command},
    )


def costs(experiment: Experiment, condition: Condition, progress: Progress) -> Arrays:
    """Measures what an agent or brain costs, in training on a stream of signals: takes seconds.

    Returns:
      "costs": CPU time of a robot-step in [us], that of the paper's creative brain, measured right
      after, and bytes of a robot in a checkpoint, shape (3,).

    Raises:
      InputError: the agent cannot be made.
      RunError: the agent fails or exits.
    """
    robots, steps = TIMED
    papers = Experiment(brain=BRAINS["paper"])
    agents = (
        make_agent(experiment, condition, robots, 1),
        make_agent(papers, Condition(condition.task, "creative"), robots, 1),
    )
    senses = senses_of(experiment.life_of(condition.task).task)
    states, rewards = random_signals(senses, steps, robots)
    found = []
    for agent in agents:
        agent.reset()
        for step, (state, reward) in enumerate(zip(states, rewards, strict=True)):
            if step == steps // 10:  # what is done once is not counted
                begun = time.thread_time()
            agent.act(state, True)
            agent.learn(reward)
        found.append((time.thread_time() - begun) / (steps - steps // 10) / robots * 1e6)
    size = sum(array.nbytes for array in agents[0].state().values()) / robots
    return {"costs": np.array([*found, size])}
