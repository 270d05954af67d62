"""Labels: titles of tables, and an experiment in a few words."""

from __future__ import annotations

from typing import Any

from ..lives.experiment import Experiment, differing
from ..lives.run import Run
from ..lives.schedules import TASK_NAMES

TITLES = {"wall_avoidance": "Wall avoidance (table 1)", "spot_finding": "Spot finding (table 2)"}
# Seed and cohort size are stated nowhere, the other two in words of their own.
_STATED_APART = ("seed", "cohort_size", "time_scale", "protocol")


def title(task: str, experiment: Experiment, *others: Experiment) -> str:
    """Returns the title of a table, with the non-default fields that all its runs share.

    Args:
      task: Task of the table.
      experiment: Experiment of a run in the table.
      *others: Experiments of further runs in the same table.
    """
    name = TITLES[task] if experiment.protocol == "paper" else TASK_NAMES[task]
    theirs = [particulars(other) for other in others]
    facts = [fact for fact in particulars(experiment) if all(fact in other for other in theirs)]
    return ", ".join([name, *facts])


def particulars(experiment: Experiment) -> list[str]:
    """Returns the non-default fields of an experiment, without seed and cohort size, as text."""
    found = [f"protocol: {experiment.protocol}"] if experiment.protocol != "paper" else []
    if experiment.brain_name != "paper":
        found.append(f"brain: {experiment.brain_name}")
    others = differing(experiment, Experiment(brain=experiment.brain))
    found += [
        f"{name.removeprefix('kinematics.').replace('_', ' ')}: {value(name, own)}"
        for name, (own, _) in others.items()
        if name not in _STATED_APART
    ]
    return [*found, experiment.rehearsal] if experiment.rehearsal else found


def durations(experiment: Experiment) -> str:
    """Returns in words, after a comma, that an experiment is a rehearsal; empty if it is none."""
    return f", {experiment.rehearsal}" if experiment.rehearsal else ""


def value(name: str, field: Any) -> str:
    """Returns the value of an experiment's field as text, that of a motor speed with its unit."""
    if isinstance(field, tuple):
        return " ".join(map(str, field)) or "none"  # as on the command line
    return f"{field:g} m/s" if name == "motor_speed" and field is not None else str(field)


def described(run: Run) -> str:
    """Returns a line of Markdown with a run's brain and its non-default fields."""
    experiment = run.experiment
    fields = differing(experiment, Experiment(brain=experiment.brain))
    others = "".join(f", {name} {value(name, own)}" for name, (own, _) in fields.items())
    return f"- {run.name}: brain {experiment.brain_name}{others}"
