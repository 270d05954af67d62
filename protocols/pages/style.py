"""Style, canvas and files of all figures, legible on a light and on a dark background."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from ...tasks.lives import Life, control_steps
from ..storage import write_atomically

FORMATS = ("svg", "png")
WIDTH = 5.6  # inches: text of 9 points is legible on a telephone

# Every colour is legible on white and on near-black; the background is transparent. Colours of one
# figure differ for readers with red-green colour blindness, too.
INK = "#6e767e"  # colour of small text: the only grey with a contrast of 4.5 on white and on black
DARK = "#1b222b"  # colour of text and marks on a light area
EVENT = "#8811ff"  # colour of a path in contact, or in the spot
_PROPOSERS = {"fixed": "#3b87c4", "random": "#cf7423", "creative": "#0f9d77"}
_OTHERS = ("#cc66ff", "#776600", "#cc0044", "#775599")
CURVE = _PROPOSERS["fixed"]  # colour of curves in a figure of one learner
CATEGORY_COLOURS = ("#2f6fb0", "#86b6dc", "#b9bec6", "#d0702a", "#858e99")
_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.titlecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.6,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "svg.hashsalt": "musebot",  # equal figures have equal bytes
    "text.parse_math": False,  # a life's title may hold a dollar sign
}


def colour(proposer: str) -> str:
    """Returns the colour of one of the three proposers, the same in every figure."""
    return _PROPOSERS[proposer]


def looks(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Returns a different colour and style of lines for each proposer or agent of a run, by name.

    Agents share a few distinguishable colours: whenever all are used, the next lines have one more
    dot between their dashes. So an agent's look depends on its place among the names.
    """
    found = {}
    for name in dict.fromkeys(names):
        turn, place = divmod(len(found.keys() - _PROPOSERS.keys()), len(_OTHERS))
        if name in _PROPOSERS:
            turn = 0
        dashes = (0, (4, 1.5, *(1, 1.5) * (turn - 1))) if turn else "-"
        found[name] = {"color": _PROPOSERS.get(name, _OTHERS[place]), "linestyle": dashes}
    return found


def styled() -> Any:
    """Returns a context to draw and save figures in our style, whatever a matplotlibrc says."""
    return matplotlib.style.context(_STYLE, after_reset=True)


def canvas(height: float, rows: int, columns: int, **options: Any) -> tuple[Figure, np.ndarray]:
    """Returns a figure of a height in inches, and its axes, shape (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def save(figure: Figure, folder: Path, name: str) -> None:
    """Writes a figure in every format; raises OSError if a file cannot be written.

    In this case, an existing file stays as it was.
    """
    for suffix in FORMATS:
        buffer, metadata = io.BytesIO(), {"Date": None} if suffix == "svg" else None
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing from font")  # a box is drawn
            figure.savefig(buffer, format=suffix, dpi=200, metadata=metadata)
        write_atomically(folder / f"{name}.{suffix}", buffer.getvalue())


def in_per_cent(axis: Axes, top: float | None = None) -> None:
    """Labels a y axis of shares in per cent, from 0 to `top`, or to the highest value if None."""
    axis.set_ylim(0, top)
    axis.yaxis.set_major_formatter(PercentFormatter(1))


def mark_changes(axis: Axes, life: Life) -> None:
    """Draws a thin line where a life's world changes, unless it changes more than 24 times."""
    changes = [leg.start / control_steps(60) for leg in life.legs() if leg.changes_world]
    for hours in changes if len(changes) <= 24 else ():
        axis.axvline(hours, color="0.5", linewidth=0.5)
