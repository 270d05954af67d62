"""Markdown: tables, numbers with their intervals, and experiments in a few words."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..analysis import intervals
from ..analysis.intervals import Interval
from ..runs.experiment import Experiment, differing

MEANS = "BCa bootstrap over robots; Gaffke's bounds for a mean near an end of its range"
"""How the intervals of means are computed."""

TITLES = {"wall_avoidance": "Wall avoidance (table 1)", "spot_finding": "Spot finding (table 2)"}
# Seed and cohort size are not stated; time scale and life are stated in other words.
_STATED_APART = ("seed", "cohort_size", "time_scale", "life")


# ---- Tables ----


def table(rows: Sequence[Sequence[object]], align: str = "") -> list[str]:
    """Returns the lines of a table from the cells of its rows, the head first.

    `align` has a letter for each column: l for left, r for right. By default, the first column is
    aligned left, and all others are aligned right.
    """
    align = align or "l" + "r" * (len(rows[0]) - 1)
    rule = ["---:" if letter == "r" else "---" for letter in align]
    return [f"| {' | '.join(map(str, row))} |" for row in (rows[0], rule, *rows[1:])]


def escape(text: str) -> str:
    """Returns Markdown that shows a text, such as a folder's name, as it is, also in a table."""
    marks = r"([\\`*\[\]|~]|(?<![^\W_])_|_(?![^\W_]))"  # an underscore within a word is none
    return re.sub(marks, r"\\\1", html.escape(" ".join(text.split()), quote=False))


# ---- Numbers ----


def number(value: float, form: str = ".4f") -> str:
    """Returns a number in a format; a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:{form}}"


def probability(value: float) -> str:
    """Returns a p-value as text; a dash for NaN."""
    return "< 0.0001" if value < 1e-4 else number(value)


def with_interval(value: str, interval: Interval, form: str = ".3f") -> str:
    """Returns a value with its interval in brackets, if the interval is known."""
    low, high = interval
    return value if math.isnan(low + high) else f"{value} [{low:{form}}, {high:{form}}]"


def mean_cell(values: np.ndarray, span: Interval | None = None) -> str:
    """Returns the mean of n robots' values, shape (n,), with its 95 % interval if it is known.

    It is a dash if a value is NaN. `span` is the lowest and highest value that a robot can have;
    None if not known.
    """
    mean = number(values.mean(), ".3f")
    return mean if mean == "-" else with_interval(mean, intervals.mean(values, span))


# ---- Experiments ----


def title(task: str, experiment: Experiment, *others: Experiment) -> str:
    """Returns the title of a task's table, with non-default fields that all experiments share."""
    name = TITLES.get(task) or experiment.life_of(task).title
    theirs = [particulars(other) for other in others]
    facts = [fact for fact in particulars(experiment) if all(fact in other for other in theirs)]
    return ", ".join([name, *facts])


def particulars(experiment: Experiment) -> list[str]:
    """Returns the non-default fields of an experiment, without seed and cohort size, as text."""
    found: list[str] = []
    if experiment.brain_name != "paper":
        found.append(f"brain: {experiment.brain_name}")
    others = differing(experiment, Experiment(brain=experiment.brain))
    found += [
        f"{name.removeprefix('kinematics.').replace('_', ' ')}: {field_text(name, own)}"
        for name, (own, _) in others.items()
        if name not in _STATED_APART
    ]
    return [*found, experiment.rehearsal] if experiment.rehearsal else found


def field_text(name: str, value: Any) -> str:
    """Returns the value of an experiment's field as text; a motor speed has its unit."""
    if isinstance(value, tuple):
        return " ".join(map(str, value)) or "none"  # as on the command line
    return f"{value:g} m/s" if name == "motor_speed" and value is not None else str(value)
