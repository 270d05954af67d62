"""The paper's tables 1 and 2, ours beside the paper's, and what becomes of its claims."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..analysis import intervals
from ..analysis.claims import Evidence, Finding, judge_all
from ..analysis.intervals import Interval
from ..experiment.experiment import Experiment, differing
from ..experiment.schedules import NAMES, SCHEDULES
from ..results.learn_ability import CATEGORIES, PAPER, Summary, total_variation
from ..results.results import Results, abilities, shares, test_seconds

TITLES = {"wall_avoidance": "Wall avoidance (table 1)", "spot_finding": "Spot finding (table 2)"}
NOTE = (
    "In brackets 95 % intervals: Wilson's for shares, BCa bootstrap for means and deviations over "
    "robots; for the paper's means Student's, from its table. *By chance*: the total variation "
    "that two groups of these sizes exceed once in twenty if their robots are of one kind."
)


@dataclasses.dataclass(frozen=True)
class Column:
    """A condition's column of table 1 or 2, and how sure its cells are.

    Attributes:
      summary: the cells.
      shares: the interval of each category's share.
      mean: of the mean L.
      deviation: of L's standard deviation.
      post_share: of the mean share of the test after training.
    """

    summary: Summary
    shares: tuple[Interval, ...]
    mean: Interval
    deviation: Interval
    post_share: Interval


def ours(experiment: Experiment, results: Results, task: str, proposer: str) -> Column:
    """The column that a condition's robots fill."""
    rows = results.valid(task, proposer)
    measured = abilities(rows)
    measured = measured[~np.isnan(measured)]
    post = shares(rows, test_seconds(experiment, task), "post")
    summary = results.summary(experiment, task, proposer)
    return Column(
        summary,
        _shares(summary),
        intervals.mean(measured),
        intervals.deviation(measured),
        intervals.mean(post),
    )


def papers(experiment: Experiment, task: str, proposer: str) -> Column | None:
    """The paper's column; None for an agent, or a course, that it does not have."""
    summary = PAPER.get((task, proposer))
    if summary is None or experiment.course != "paper":
        return None
    unknown = intervals.UNKNOWN  # the paper does not say how its robots scatter
    return Column(summary, _shares(summary), intervals.mean_from(summary), unknown, unknown)


def _shares(summary: Summary) -> tuple[Interval, ...]:
    return tuple(intervals.share(count, summary.robots) for count in summary.counts)


def title(task: str, experiment: Experiment, *others: Experiment) -> str:
    """A table's title, with whatever all its runs have in common that is not the default."""
    title = TITLES[task] if experiment.course == "paper" else NAMES[task]
    theirs = [particulars(other) for other in others]
    facts = [fact for fact in particulars(experiment) if all(fact in other for other in theirs)]
    return ", ".join([title, *facts])


def particulars(experiment: Experiment) -> list[str]:
    """What is not the default in an experiment, in words, but for its seed and cohorts."""
    found = [f"course: {experiment.course}"] if experiment.course != "paper" else []
    if experiment.brain_name != "paper":
        found.append(f"brain: {experiment.brain_name}")
    told = {"seed", "cohort_size", "time_scale", "course"}
    others = differing(experiment, Experiment(brain=experiment.brain))
    found += [
        f"{name.removeprefix('kinematics.').replace('_', ' ')}: {value}"
        for name, (value, _) in others.items()
        if name not in told
    ]
    if experiment.time_scale != 1:
        found.append(f"a rehearsal: every duration times {experiment.time_scale:g}")
    return found


def row_names(task: str) -> list[str]:
    """The first cells of a table's rows."""
    schedule = SCHEDULES[task]
    names = [f"({schedule.unmeasured})" if c == "unmeasured" else c for c in CATEGORIES]
    return ["robots", *names, "mean L", "sd of L", f"share of time {schedule.event}, post"]


def cells(column: Column) -> list[tuple[str, str]]:
    """A column's cells, each a value and its interval in brackets, in the order of `row_names`."""
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


def variation_cells(first: Column, second: Column | None) -> tuple[str, str]:
    """The total variation of two columns' categories, and that which chance would explain."""
    if second is None or not first.summary.robots:
        return "-", ""
    distance = total_variation(first.summary, second.summary)
    chance = intervals.chance_variation(first.summary, second.summary)
    return f"{distance:.2f}", f"(by chance {chance:.2f})"


