"""What the study simulates: ways to propose actions, and the cells of its parts."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

from ....models import Kinematics
from ...experiment.conditions import PAPER_TASKS, Condition
from ...experiment.experiment import Experiment
from ...experiment.overrides import named_brain, with_overrides
from ...shared_options import BODY_EFFECTS

IDEAS = (3, 9, 25)
OUTSIDE = 0.32  # share of random ideas, where there are any
SPOT = ("spot_finding",)


@dataclasses.dataclass(frozen=True)
class Way:
    """A way to propose actions.

    Attributes:
      values: Parameters of the brain that it sets.
      proposer: Proposer of the condition.
      counts: Whether the number of ideas matters where there are no outside ideas.
      mixes: Whether outside ideas change anything.
      born_alike: Whether robots of one seed have the newborn evaluation network of today's way.
    """

    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    proposer: Literal["creative", "random"] = "creative"
    counts: bool = True
    mixes: bool = True
    born_alike: bool = True


# docs/plans/proposers.md describes each.
WAYS: Mapping[str, Way] = MappingProxyType(
    {
        "connections": Way(),
        "with-main-idea": Way({"keep_main_idea": True}),
        "main-idea-uniform": Way({"keep_main_idea": True, "novelty": "uniform"}, mixes=False),
        "copies": Way({"novelty": "none"}, counts=False),
        "untrained": Way({"memory_learns": False}),
        "action": Way({"novelty": "action"}),
        "uniform": Way({}, "random", mixes=False, born_alike=False),
        "sobol": Way({"novelty": "sobol"}),
        "cross-entropy": Way({"novelty": "cross_entropy"}),
        "learned": Way({"novelty": "learned"}),
        "success-rule": Way({"keep_main_idea": True, "noise_adaptation": 0.01}),
        "untrained-copies": Way({"novelty": "none", "memory_learns": False}),
        "recurrent": Way({"context_neurons": 10}, born_alike=False),
    }
)


@dataclasses.dataclass(frozen=True)
class Cell:
    """A way with a number of ideas, without or with outside ideas.

    Attributes:
      way: Name of the way.
      ideas: Number of proposed actions.
      outside: Whether a share `OUTSIDE` of the ideas is random.
    """

    way: str
    ideas: int
    outside: bool = False

    @property
    def simulated(self) -> Cell:
        """The cell whose robots stand for this one, where number or outside ideas do not matter."""
        way = WAYS[self.way]
        outside = self.outside and way.mixes
        return Cell(self.way, self.ideas if way.counts or outside else max(IDEAS), outside)

    @property
    def name(self) -> str:
        """Name of the cell and of its folder."""
        return f"{self.way}-{self.ideas}-{'outside' if self.outside else 'own'}"

    def experiment(self, start: Experiment) -> Experiment:
        """Returns an experiment in which robots propose actions in this way."""
        share = OUTSIDE if self.outside else 0.0
        values = {"ideas": self.ideas, "random_share": share, **WAYS[self.way].values}
        return dataclasses.replace(start, brain=dataclasses.replace(start.brain, **values))


_ALL = tuple(name for name in WAYS if name not in ("success-rule", "untrained-copies", "recurrent"))
_MIXED = (
    "connections",
    "with-main-idea",
    "copies",
    "untrained",
    "success-rule",
    "untrained-copies",
)
_BODY = MappingProxyType(
    {"body": "kinematic", "kinematics": with_overrides(Kinematics(), BODY_EFFECTS)}
)


def _cells(ways: Iterable[str], ideas: Iterable[int], outside: bool) -> list[Cell]:
    return _distinct(Cell(way, count, outside).simulated for count in ideas for way in ways)


def _distinct(cells: Iterable[Cell]) -> list[Cell]:
    return list(dict.fromkeys(cells))


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of the study, which has a folder of its own.

    Attributes:
      says: What it answers, in words.
      robots: Number of robots in each cell, by the plan.
      cohort: Largest number of robots simulated in lockstep.
      seed: Seed of all cells.
      cells: Simulated cells.
      tasks: Tasks of the robots.
      brain: Name of the brain.
      fields: Further fields of the experiment.
    """

    says: str
    robots: int
    cohort: int
    seed: int
    cells: Sequence[Cell]
    tasks: Sequence[str] = SPOT
    brain: str = "steady"
    fields: Mapping[str, Any] = dataclasses.field(default_factory=lambda: _BODY)

    def start(self, cohort_size: int, time_scale: float) -> Experiment:
        """Returns the experiment that the cells change."""
        return Experiment(
            seed=self.seed,
            cohort_size=cohort_size,
            time_scale=time_scale,
            brain=named_brain(self.brain),
            **self.fields,
        )

    def conditions(self, cell: Cell) -> list[Condition]:
        """Returns the conditions of a cell's robots."""
        return [Condition(task, WAYS[cell.way].proposer) for task in self.tasks]


PartName = Literal["first", "outside", "rule", "mujoco", "paper", "context"]
PARTS: Mapping[PartName, Part] = MappingProxyType(
    {
        "first": Part(
            "all ways",
            250,
            250,
            31010,
            _distinct(
                cell
                for count in (25, 3, 9)  # the most telling first
                for cells in (_cells(_ALL, [count], False), _cells(_MIXED, [count], True))
                for cell in cells
            ),
        ),
        "outside": Part(
            "the other ways with outside ideas",
            250,
            250,
            31010,
            _cells(("connections", "action", "sobol", "cross-entropy", "learned"), IDEAS, True),
        ),
        "rule": Part(
            "the one-fifth rule against constant noise and no noise",
            1000,
            500,
            31030,
            _cells(("connections", "copies", "success-rule"), IDEAS, True),
        ),
        "mujoco": Part(
            "three ways in MuJoCo",
            200,
            50,
            31020,
            _cells(("connections", "copies", "untrained"), [25], True),
            fields={},
        ),
        "paper": Part(
            "the paper's brain",
            250,
            250,
            31040,
            _cells(("connections", "copies", "untrained", "uniform"), [25], False),
            PAPER_TASKS,
            "paper",
        ),
        "context": Part(
            "a recurrent context",
            250,
            250,
            31060,
            _cells(("connections", "recurrent"), [25], True),
        ),
    }
)
