"""Studies: experiments of several runs or tests, each with a page (`musebot study NAME`)."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .study import Study

# The module and class of each study, and what it asks: the first line of the class's docstring.
# Written here too, so that the list needs no heavy import; a test compares the two.
STUDIES: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "sensitivity": (
            "sensitivity",
            "Sensitivity",
            "Vary what the paper leaves open, one choice at a time, in the kinematic simulator.",
        ),
        "reading": (
            "reading.study",
            "Reading",
            "Compare readings of the paper by what they make of its tables.",
        ),
        "ablation": (
            "ablation",
            "Ablation",
            "Remove the ingredients of the brain `steady`, one at a time.",
        ),
        "creativity": (
            "creativity",
            "Creativity",
            "Compare creative with random robots in runs that have both.",
        ),
        "proposers": (
            "proposers.study",
            "Proposers",
            "Compare ways to propose equally many actions to the same evaluation network.",
        ),
        "wear": (
            "wear.study",
            "Wear",
            "Change the body of robots that have learned, and watch how they recover.",
        ),
        "evolve": (
            "search.evolve",
            "Evolve",
            "Evolve parameters of a brain in the kinematic simulator.",
        ),
        "tune": (
            "search.tune",
            "Tune",
            "Tune an agent's settings in the kinematic simulator, with equal effort for each.",
        ),
        "benchmark": (
            "learners.benchmark",
            "Benchmark",
            "Simulate learners by the same schedules, each with its tuned settings, and rank them.",
        ),
        "continued-learning": (
            "learners.continued",
            "ContinuedLearning",
            "Repeat the test after training while agents explore, or while they go on learning.",
        ),
        "leaderboard": (
            "learners.leaderboard",
            "Leaderboard",
            "Rank learners in kept runs, between a newborn and a hand-coded robot.",
        ),
        "robustness": (
            "robustness",
            "Robustness",
            "Evaluate trained brains in robots and arenas that differ from training.",
        ),
        "learning-progress": (
            "learning_progress.study",
            "LearningProgress",
            "Evaluate frozen brains at nine times of their training in spot finding.",
        ),
        "continual": (
            "continual",
            "Continual",
            "Report spot finding over 24 hours in which the spot moves every ten minutes.",
        ),
        "ppo": (
            "ppo",
            "PPOTraining",
            "Train policies by PPO on any task, one random seed each.",
        ),
        "timestep": (
            "timestep",
            "Timestep",
            "Measure how the body's motion converges with the physics timestep.",
        ),
    }
)


def study_class(name: str) -> type[Study]:
    """Imports and returns the class of a study.

    Raises:
      KeyError: there is no study of that name.
    """
    module, cls, _ = STUDIES[name]
    return getattr(importlib.import_module(f".{module}", __name__), cls)