def markdown(experiment: Experiment, results: Results) -> str:
    """Both tables and the claims as Markdown; a condition without lives is left out.

    So are the claims where nothing has lived that they are about (`claims.judge_all`).
    """
    parts = [*(_table(experiment, results, task) for task in results.tasks()), NOTE + "\n"]
    if findings := judge_all(Evidence(experiment, results)):
        parts.append(_claims(experiment, findings))
    return "\n".join(parts)


def _table(experiment: Experiment, results: Results, task: str) -> str:
    rows = [[name] for name in (*row_names(task), "total variation")]
    head = [""]
    for proposer in results.proposers_of(task):
        column = ours(experiment, results, task, proposer)
        paper = papers(experiment, task, proposer)
        found = [*cells(column), variation_cells(column, paper)]
        columns = [(f"{proposer}, ours", found)]
        if paper:
            columns.append((f"{proposer}, paper", [*cells(paper), ("", "")]))
        for name, column_cells in columns:
            head.append(name)
            for row, cell in zip(rows, column_cells, strict=True):
                row.append(" ".join(filter(None, cell)))
    lines = [line(head), line(["---", *("---:" for _ in head[1:])]), *map(line, rows)]
    return f"### {title(task, experiment)}\n\n" + "\n".join(lines) + "\n"


def _claims(experiment: Experiment, findings: list[Finding]) -> str:
    lines = ["### The claims of section 4", "", claims_note(experiment), ""]
    for task in TITLES:
        lines += [f"**{TITLES[task]}**", ""]
        lines += [
            f"- *{finding.claim.says}* **{finding.verdict}**: {finding.words}"
            for finding in findings
            if finding.claim.task == task
        ]
        lines.append("")
    return "\n".join(lines)


def claims_note(experiment: Experiment) -> str:
    """How the claims are judged, in words."""
    note = (
        "A claim holds where every comparison it needs is significant, does not hold where the "
        "opposite of one is, and is undecided else; each is judged at 5 %. p is two-sided; that "
        "against a claim is multiplied by the number of its comparisons (Bonferroni). *The paper's "
        "own numbers*: what becomes of the claim by the paper's tables, where they are enough to "
        "judge it."
    )
    if experiment.time_scale != 1:
        note += " These lives were a rehearsal, and say nothing of the paper's."
    return note


def as_json(experiment: Experiment, results: Results) -> dict[str, Any]:
    """Both tables, ours and the paper's, and the claims, as plain data; NaN as None."""
    tables: dict[str, Any] = {}
    for task, proposer in results.conditions():
        column = ours(experiment, results, task, proposer)
        paper = papers(experiment, task, proposer)
        entry: dict[str, Any] = {"ours": _plain(column), "paper": None}
        if paper:
            summaries = column.summary, paper.summary
            entry["paper"] = _plain(paper)
            entry["total_variation"] = _finite(total_variation(*summaries))
            entry["total_variation_by_chance"] = _finite(intervals.chance_variation(*summaries))
        tables.setdefault(task, {})[proposer] = entry
    return {
        "brain": experiment.brain_name,
        "course": experiment.course,
        "time_scale": experiment.time_scale,
        "seed": experiment.seed,
        "interval_level": intervals.LEVEL,
        "tables": tables,
        "claims": [finding.plain() for finding in judge_all(Evidence(experiment, results))],
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


def bracket(interval: Interval, percent: bool = False) -> str:
    """An interval in brackets; nothing for an unknown one."""
    if not _ends(interval):
        return ""
    low, high = interval
    return f"[{low:.0%}, {high:.0%}]" if percent else f"[{low:.3f}, {high:.3f}]"


def number(value: float) -> str:
    """A number, a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:.4f}"


def mean_cell(values: np.ndarray) -> str:
    """The mean of robots' shares, with its 95 % interval in brackets where there is one."""
    return f"{values.mean():.3f} {bracket(intervals.mean(values))}".strip()


def line(row: Sequence[str]) -> str:
    """A row of a table."""
    return "| " + " | ".join(row) + " |"
