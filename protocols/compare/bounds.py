"""Bounds of a life: shares of time at the goal of untrained robots and of its worlds' policies."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...controller.senses import Senses
from ...tasks.episode import CONTROL_TIMESTEP
from ...tasks.lives import Life, control_steps, place
from ...tasks.suite import task_definition
from ..agents.base import Agent
from ..agents.hand_coded import HandCoded
from ..agents.informed import Informed
from ..agents.neurocontroller import newborn
from ..agents.signals import senses_of
from ..analysis.adaptation import Bounds
from ..runs.device import decide
from ..runs.experiment import Experiment
from .jobs import ArrayJob, Arrays, Progress

ROBOTS, MINUTES = 30, 20
"""Robots and minutes with which each policy is measured in each world."""

UNTRAINED = 300
"""Robots in each world without training: their networks, and so their shares, differ much."""

MOST = 12  # measured worlds of a life; if it has more, every n-th
UNTAUGHT = ("untrained", "random")


class RandomMotors(HandCoded):
    """Drives at random: draws new uniform motor values in each step."""

    def __init__(self, senses: Senses, seed: int) -> None:
        super().__init__(senses)
        self._random = np.random.default_rng(seed)

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        return self._random.uniform(-0.5, 0.5, (len(state), 2))


@dataclasses.dataclass(frozen=True)
class Matrix:
    """Shares of time at the goal that policies reach in the W tried worlds of a life.

    Attributes:
      worlds: Indices in `Life.worlds` of the W worlds in which policies were measured.
      shares: Mean share of time at the goal of each policy (row) in each world (column), shape
        (W + 2, W). The first W rows are the policies made for the worlds, in the order of the
        columns; the last two rows are the policies named in `UNTAUGHT`.
    """

    worlds: tuple[int, ...]
    shares: np.ndarray

    @property
    def informed(self) -> np.ndarray:
        """Share of time, in each world, of the policy made for this world, shape (W,)."""
        return np.diagonal(self.shares)

    @property
    def best_fixed(self) -> float:
        """Share of time of the best policy made for a tried world, as a mean over all of them."""
        return float(self.shares[: len(self.worlds)].mean(axis=1).max())

    def bounds(self, life: Life) -> Bounds:
        """Returns all worlds' bounds; an untried world has those of the tried one before it."""
        tried = np.searchsorted(self.worlds, np.arange(len(life.worlds)), side="right") - 1
        return Bounds(self.shares[-2][tried], self.informed[tried])


def tried_worlds(life: Life) -> tuple[int, ...]:
    """Returns the indices in `Life.worlds` of at most `MOST` worlds that are measured."""
    return tuple(range(0, len(life.worlds), -(-len(life.worlds) // MOST)))


def bounds_job(out: Path, experiment: Experiment, name: str) -> ArrayJob:
    """Returns the job that measures the bounds of a life in an experiment's simulator."""
    life = experiment.life_of(name)
    worlds = len(tried_worlds(life))
    robots = worlds * ((worlds + 1) * ROBOTS + UNTRAINED)
    return ArrayJob(
        out / "bounds" / f"{name}.safetensors",
        functools.partial(measure, experiment, name),
        robots * _steps(experiment) * CONTROL_TIMESTEP,
        {
            "life": dataclasses.asdict(life),
            "body": experiment.body,
            "seed": experiment.seed,
            "untrained": UNTRAINED,
        },
    )


def measure(experiment: Experiment, name: str, progress: Progress) -> Arrays:
    """Measures the shares of time at the goal that policies reach in the worlds of a life.

    Returns:
      The array "shares": mean shares of time at the goal, see `Matrix.shares`.
    """
    life = experiment.life_of(name)
    tried = [life.worlds[number] for number in tried_worlds(life)]
    rules, senses = task_definition(life.task).rules, senses_of(life.task)
    lengths = {kind: length for kind, (length, *_) in rules.shapes.items()}
    policies: list[tuple[int, Callable[[], Agent]]] = [
        *((ROBOTS, functools.partial(Informed, world, lengths, senses)) for world in tried),
        (UNTRAINED, lambda: newborn(UNTRAINED, senses, experiment.seed)),
        (ROBOTS, lambda: RandomMotors(senses, experiment.seed)),
    ]
    shares = np.zeros((len(policies), len(tried)))
    done = 0.0
    for column, world in enumerate(tried):
        phase = next(phase for phase in life.phases if phase.world == world)
        phase = dataclasses.replace(phase, minutes=MINUTES * experiment.time_scale)
        for row, (robots, make) in enumerate(policies):
            progress(done)
            one = dataclasses.replace(life, phases=(phase,))
            shares[row, column] = _share(experiment, one, make(), robots)
            done += robots * _steps(experiment) * CONTROL_TIMESTEP
    return {"shares": shares}


def _steps(experiment: Experiment) -> int:
    return control_steps(MINUTES * experiment.time_scale)


def _share(experiment: Experiment, life: Life, agent: Agent, robots: int) -> float:
    """Returns the mean share of time at the goal of robots that do not learn."""
    batch = experiment.batch(life.task, robots)
    random = np.random.default_rng(experiment.seed)
    reached = 0
    for leg in life.legs():
        place(batch, leg.phase, random)
        for _ in range(leg.start, leg.stop):
            batch.step(decide(agent, batch, False))
            reached += int(batch.rules.event(batch.sensordata).sum())
    return reached / (robots * sum(life.steps()))
