"""Markdown: tables, and numbers with their intervals as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..analysis import intervals
from ..analysis.intervals import Interval

MEANS = "BCa bootstrap over robots; Gaffke's bounds for a mean near an end of its range"
"""How the intervals of means are computed."""


def line(row: Sequence[str]) -> str:
    """Returns a row of a table as a line of Markdown."""
    return "| " + " | ".join(row) + " |"


def table(rows: Sequence[Sequence[str]], align: str = "") -> list[str]:
    """Returns the lines of a table.

    Args:
      rows: Cells of each row, the head first.
      align: Alignment of each column, a letter each: l for left, r for right. Empty aligns the
        first column left and all others right.
    """
    align = align or "l" + "r" * (len(rows[0]) - 1)
    rule = ["---:" if letter == "r" else "---" for letter in align]
    return [line(rows[0]), line(rule), *map(line, rows[1:])]


def section(title: str, text: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Returns a heading, a paragraph and a table as Markdown.

    Args:
      title: Heading.
      text: Paragraph.
      head: Names of the table's columns.
      rows: Rows of the table, a text for each cell.
    """
    lines = "\n".join(table([head, *rows]))
    return f"### {title}\n\n{text}\n\n{lines}\n"


def number(value: float) -> str:
    """Returns a number as text with four decimals; a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:.4f}"


def bracket(interval: Interval, percent: bool = False) -> str:
    """Returns an interval as text in brackets; empty text if the interval is unknown."""
    low, high = interval
    if math.isnan(low) or math.isnan(high):
        return ""
    return f"[{low:.0%}, {high:.0%}]" if percent else f"[{low:.3f}, {high:.3f}]"


def with_interval(value: str, interval: Interval, percent: bool = False) -> str:
    """Returns a value with its interval in brackets, if the interval is known."""
    return f"{value} {bracket(interval, percent)}".strip()


def probability(value: float) -> str:
    """Returns a p-value as text; a dash for NaN."""
    return "< 0.0001" if value < 1e-4 else number(value)


def mean_cell(values: np.ndarray, span: Interval | None = None) -> str:
    """Returns the mean of some values, with its 95 % interval in brackets if it is known.

    Args:
      values: One value for each robot, shape (n,).
      span: Lowest and highest value that a robot can have; None if not known.
    """
    return with_interval(f"{values.mean():.3f}", intervals.mean(values, span))
