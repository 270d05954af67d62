"""Figures of populations: learning curves, categories, Learn Ability, and what the robots do."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..agents.names import short_name
from ..analysis import intervals
from ..analysis.behaviour import Behaviour, Stay
from ..analysis.paper_tables import paper_column
from ..experiment.conditions import PAPER_TASKS, Condition
from ..experiment.experiment import Experiment
from ..experiment.schedules import PARTS, SCHEDULES, TASK_NAMES, control_steps
from ..results.learn_ability import CATEGORIES, Summary
from ..results.run import Run
from .style import CATEGORY_COLOURS, INK, canvas, colour, in_per_cent

_STEPS = 36  # of a learning curve, about
_LEAST_LABELLED = 0.06  # share of the robots; a smaller bar has no room for its number


# ---- Learning curves ----


def learning_curves(run: Run) -> Figure:
    """Draws the mean share of the time in contact (or in the spot) over a life, with 95 % bands."""
    tasks = run.tasks()
    figure, axes = canvas(2.5 * len(tasks) + 0.3, len(tasks), 1)
    for task, axis in zip(tasks, axes[:, 0], strict=True):
        for proposer in run.proposers(task):
            curves = run.curves(Condition(task, proposer))
            if len(curves):
                steps = run.experiment.schedule(task).steps_of_minutes()
                _curve(axis, curves, steps[: curves.shape[1]], proposer)
        _parts(axis, run.experiment, task)
        axis.set_title(f"{TASK_NAMES[task]}: share of the time {SCHEDULES[task].event}", pad=16)
        axis.set_xlabel("simulated hours")
        axis.set_ylim(0, None)
        in_per_cent(axis.yaxis)
    _legend_of_proposers(figure, run)
    return figure


def _curve(axis: Axes, curves: np.ndarray, steps: np.ndarray, proposer: str) -> None:
    """Draws the curve of a condition's n robots.

    Args:
      axis: Axis to draw on.
      curves: Share of each of M minutes, shape (n, M).
      steps: Control steps of each minute, of which the last may be shorter, shape (M,).
      proposer: Proposer of the robots.
    """
    minutes = len(steps)
    width = -(-minutes // _STEPS)
    edges = np.unique(np.minimum(np.arange(0, minutes + width, width), minutes))
    points = [
        np.average(curves[:, a:b], axis=1, weights=steps[a:b])
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    means = np.array([point.mean() for point in points])
    low, high = np.array([intervals.mean(point, intervals.SHARE) for point in points]).T
    times = np.concatenate([[0], steps.cumsum()])[edges] / control_steps(60)
    hours = (times[:-1] + times[1:]) / 2
    mark = "o" if len(points) == 1 else None  # a rehearsal
    axis.plot(hours, means, color=colour(proposer), marker=mark)
    axis.fill_between(hours, low, high, color=colour(proposer), alpha=0.2, linewidth=0)


def _parts(axis: Axes, experiment: Experiment, task: str) -> None:
    """Marks the tests and the training, and names them along the upper axis."""
    hours = [experiment.schedule(task).steps_of(part) / control_steps(60) for part in PARTS]
    ends = np.cumsum(hours)
    for border in ends[:-1]:
        axis.axvline(border, color=INK, linewidth=0.7, linestyle=(0, (2, 3)))
    axis.set_xlim(0, ends[-1])
    upper = axis.secondary_xaxis("top")
    upper.set_xticks(ends - np.array(hours) / 2, ["test", "training", "test"], fontsize=8)
    upper.tick_params(length=0, pad=1)
    upper.spines[:].set_visible(False)


def _legend_of_proposers(figure: Figure, run: Run) -> None:
    names = dict.fromkeys(condition.proposer for condition in run.conditions())
    handles = [Line2D([], [], color=colour(name), label=short_name(name)) for name in names]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)


# ---- Categories ----


def categories(run: Run) -> Figure:
    """Draws the share of the robots in each category, ours above the paper's."""
    rows: dict[str, list[tuple[str, str, Summary]]] = {}
    for condition in run.conditions():
        own = rows.setdefault(condition.task, [])
        own.append((condition.proposer, "here", run.summary(condition)))
        if paper := paper_column(run.experiment, condition):
            own.append((condition.proposer, "paper", paper.summary))
    heights = [0.29 * len(own) + 0.95 for own in rows.values()]
    figure, axes = canvas(sum(heights), len(rows), 1, height_ratios=heights)
    for (task, own), axis in zip(rows.items(), axes[:, 0], strict=True):
        _stacks(axis, task, own)
    return figure


def _stacks(axis: Axes, task: str, rows: list[tuple[str, str, Summary]]) -> None:
    """Draws a stacked bar for each row, a tuple of proposer, source (ours, paper) and column."""
    proposers = [proposer for proposer, _, _ in rows]
    places = [i + 0.35 * len({*proposers[: i + 1]}) for i in range(len(rows))]
    shares = np.array([summary.shares for _, _, summary in rows])
    names = [c if c != "unmeasured" else SCHEDULES[task].unmeasured for c in CATEGORIES]
    left = np.zeros(len(rows))
    for name, values, shade in zip(names, shares.T, CATEGORY_COLOURS, strict=True):
        bars = axis.barh(
            places, values, left=left, height=0.86, color=shade, linewidth=0, label=name
        )
        texts = [f"{100 * share:.0f}" if share >= _LEAST_LABELLED else "" for share in values]
        ink = "#1b222b" if shade in CATEGORY_COLOURS[1:3] else "white"
        axis.bar_label(bars, texts, label_type="center", fontsize=8, color=ink)
        left += values
    axis.set_yticks(places, [f"{short_name(proposer)}, {whose}" for proposer, whose, _ in rows])
    for label, proposer in zip(axis.get_yticklabels(), proposers, strict=True):
        label.set_color(colour(proposer))
    axis.tick_params(length=0, labelbottom=False)
    axis.spines[:].set_visible(False)
    axis.set_xlim(0, 1)
    axis.invert_yaxis()
    axis.set_title(f"{TASK_NAMES[task]}: per cent of the robots", pad=20)
    axis.legend(
        loc="lower left", bbox_to_anchor=(0, 1), ncols=len(names), frameon=False, fontsize=8,
        borderpad=0, borderaxespad=0.2, handlelength=0.8, handletextpad=0.4, columnspacing=1.2,
    )  # fmt: skip


