"""Comparisons of two runs as text: tables of cells, and a note that explains them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..agents.names import short_name
from ..analysis import intervals
from ..analysis.comparison import Cell
from ..analysis.hypothesis_tests import ALPHA
from ..lives.experiment import differing
from ..lives.run import Run
from . import labels
from . import markdown as md


def markdown(ours: Run, other: Run, cells: Sequence[Cell]) -> str:
    """Returns Markdown: tables of two runs, differences of their experiments, and differing cells.

    Args:
      ours: A run.
      other: The run that it was compared with.
      cells: Compared cells (`comparison.compare_runs`).
    """
    found = [cell for cell in cells if cell.differs]
    verdict = f"After Holm's correction {len(found)} of {len(cells)} cells differ"
    lines = [f"**{ours.name}** compared with **{other.name}**. {_differ_in(ours, other)}", ""]
    lines += [f"{verdict}{':' if found else '.'}", ""]
    lines += [f"- {cell.task}, {short_name(cell.proposer)}: {words(cell)}" for cell in found]
    lines += [""] * bool(found)
    for task in labels.TITLES:
        if own := [cell for cell in cells if cell.task == task]:
            lines += [f"### {labels.title(task, ours.experiment, other.experiment)}", ""]
            lines += [*table(ours.name, other.name, own), ""]
    return "\n".join([*lines, note(cells)])


def _differ_in(ours: Run, other: Run) -> str:
    fields = differing(ours.experiment, other.experiment)
    if not fields:
        return (
            "Their experiments are the same: they can differ only in the versions and machines "
            "that simulated them."
        )
    named = "; ".join(
        f"{name} ({labels.value(name, a)}, {labels.value(name, b)})"
        for name, (a, b) in fields.items()
    )
    if len(fields) == 1:
        return f"Their experiments differ in {named}."
    return (
        f"Their experiments differ in {len(fields)} fields, so that no difference below can be "
        f"attributed to one of them: {named}."
    )


def pairing(cells: Sequence[Cell]) -> str:
    """Returns in words which robots of the cells are compared."""
    paired = [cell.paired for cell in cells]
    if not any(paired):
        return "The robots are independent groups: their newborn brains differ"
    words = "Robots of the same number have the same newborn brain and are compared in pairs"
    return words if all(paired) else f"{words} in {sum(paired)} of {len(cells)} cells"


def note(cells: Sequence[Cell]) -> str:
    """Returns a note on how the cells, corrected together, were compared."""
    paired = [cell.paired for cell in cells]
    tests = ["McNemar's" if any(paired) else "", "Fisher's" if not all(paired) else ""]
    return (
        f"{pairing(cells)}. In brackets: the 95 % interval of the difference (Newcombe for shares "
        f"of robots; for the rest {md.MEANS}). *p*: two-sided, "
        f"{' or '.join(filter(None, tests))} exact test for shares, a permutation test for the "
        f"rest. *Holm*: p corrected over {len(cells)} cells, bold below {ALPHA:g}. A dash: too few "
        f"measured robots.{_left_out(cells)}\n"
    )


def _left_out(cells: Sequence[Cell]) -> str:
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


def table(first: str, second: str, cells: Sequence[Cell]) -> list[str]:
    """Returns the lines of a table of cells of one task.

    Args:
      first: Name of our run.
      second: Name of the other run.
      cells: Compared cells.
    """
    rows = [["", "", first, second, "difference", "p", "Holm"]]
    for cell in cells:
        values = [
            number(cell, cell.ours),
            number(cell, cell.other),
            difference(cell),
            md.probability(cell.p),
        ]
        name = short_name(cell.proposer)
        rows.append([name, cell.name, *values, corrected(cell)])
    return md.table(rows, "llrrrrr")


def corrected(cell: Cell) -> str:
    """Returns p after Holm's correction, bold where the cell differs."""
    p = md.probability(cell.corrected)
    return f"**{p}**" if cell.differs else p


def words(cell: Cell) -> str:
    """Returns the two values of a cell and their difference, in a few words."""
    values = f"{number(cell, cell.ours)} against {number(cell, cell.other)}"
    return f"{cell.name} {values}, {difference(cell)}"


def number(cell: Cell, value: float) -> str:
    """Returns a value of a cell as text, in per cent if it is a share; a dash for NaN."""
    return f"{value:.1%}" if cell.share and not math.isnan(value) else md.number(value)


def difference(cell: Cell) -> str:
    """Returns the difference of a cell with its interval in brackets; a dash for NaN."""
    form = "+.1%" if cell.share else "+.3f"
    if math.isnan(cell.difference):
        return "-"
    text = f"{cell.difference:{form}}"
    low, high = cell.interval
    return text if math.isnan(low) or math.isnan(high) else f"{text} [{low:{form}}, {high:{form}}]"


def as_json(ours: Run, other: Run, cells: Sequence[Cell]) -> dict[str, Any]:
    """Returns a comparison as plain data for JSON, with None for NaN.

    Args:
      ours: A run.
      other: The run that it was compared with.
      cells: Compared cells (`comparison.compare_runs`).
    """
    return {
        "ours": ours.name,
        "other": other.name,
        "differ_in": differing(ours.experiment, other.experiment),
        "interval_level": intervals.LEVEL,
        "alpha": ALPHA,
        "cells": [_plain(cell) for cell in cells],
    }


def _plain(cell: Cell) -> dict[str, Any]:
    numbers = {
        name: getattr(cell, name) for name in ("ours", "other", "difference", "p", "corrected")
    }
    return {
        "task": cell.task,
        "proposer": cell.proposer,
        "name": cell.name,
        "share": cell.share,
        "paired": cell.paired,
        "robots": list(cell.robots),
        "incomplete": cell.incomplete,
        "interval": None if math.isnan(sum(cell.interval)) else list(cell.interval),
        "differs": cell.differs,
        **{name: None if math.isnan(value) else value for name, value in numbers.items()},
    }
