"""The paper's tables 1 and 2 compared with a run's, and the verdicts on the paper's claims."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..agents.names import short_name
from ..analysis import intervals
from ..analysis.claims import ClaimResult
from ..analysis.hypothesis_tests import same_classes
from ..analysis.intervals import Interval
from ..analysis.paper_claims import judge_all
from ..analysis.paper_tables import Column, column, paper_column, row_names
from ..lives.conditions import Condition
from ..lives.experiment import Experiment
from ..lives.learn_ability import CATEGORIES, total_variation
from ..lives.run import Run
from ..lives.schedules import TASK_NAMES
from . import labels
from .markdown import MEANS, bracket, number, table

_NOTE = (
    "In brackets: 95 % intervals (Wilson for shares; for means and deviations "
    f"{MEANS}; Student's t for the paper's means, from its table). *By chance*: the total "
    "variation that two groups of these sizes exceed with a probability of 5 % if their robots "
    "do not differ."
)
_ROUNDED = " L is rounded to two decimals before it is classed (`--exact-classes` does not round)."
VARIATION = "total variation"


def cells(column: Column) -> list[tuple[str, str]]:
    """Returns the value and the interval of each cell of a column, in the order of `row_names`."""
    summary = column.summary
    robots = f"{summary.robots}" + (f" (and {summary.invalid} invalid)" if summary.invalid else "")
    counts = [
        (f"{count} ({share:.0%})", bracket(interval, percent=True))
        for count, share, interval in zip(
            summary.counts, summary.shares, column.shares, strict=True
        )
    ]
    numbers = (
        (summary.mean, column.mean),
        (summary.deviation, column.deviation),
        (summary.post_share, column.post_share),
    )
    return [
        (robots, ""),
        *counts,
        *((number(value), bracket(interval)) for value, interval in numbers),
    ]


def variation_cell(first: Column, second: Column | None) -> tuple[str, str]:
    """Returns the total variation of two columns, and its 95th percentile under chance alone."""
    distance, chance = _variation(first, second)
    return ("-", "") if math.isnan(distance) else (f"{distance:.2f}", f"(by chance {chance:.2f})")


def _variation(first: Column, second: Column | None) -> tuple[float, float]:
    """Returns the numbers of `variation_cell`; NaN without a second column or without robots."""
    if second is None or not first.summary.robots:
        return math.nan, math.nan
    summaries = first.summary, second.summary
    return total_variation(*summaries), intervals.chance_variation(*summaries)


def markdown(run: Run) -> str:
    """Returns the tables of a run, and the verdicts on the claims that it can test."""
    parts = [_table(run, task) for task in run.tasks()]
    parts += [f"{note}\n" for note in notes(run)]
    if results := judge_all(run):
        parts.append(_claims(run.experiment, results))
    return "\n".join(parts)


def notes(run: Run) -> list[str]:
    """Returns the paragraphs under a run's tables: the joint test if there is one, and a note."""
    found = [_NOTE + ("" if run.exact_classes else _ROUNDED)]
    if agreement := joint_tests(run):
        values = ", ".join(f"{name} p = {p:.4f}" for name, p in agreement.items())
        found.insert(
            0,
            "Joint test that all columns of a table have the paper's shares of classes (sum of "
            f"chi-squares, simulated null distribution): {values}.",
        )
    return found


def joint_tests(run: Run) -> dict[str, float]:
    """Returns p of the joint test of each table, and of both; empty without the paper's columns."""
    found: dict[str, list[tuple[tuple[int, ...], tuple[int, ...]]]] = {}
    for condition in run.conditions():
        ours, paper = run.summary(condition), paper_column(run.experiment, condition)
        if paper and ours.robots:
            counts = ours.counts, paper.summary.counts
            found.setdefault(TASK_NAMES[condition.task].lower(), []).append(counts)
    if len(found) > 1:
        found["both tables"] = [pair for pairs in found.values() for pair in pairs]
    return {name: same_classes(pairs) for name, pairs in found.items()}


