"""The study of continual learning: 24 hours in which the spot moves every ten minutes."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..analysis import intervals
from ..analysis.intervals import SHARE
from ..errors import InputError
from ..experiment.experiment import Experiment
from ..experiment.schedules import CONTINUAL
from ..reporting import style
from ..reporting.labels import described
from ..reporting.markdown import MEANS, mean_cell, table
from ..results.run import Run
from ..results.run_files import read_runs
from ..shared_options import Runs
from ..terminal import StepProgress
from .study import Page, Study

_TRAINING = CONTINUAL.minutes_of("training")
_PERIOD = round(CONTINUAL.phases[1].every_minutes or 0)  # in minutes
HOURS = (_TRAINING.stop - _TRAINING.start) // 60
EARLY, MIDDLE, LATE = (1, 2), (11, 12), (23, 24)  # first and last hour, both included
_STYLES: tuple[tuple[tuple[int, int], Literal["--", "-"]], ...] = ((EARLY, "--"), (LATE, "-"))


@dataclasses.dataclass
class Continual(Study):
    """Report spot finding over 24 hours in which the spot moves every ten minutes.

    The page shows the share of the time in the spot early and late; the figure shows each hour.
    """

    name: ClassVar[str] = "continual"

    runs: Runs
    """folders of finished runs of `musebot run RUN --protocol continual`"""

    @functools.cached_property
    def _read(self) -> list[Run]:
        return read_runs(self.runs)

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        trainings(self._read)
        return {run.name: run.experiment for run in self._read}

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        del out
        found = trainings(self._read)
        with style.styled():
            return Page(markdown(found), {self.name: draw(found)})


@dataclasses.dataclass(frozen=True)
class Training:
    """The training of a condition's N valid robots.

    Attributes:
      name: Text with the name of the run and the name of the proposer.
      minutes: Share of time in the spot, for each robot and minute of training, shape (N, 1440).
      run: Description of the run, a line of Markdown.
    """

    name: str
    minutes: np.ndarray
    run: str = ""

    def share(self, hours: tuple[int, int]) -> np.ndarray:
        """Returns each robot's share of time in the spot in some hours, shape (N,).

        Args:
          hours: First and last hour, counted from 1, both included.
        """
        first, last = hours
        return self.minutes[:, 60 * (first - 1) : 60 * last].mean(axis=1)

    def found(self) -> np.ndarray:
        """Returns the share of the spot's places that each robot found, shape (N,)."""
        return (self._by_place() > 0).any(axis=2).mean(axis=1)

    def after_move(self, hours: tuple[int, int]) -> np.ndarray:
        """Returns the mean share of time in the spot by minute after the spot moved, shape (10,).

        Args:
          hours: First and last hour, counted from 1, both included.
        """
        first, last = (60 * hour // _PERIOD for hour in (hours[0] - 1, hours[1]))
        return self._by_place()[:, first:last].mean(axis=(0, 1))

    def _by_place(self) -> np.ndarray:
        return self.minutes.reshape(len(self.minutes), -1, _PERIOD)


def trainings(runs: Sequence[Run]) -> list[Training]:
    """Returns the training of each condition of several runs.

    Raises:
      InputError: a run has another protocol, scaled durations or no valid robots, or there are too
        many conditions for a figure.
    """
    found = []
    for run in runs:
        experiment = run.experiment
        if experiment.protocol != "continual":
            raise InputError(
                f"{run.name} must have the protocol continual, got {experiment.protocol}"
            )
        if experiment.time_scale != 1:
            raise InputError(
                f"{run.name} is a rehearsal with scaled durations: its curves do not separate the "
                "spot's places"
            )
        for condition in run.conditions():
            curves = run.curves(condition)
            if not len(curves):
                raise InputError(f"{run.name} has no valid robot of {condition}")
            training = curves[:, _TRAINING].astype(float)
            found.append(Training(f"{run.name}, {condition.proposer}", training, described(run)))
    if not 1 <= len(found) <= len(style.PALETTE):
        raise InputError(f"a figure shows 1 to {len(style.PALETTE)} conditions, got {len(found)}")
    return found


def markdown(found: Sequence[Training]) -> str:
    """Returns the page: a row for each condition, with the share of the time in the spot."""
    hours = [f"hours {first}-{last}" for first, last in (EARLY, MIDDLE, LATE)]
    head = ["in the spot", "robots", *hours, f"found in {_PERIOD} minutes"]
    rows = [head]
    for training in found:
        values = [*(training.share(span) for span in (EARLY, MIDDLE, LATE)), training.found()]
        cells = [mean_cell(value, SHARE) for value in values]
        rows.append([training.name, f"{len(training.minutes)}", *cells])
    note = (
        "Share of the time in the spot during training, and share of the spot's places in which "
        f"the robot was in it at some moment. In brackets 95 % intervals ({MEANS})."
    )
    descriptions = dict.fromkeys(training.run for training in found)
    return "\n".join([*table(rows), "", note, "", *descriptions, ""])


def draw(found: Sequence[Training]) -> Figure:
    """Draws the share of time in the spot by hour, with 95 % bands, and by minute after a move."""
    figure, (above, below) = style.canvas(5.2 + 0.16 * len(found), 2, 1, sharey=True)
    keys = []
    with StepProgress("intervals", HOURS * len(found)) as progress:
        for training, shade in zip(found, style.PALETTE, strict=False):
            _by_hour(above[0], training, shade, progress.advance)
            _after_move(below[0], training, shade)
            keys.append(Line2D([], [], color=shade, label=training.name))
    above[0].set(title="Share of the time in the spot", xlabel="hours of training")
    above[0].set(xlim=(0, HOURS), xticks=range(0, HOURS + 1, 4), ylim=(0, 1))
    below[0].set(title="After the spot moved", xlabel="minutes", xlim=(0, _PERIOD))
    style.in_per_cent(above[0].yaxis)
    for (first, last), dashes in _STYLES:
        label = f"hours {first}-{last}"
        keys.append(Line2D([], [], color=style.INK, linestyle=dashes, label=label))
    figure.legend(handles=keys, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def _by_hour(axis: Axes, training: Training, shade: str, tick: Callable[[], None]) -> None:
    means, ends = [], []
    for hour in range(1, HOURS + 1):
        share = training.share((hour, hour))
        means.append(share.mean())
        ends.append(intervals.mean(share, SHARE))
        tick()
    middles = np.arange(HOURS) + 0.5
    axis.plot(middles, means, color=shade)
    axis.fill_between(middles, *np.array(ends).T, color=shade, alpha=0.2, linewidth=0)


def _after_move(axis: Axes, training: Training, shade: str) -> None:
    for hours, dashes in _STYLES:
        axis.plot(np.arange(_PERIOD) + 0.5, training.after_move(hours), color=shade,
                  linestyle=dashes)  # fmt: skip
