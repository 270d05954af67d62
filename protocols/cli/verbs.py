"""The verbs of the command `musebot`: module, class, and a line of help."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

# A verb's module is imported when the verb is asked for.
VERBS: Mapping[str, tuple[str, str, str]] = {
    "run": ("run", "Run", "simulate robots that learn; can be stopped and continued"),
    "tables": ("tables", "Tables", "print the paper's tables, or another run's, next to ours"),
    "report": ("report", "Report", "write one page about a run"),
    "film": ("film", "Film", "film a robot of a run, or a trained policy"),
    "explore": ("explore", "Explore", "open a window on a task"),
    "benchmark": ("benchmark", "", "compare learners in lives that change, yours among ours"),
    "list": ("listing", "List", "list lives, tasks, brains and agents by name"),
    "bench": ("bench", "Bench", "measure the speed compared with the raw physics"),
    "doctor": ("doctor", "Doctor", "report what is missing here, or check an agent"),
}
BENCHMARK: Mapping[str, tuple[str, str, str]] = {
    "benchmark run": ("benchmark", "Run", "compare learners in lives that change"),
    "benchmark tune": ("benchmark", "Tune", "tune an agent's settings, with equal effort"),
    "benchmark ppo": ("benchmark", "PPO", "train a policy by PPO"),
}


def verb_class(name: str) -> type[Any]:
    """Imports and returns the class of a verb."""
    module, cls, _ = BENCHMARK.get(name) or VERBS[name]
    return getattr(importlib.import_module(f".{module}", __package__), cls)
