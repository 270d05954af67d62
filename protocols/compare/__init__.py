"""Studies that rank agents: options, the jobs that they need, and a page (`musebot study NAME`)."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .study import Study

# The module and class of each study, and the first line of the class's docstring: written here
# too, so that the list needs no heavy import; a test compares the two.
STUDIES: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "tune": (
            "tune",
            "Tune",
            "Tune an agent's settings in the kinematic simulator, with equal effort for each.",
        ),
        "benchmark": (
            "benchmark",
            "Benchmark",
            "Simulate learners by the same schedules, each with its tuned settings, and rank them.",
        ),
        "leaderboard": (
            "benchmark",
            "Leaderboard",
            "Rank learners in finished runs, between a newborn and a hand-coded robot.",
        ),
        "ppo": ("ppo", "PPOTraining", "Train policies by PPO on any task, one random seed each."),
    }
)


def study_class(name: str) -> type[Study]:
    """Imports and returns the class of a study.

    Raises:
      KeyError: there is no study of that name.
    """
    module, cls, _ = STUDIES[name]
    return getattr(importlib.import_module(f".{module}", __name__), cls)
