"""Tables 1 and 2 of a run beside the paper's or another run's, and the verdicts on the claims."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from ..agents.names import short_name
from ..analysis import comparison, intervals
from ..analysis.claims import ClaimResult
from ..analysis.hypothesis_tests import ALPHA, same_classes
from ..analysis.paper_claims import judge_all
from ..analysis.paper_tables import Column, column, paper_column, row_names
from ..lives.conditions import Condition
from ..lives.experiment import Experiment, differing
from ..lives.learn_ability import CATEGORIES, total_variation
from ..lives.run import Run
from ..lives.schedules import TASK_NAMES
from . import markdown as md
from .markdown import Cell

VARIATION = "total variation"
_NUMBERS = ("mean", "deviation", "post_share")  # of a column, behind its shares
_NOTE = (
    "In brackets: 95 % intervals (Wilson for shares; for means and deviations "
    f"{md.MEANS}; Student's t for the paper's means, from its table). *By chance*: the total "
    "variation that two groups of these sizes exceed with a probability of 5 % if their robots "
    "do not differ."
)
_ROUNDED = " L is rounded to two decimals before it is classed (`--exact-classes` does not round)."


# ---- A run beside the paper ----


class TableColumn(NamedTuple):
    """Cells of a proposer or agent, in the order of `names`, and the paper's, if it has them."""

    proposer: str
    ours: list[Cell]
    paper: list[Cell] | None


def names(task: str) -> list[str]:
    """Returns the names of the rows of a task's table."""
    return [*row_names(task), VARIATION]


def columns(run: Run, task: str) -> list[TableColumn]:
    """Returns the columns of a task's table."""
    found = []
    for proposer in run.proposers(task):
        condition = Condition(task, proposer)
        ours, paper = column(run, condition), paper_column(run.experiment, condition)
        distance, chance = _variation(ours, paper)
        variation = Cell(f"{distance:.2f}", f"(by chance {chance:.2f})")
        own = [*_cells(ours), Cell("-") if math.isnan(distance) else variation]
        found.append(TableColumn(proposer, own, [*_cells(paper), Cell("")] if paper else None))
    return found


def _cells(column: Column) -> list[Cell]:
    """Returns the cells of a column, in the order of `row_names`."""
    summary = column.summary
    invalid = f" (and {summary.invalid} invalid)" if summary.invalid else ""
    shares = zip(summary.counts, summary.shares, column.shares, strict=True)
    numbers = [(getattr(summary, name), getattr(column, name)) for name in _NUMBERS]
    return [
        Cell(f"{summary.robots}{invalid}"),
        *(Cell(f"{n} ({share:.0%})", md.bracket(ends, ".0%")) for n, share, ends in shares),
        *(Cell(md.number(value), md.bracket(ends)) for value, ends in numbers),
    ]


def _variation(first: Column, second: Column | None) -> tuple[float, float]:
    """Returns the total variation of two columns, and its 95th percentile by chance, or NaN."""
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


def _table(run: Run, task: str) -> str:
    turned: list[list[object]] = [["", *names(task)]]
    for one in columns(run, task):
        name = short_name(one.proposer)
        turned.append([f"{name}, ours" if one.paper else name, *one.ours])
        if one.paper:
            turned.append([f"{name}, paper", *one.paper])
    lines = md.table([*zip(*turned, strict=True)])
    return f"### {md.escape(md.title(task, run.experiment))}\n\n" + "\n".join(lines) + "\n"


def notes(run: Run) -> list[str]:
    """Returns the paragraphs under a run's tables: the joint test if there is one, and a note."""
    note = _NOTE + ("" if run.exact_classes else _ROUNDED)
    if not (agreement := _joint_tests(run)):
        return [note]
    values = ", ".join(f"{name} p = {p:.4f}" for name, p in agreement.items())
    joint = (
        "Joint test that all columns of a table have the paper's shares of classes (sum of "
        f"chi-squares, simulated null distribution): {values}."
    )
    return [joint, note]


def _joint_tests(run: Run) -> dict[str, float]:
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


def as_json(run: Run) -> dict[str, Any]:
    """Returns the tables of a run and of the paper, and the claims, as data; None for NaN."""
    found: dict[str, Any] = {}
    for condition in run.conditions():
        ours, paper = column(run, condition), paper_column(run.experiment, condition)
        entry = {"ours": _plain(ours), "paper": _plain(paper) if paper else None}
        if paper:
            distance, chance = _variation(ours, paper)
            entry |= {"total_variation": distance, "total_variation_by_chance": chance}
        found.setdefault(condition.task, {})[condition.proposer] = entry
    experiment = run.experiment
    return _finite(
        {
            "brain": experiment.brain_name,
            "protocol": experiment.protocol,
            "time_scale": experiment.time_scale,
            "seed": experiment.seed,
            "interval_level": intervals.LEVEL,
            "exact_classes": run.exact_classes,
            "tables": found,
            "joint_tests": _joint_tests(run),
            "claims": [result.as_json() for result in judge_all(run)],
        }
    )


def _plain(column: Column) -> dict[str, Any]:
    return {
        "robots": column.summary.robots,
        "invalid": column.summary.invalid,
        "counts": dict(zip(CATEGORIES, column.summary.counts, strict=True)),
        **{name: getattr(column.summary, name) for name in _NUMBERS},
        "intervals": {
            "shares": dict(zip(CATEGORIES, column.shares, strict=True)),
            **{name: getattr(column, name) for name in _NUMBERS},
        },
    }