# ---- Learn Ability ----


def abilities(run: Run) -> Figure:
    """Draws how L is distributed among the measured robots, with L = -1 and L = 1 apart."""
    tasks = run.tasks()
    names = list(dict.fromkeys(condition.proposer for condition in run.conditions()))
    figure, axes = canvas(
        1.15 * len(names) + 0.6, len(names), len(tasks), sharex=True, sharey="col"
    )
    for row, proposer in enumerate(names):
        for column, task in enumerate(tasks):
            _histogram(axes[row, column], run, Condition(task, proposer))
            if row == 0:
                axes[row, column].set_title(TASK_NAMES[task])
            if row == len(names) - 1:
                axes[row, column].set_xlabel("Learn Ability L")
    return figure


def _histogram(axis: Axes, run: Run, condition: Condition) -> None:
    values = run.abilities(condition)
    values = values[~np.isnan(values)]
    inner = values[np.abs(values) < 1]
    counts, edges = np.histogram(inner, bins=np.linspace(-1, 1, 18))  # one of them around 0
    total = max(len(values), 1)
    shade = colour(condition.proposer)
    axis.bar((edges[:-1] + edges[1:]) / 2, counts / total, width=0.11, color=shade, alpha=0.55)
    ends = [(values == end).sum() / total for end in (-1, 1)]
    bars = axis.bar((-1.12, 1.12), ends, width=0.1, color=shade)
    axis.bar_label(bars, [f"{share:.0%}" for share in ends], padding=2, fontsize=8, color=shade)
    mean = f", mean {values.mean():.2f}" if len(values) else ""
    axis.text(
        0.5, 0.97, f"{short_name(condition.proposer)}\n{len(values)} measured{mean}", fontsize=8,
        color=shade, transform=axis.transAxes, ha="center", va="top",
    )  # fmt: skip
    axis.set_xticks([-1.12, -0.5, 0, 0.5, 1.12], ["-1", "-.5", "0", ".5", "1"])
    axis.set_yticks([])
    axis.margins(y=0.3)
    axis.spines["left"].set_visible(False)


# ---- What the robots do ----


def spinning(behaviour: Behaviour) -> Figure:
    """Draws the share of time that each robot spins before and after training, and the means."""
    tasks = [t for t in PAPER_TASKS if any(c.task == t for c in behaviour.spinning)]
    figure, axes = canvas(2.9, 1, max(len(tasks), 1), sharey=True)
    jitter = np.random.default_rng(0)
    for task, axis in zip(tasks, axes[0], strict=False):
        names = [condition.proposer for condition in behaviour.spinning if condition.task == task]
        for place, proposer in enumerate(names):
            shares, shade = behaviour.spinning[Condition(task, proposer)], colour(proposer)
            for side, when in enumerate((-0.2, 0.2)):
                x = place + when + jitter.uniform(-0.09, 0.09, len(shares))
                axis.plot(
                    x, shares[:, side], "o", ms=3.5, mew=0.8, mec=shade, alpha=0.7,
                    mfc=shade if side else "none", clip_on=False,
                )  # fmt: skip
                mean = shares[:, side].mean()
                axis.plot(
                    [place + when - 0.15, place + when + 0.15], [mean, mean], color=shade, lw=2
                )
        axis.set_xticks(range(len(names)), names)
        for label, proposer in zip(axis.get_xticklabels(), names, strict=True):
            label.set_color(colour(proposer))
            label.set_weight("bold")
        axis.tick_params(axis="x", length=0)
        axis.set_xlim(-0.5, len(names) - 0.5)
        axis.set_ylim(0, 1)
        in_per_cent(axis.yaxis)
        axis.set_title(TASK_NAMES[task], pad=10)
    axes[0, 0].set_ylabel("share of the time spinning")
    handles = [
        Line2D([], [], marker="o", ls="", ms=3.5, color=INK, mfc=face, label=f"{when} training")
        for when, face in (("before", "none"), ("after", INK))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def stays(found: Mapping[str, Stay]) -> Figure:
    """Draws how much learning robots follow the spot's contour and spin inside it, by minute."""
    figure, axes = canvas(2.6, 1, max(len(found), 1), sharey=True)
    styles = {"along the contour": (0, (3, 1.5)), "spinning inside": "-"}
    for axis, (proposer, stay) in zip(axes[0], found.items(), strict=False):
        minutes, following, inside = stay.minutes.T
        for values, style in zip((following, inside), styles.values(), strict=True):
            axis.plot(minutes + 0.5, values, color=colour(proposer), linestyle=style)
        axis.set_title(f"{proposer}, {int(stay.staying.sum())} robots", color=colour(proposer))
        axis.set_xlabel("simulated minutes")
        axis.set_ylim(0, 1)
        in_per_cent(axis.yaxis)
    axes[0, 0].set_ylabel("share of the time at the spot")
    handles = [Line2D([], [], color=INK, linestyle=s, label=name) for name, s in styles.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure
