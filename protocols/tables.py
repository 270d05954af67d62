"""The paper's tables 1 and 2, ours beside the paper's."""

from __future__ import annotations

import math
from typing import Any

from ..controller import PROPOSERS
from .experiment import Experiment
from .learn_ability import CATEGORIES, PAPER, Summary, total_variation
from .results import Results
from .schedules import SCHEDULES

_TITLES = {"wall_avoidance": "Wall avoidance (table 1)", "spot_finding": "Spot finding (table 2)"}


def markdown(experiment: Experiment, results: Results) -> str:
    """Both tables as Markdown; a condition without lives is left out."""
    parts = []
    for task, title in _TITLES.items():
        columns = [p for p in PROPOSERS if results.of(task, p)]
        if columns:
            summaries = {p: results.summary(experiment, task, p) for p in columns}
            parts.append(_table(experiment, task, title, summaries))
    return "\n".join(parts)


def _table(experiment: Experiment, task: str, title: str, summaries: dict[str, Summary]) -> str:
    schedule = SCHEDULES[task]
    if experiment.time_scale != 1:
        title += f", a rehearsal: every duration times {experiment.time_scale:g}"
    event = "in the spot" if schedule.wanted else "in contact"
    names = [f"({schedule.unmeasured})" if c == "unmeasured" else c for c in CATEGORIES]
    rows: list[list[str]] = [["robots"], *([name] for name in names)]
    rows += [["mean L"], ["sd of L"], [f"share of time {event}, post"], ["total variation"]]
    for proposer, ours in summaries.items():
        for summary in (ours, PAPER[task, proposer]):
            shares = zip(summary.counts, summary.shares, strict=True)
            cells = [f"{summary.robots}", *(f"{n} ({share:.0%})" for n, share in shares)]
            cells += [_number(x) for x in (summary.mean, summary.deviation, summary.post_share)]
            distance = total_variation(ours, PAPER[task, proposer])
            cells.append(f"{distance:.2f}" if summary is ours else "")
            if summary.invalid:
                cells[0] += f" (and {summary.invalid} invalid)"
            for row, cell in zip(rows, cells, strict=True):
                row.append(cell)
    head = ["", *(f"{p}, {whose}" for p in summaries for whose in ("ours", "paper"))]
    lines = [_line(head), _line(["---", *("---:" for _ in head[1:])]), *map(_line, rows)]
    return f"### {title}\n\n" + "\n".join(lines) + "\n"


def as_json(experiment: Experiment, results: Results) -> dict[str, Any]:
    """Both tables, ours and the paper's, as plain data; NaN as None."""
    tables: dict[str, Any] = {}
    for task, proposer in results.conditions():
        ours = results.summary(experiment, task, proposer)
        paper = PAPER[task, proposer]
        tables.setdefault(task, {})[proposer] = {
            "ours": _plain(ours),
            "paper": _plain(paper),
            "total_variation": total_variation(ours, paper),
        }
    return {"time_scale": experiment.time_scale, "seed": experiment.seed, "tables": tables}


def _plain(summary: Summary) -> dict[str, Any]:
    numbers = {
        "mean": summary.mean,
        "deviation": summary.deviation,
        "post_share": summary.post_share,
    }
    return {
        "robots": summary.robots,
        "invalid": summary.invalid,
        "counts": dict(zip(CATEGORIES, summary.counts, strict=True)),
        **{name: None if math.isnan(x) else x for name, x in numbers.items()},
    }


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4f}"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"