def _table(run: Run, task: str) -> str:
    rows = [["", *row_names(task), VARIATION]]  # columns first
    for proposer in run.proposers(task):
        condition = Condition(task, proposer)
        ours, paper = column(run, condition), paper_column(run.experiment, condition)
        found = [*cells(ours), variation_cell(ours, paper)]
        name = short_name(proposer)
        rows.append([f"{name}, ours" if paper else name, *map(_joined, found)])
        if paper:
            rows.append([f"{proposer}, paper", *map(_joined, cells(paper)), ""])
    lines = table([*zip(*rows, strict=True)])
    return f"### {labels.title(task, run.experiment)}\n\n" + "\n".join(lines) + "\n"


def _joined(cell: tuple[str, str]) -> str:
    return " ".join(filter(None, cell))


def _claims(experiment: Experiment, results: list[ClaimResult]) -> str:
    lines = ["### The claims of section 4", "", claims_note(experiment), ""]
    for title, judged in judged_claims(results).items():
        lines += [f"**{title}**", ""]
        lines += [f"- *{one.claim.says}* **{one.verdict}**: {one.words}" for one in judged]
        lines.append("")
    if left := not_judged(results):
        lines += [left, ""]
    return "\n".join(lines)


def judged_claims(results: Sequence[ClaimResult]) -> dict[str, list[ClaimResult]]:
    """Returns the judged claims by the title of their table, without tables that have none."""
    judged = {
        title: [one for one in results if one.claim.task == task and one.verdict != "not judged"]
        for task, title in labels.TITLES.items()
    }
    return {title: found for title, found in judged.items() if found}


def not_judged(results: Sequence[ClaimResult]) -> str:
    """Returns a sentence with the number of claims that are not judged, and why; or empty text."""
    left = [one for one in results if one.verdict == "not judged"]
    why = "; ".join(dict.fromkeys(one.why.rstrip(".") for one in left))
    return f"{len(left)} of {len(results)} claims are not judged: {why}." if left else ""


def claims_note(experiment: Experiment) -> str:
    """Returns a note on how the claims are judged."""
    note = (
        "A claim holds if all its inequalities are significant. It does not hold if the opposite "
        "of one is significant. Otherwise it is undecided. The level is 5 %. p is two-sided; "
        "p against a claim is multiplied by the number of its inequalities (Bonferroni). *The "
        "paper's own numbers*: the verdict by the paper's tables, where they suffice for one."
    )
    if experiment.time_scale != 1:
        note += " Durations were shortened: these verdicts do not apply to the paper."
    return note


def as_json(run: Run) -> dict[str, Any]:
    """Returns the tables of a run and of the paper, and the claims, as data; None for NaN."""
    found: dict[str, Any] = {}
    for condition in run.conditions():
        ours, paper = column(run, condition), paper_column(run.experiment, condition)
        entry: dict[str, Any] = {"ours": _plain(ours), "paper": None}
        if paper:
            distance, chance = _variation(ours, paper)
            entry["paper"] = _plain(paper)
            entry["total_variation"] = _finite(distance)
            entry["total_variation_by_chance"] = _finite(chance)
        found.setdefault(condition.task, {})[condition.proposer] = entry
    experiment = run.experiment
    return {
        "brain": experiment.brain_name,
        "protocol": experiment.protocol,
        "time_scale": experiment.time_scale,
        "seed": experiment.seed,
        "interval_level": intervals.LEVEL,
        "exact_classes": run.exact_classes,
        "tables": found,
        "joint_tests": {name: _finite(p) for name, p in joint_tests(run).items()},
        "claims": [result.as_json() for result in judge_all(run)],
    }


def _plain(column: Column) -> dict[str, Any]:
    summary = column.summary
    return {
        "robots": summary.robots,
        "invalid": summary.invalid,
        "counts": dict(zip(CATEGORIES, summary.counts, strict=True)),
        "mean": _finite(summary.mean),
        "deviation": _finite(summary.deviation),
        "post_share": _finite(summary.post_share),
        "intervals": {
            "shares": dict(zip(CATEGORIES, map(_ends, column.shares), strict=True)),
            "mean": _ends(column.mean),
            "deviation": _ends(column.deviation),
            "post_share": _ends(column.post_share),
        },
    }


def _ends(interval: Interval) -> list[float] | None:
    return None if math.isnan(interval[0]) or math.isnan(interval[1]) else list(interval)


def _finite(value: float) -> float | None:
    return None if math.isnan(value) else value