def _finite(data: Any) -> Any:
    """Returns plain data for JSON, with None for NaN and for an interval that is unknown."""
    if isinstance(data, dict):
        return {name: _finite(value) for name, value in data.items()}
    if isinstance(data, list | tuple):
        found = [_finite(value) for value in data]
        return None if isinstance(data, tuple) and None in found else found
    return None if isinstance(data, float) and math.isnan(data) else data


# ---- The claims ----


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
    found: dict[str, list[ClaimResult]] = {title: [] for title in md.TITLES.values()}
    for one in results:
        if one.verdict != "not judged":
            found[md.TITLES[one.claim.task]].append(one)
    return {title: judged for title, judged in found.items() if judged}


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


# ---- Two runs ----


def comparison_markdown(ours: Run, other: Run, cells: Sequence[comparison.Cell]) -> str:
    """Returns how two runs differ, with their cells as `comparison.compare_runs` returns them."""
    names = md.escape(ours.name), md.escape(other.name)
    found = [cell for cell in cells if cell.differs]
    verdict = f"After Holm's correction {len(found)} of {len(cells)} cells differ"
    lines = [f"**{names[0]}** compared with **{names[1]}**. {_differ_in(ours, other)}", ""]
    lines += [f"{verdict}{':' if found else '.'}", ""]
    for cell in found:
        first, second, difference = _numbers(cell)
        name = f"{cell.task}, {short_name(cell.proposer)}: {cell.name}"
        lines.append(f"- {name} {first} against {second}, {difference}")
    lines += [""] * bool(found)
    for task in md.TITLES:
        if own := [cell for cell in cells if cell.task == task]:
            rows: list[list[object]] = [["", "", *names, "difference", "p", "Holm"]]
            rows += [
                [short_name(cell.proposer), cell.name, *_numbers(cell), *_p(cell)] for cell in own
            ]
            lines += [f"### {md.escape(md.title(task, ours.experiment, other.experiment))}", ""]
            lines += [*md.table(rows, "llrrrrr"), ""]
    return "\n".join([*lines, _comparison_note(cells)])


def _differ_in(ours: Run, other: Run) -> str:
    fields = differing(ours.experiment, other.experiment)
    if not fields:
        return (
            "Their experiments are the same: they can differ only in the versions and machines "
            "that simulated them."
        )
    named = "; ".join(
        f"{name} ({', '.join(md.escape(md.field_text(name, value)) for value in pair)})"
        for name, pair in fields.items()
    )
    if len(fields) == 1:
        return f"Their experiments differ in {named}."
    return (
        f"Their experiments differ in {len(fields)} fields, so that no difference below can be "
        f"attributed to one of them: {named}."
    )


def _numbers(cell: comparison.Cell) -> tuple[str, str, Cell]:
    """Returns our value, the other's, and the difference with its interval; a dash for NaN."""
    form, signed = (".1%", "+.1%") if cell.share else (".4f", "+.3f")
    difference = Cell(md.number(cell.difference, signed), md.bracket(cell.interval, signed))
    return md.number(cell.ours, form), md.number(cell.other, form), difference


def _p(cell: comparison.Cell) -> tuple[str, str]:
    """Returns p, and p after Holm's correction, bold where the cell differs."""
    corrected = md.probability(cell.corrected)
    return md.probability(cell.p), f"**{corrected}**" if cell.differs else corrected


def _comparison_note(cells: Sequence[comparison.Cell]) -> str:
    paired = [cell.paired for cell in cells]
    pairing = "The robots are independent groups: their newborn brains differ"
    if any(paired):
        pairing = "Robots of the same number have the same newborn brain and are compared in pairs"
        pairing += "" if all(paired) else f" in {sum(paired)} of {len(cells)} cells"
    tests = ["McNemar's" if any(paired) else "", "Fisher's" if not all(paired) else ""]
    return (
        f"{pairing}. In brackets: the 95 % interval of the difference (Newcombe for shares "
        f"of robots; for the rest {md.MEANS}). *p*: two-sided, "
        f"{' or '.join(filter(None, tests))} exact test for shares, a permutation test for the "
        f"rest. *Holm*: p corrected over {len(cells)} cells, bold below {ALPHA:g}. A dash: too few "
        f"measured robots.{_left_out(cells)}\n"
    )


def _left_out(cells: Sequence[comparison.Cell]) -> str:
    """Returns in words how many pairs lack a value of one robot, empty if none does."""
    found = [
        f"{cell.incomplete} ({cell.task}, {short_name(cell.proposer)})"
        for cell in cells
        if cell.name == "mean L" and cell.incomplete
    ]
    if not found:
        return ""
    return (
        " Mean and deviation of L are those of pairs in which both robots have an L. Pairs left "
        f"out because only one has it: {', '.join(found)}."
    )


def comparison_json(ours: Run, other: Run, cells: Sequence[comparison.Cell]) -> dict[str, Any]:
    """Returns a comparison as plain data for JSON, with None for NaN; see `comparison_markdown`."""
    found = [
        {**dataclasses.asdict(cell), "difference": cell.difference, "differs": cell.differs}
        for cell in cells
    ]
    for fields in found:
        fields |= fields.pop("condition")  # task and proposer
    return {
        "ours": ours.name,
        "other": other.name,
        "differ_in": differing(ours.experiment, other.experiment),
        "interval_level": intervals.LEVEL,
        "alpha": ALPHA,
        "cells": _finite(found),
    }
