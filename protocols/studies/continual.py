"""The day: is a spot that jumps every ten minutes found again and again, for 24 hours?

    musebot run RUN --course day --brain steady
    python -m musebot.protocols.day RUN [--output FIGURE]

prints how much of the time robots were in the spot, early and late in their day, and draws it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..analysis import intervals
from ..analysis.comparison import described, names_of
from ..errors import InputError, run_module
from ..experiment.schedules import DAY
from ..options import Runs, option
from ..reporting import figures, tables
from ..simulation import engine
from ..terminal import bar

_TRAINING = DAY.minutes_of("training")
_JUMP = round(DAY.phases[1].every_minutes or 0)
HOURS = (_TRAINING.stop - _TRAINING.start) // 60
EARLY, MIDDLE, LATE = (1, 2), (11, 12), (23, 24)  # from the start of one to the end of the other
_STYLES: tuple[tuple[tuple[int, int], Literal["--", "-"]], ...] = ((EARLY, "--"), (LATE, "-"))


@dataclasses.dataclass(frozen=True)
class Day:
    """The day of a condition's valid robots.

    Attributes:
      name: of the run and the proposer.
      minutes: share of each minute of the training that a robot was in the spot, shape
        (robots, 1440).
      run: what the run is, in a line of Markdown.
    """

    name: str
    minutes: np.ndarray
    run: str = ""

    def share(self, hours: tuple[int, int]) -> np.ndarray:
        """Each robot's share of the time in the spot, from one hour to another, shape (robots,)."""
        first, last = hours
        return self.minutes[:, 60 * (first - 1) : 60 * last].mean(axis=1)

    def found(self) -> np.ndarray:
        """Each robot's share of the places of the spot in which it found it, shape (robots,)."""
        return (self._by_jump() > 0).any(axis=2).mean(axis=1)

    def after_a_jump(self, hours: tuple[int, int]) -> np.ndarray:
        """The mean share of each of the ten minutes after a jump, in these hours, shape (10,)."""
        first, last = (60 * hour // _JUMP for hour in (hours[0] - 1, hours[1]))
        return self._by_jump()[:, first:last].mean(axis=(0, 1))

    def _by_jump(self) -> np.ndarray:
        return self.minutes.reshape(len(self.minutes), -1, _JUMP)


def days(runs: Sequence[Path]) -> list[Day]:
    """The days of all conditions of several runs.

    Raises:
      InputError: one is no run, has lived another course or a rehearsal, or they are too many for
        a figure.
    """
    found = []
    for name, run in zip(names_of(runs), runs, strict=True):
        experiment, results = engine.read_run(run)
        if experiment.course != "day":
            raise InputError(f"{run} has lived the course {experiment.course}, not the day")
        if experiment.time_scale != 1:
            raise InputError(f"{run} is a rehearsal: its curves do not tell jump from jump")
        for task, proposer in results.conditions():
            curves = results.valid_curves(task, proposer)
            if not len(curves):
                raise InputError(f"{run} has no valid robot of {proposer}")
            training = curves[:, _TRAINING].astype(float)
            found.append(Day(f"{name}, {proposer}", training, described(name, experiment)))
    if not 1 <= len(found) <= len(figures.PALETTE):
        raise InputError(f"a figure holds 1 to {len(figures.PALETTE)} conditions, got {len(found)}")
    return found


def markdown(lived: Sequence[Day]) -> str:
    """A row a condition: the share of the time in the spot, and of the jumps after which found."""
    hours = [f"hours {first}-{last}" for first, last in (EARLY, MIDDLE, LATE)]
    head = ["in the spot", "robots", *hours, f"found in {_JUMP} minutes"]
    rows = [head, ["---", *["---:"] * (len(head) - 1)]]
    for day in lived:
        values = [*(day.share(span) for span in (EARLY, MIDDLE, LATE)), day.found()]
        rows.append([day.name, f"{len(day.minutes)}", *map(tables.mean_cell, values)])
    note = "In brackets 95 % intervals, BCa bootstrap over robots; none where all are alike."
    whose = dict.fromkeys(day.run for day in lived)
    return "\n".join([*map(tables.line, rows), "", note, "", *whose])


def draw(lived: Sequence[Day]) -> Figure:
    """The share of the time in the spot by the hour, with 95 % bands, and after a jump."""
    figure, (above, below) = figures.canvas(5.2 + 0.16 * len(lived), 2, 1, sharey=True)
    keys = []
    with bar() as progress:
        step = progress.add_task("intervals", total=HOURS * len(lived))
        for day, shade in zip(lived, figures.PALETTE, strict=False):
            _by_hour(above[0], day, shade, lambda: progress.advance(step))
            _after_a_jump(below[0], day, shade)
            keys.append(Line2D([], [], color=shade, label=day.name))
    above[0].set(title="Share of the time in the spot", xlabel="hours of training")
    above[0].set(xlim=(0, HOURS), xticks=range(0, HOURS + 1, 4), ylim=(0, 1))
    below[0].set(title="After a jump of the spot", xlabel="minutes", xlim=(0, _JUMP))
    figures.in_per_cent(above[0].yaxis)
    for (first, last), style in _STYLES:
        label = f"hours {first}-{last}"
        keys.append(Line2D([], [], color=figures.INK, linestyle=style, label=label))
    figure.legend(handles=keys, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def _by_hour(axis: Axes, day: Day, shade: str, tick: Callable[[], None]) -> None:
    means, ends = [], []
    for hour in range(1, HOURS + 1):
        share = day.share((hour, hour))
        means.append(share.mean())
        ends.append(intervals.mean(share))
        tick()
    middles = np.arange(HOURS) + 0.5
    axis.plot(middles, means, color=shade)
    axis.fill_between(middles, *np.array(ends).T, color=shade, alpha=0.2, linewidth=0)


def _after_a_jump(axis: Axes, day: Day, shade: str) -> None:
    for hours, style in _STYLES:
        axis.plot(np.arange(_JUMP) + 0.5, day.after_a_jump(hours), color=shade, linestyle=style)


def main(runs: Runs, output: Annotated[Path | None, option("FIGURE", "none")] = None) -> None:
    """Prints how runs of the day's course went, by the hour and after a jump.

    Args:
      runs: folders of runs of `musebot run RUN --course day`.
      output: a figure of it by the hour, an .svg or .png.
    """
    if output:
        figures.check_output(output)
    lived = days(runs)
    print(markdown(lived))
    if output:
        with figures.styled():
            figures.write(draw(lived), output)


if __name__ == "__main__":
    run_module(main)
