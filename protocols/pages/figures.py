"""Figures of populations: learning curves, categories, Learn Ability, and behaviour."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...tasks.lives import STAGES, Life, Stage, control_steps
from ..agents.names import short_name
from ..analysis import intervals
from ..analysis.behaviour import Behaviour, Stay
from ..analysis.paper_tables import paper_column
from ..runs.conditions import Condition
from ..runs.learn_ability import CATEGORIES, Summary
from ..runs.run import Run
from .style import CATEGORY_COLOURS, DARK, INK, canvas, colour, in_per_cent, looks, mark_changes

_NAMES = {"pre": "test", "training": "training", "post": "test"}  # names of stages
_STEPS = 36  # points of a learning curve, approximately
_LEAST_LABELLED = 0.06  # share of the robots; a smaller bar has no room for its number


# ---- Learning curves ----


def learning_curves(run: Run) -> Figure:
    """Draws the mean share of the time in contact (or in the spot) over a life, with 95 % bands."""
    tasks = run.tasks()
    look = looks(condition.proposer for condition in run.conditions())
    figure, axes = canvas(2.5 * len(tasks) + 0.3, len(tasks), 1)
    for task, axis in zip(tasks, axes[:, 0], strict=True):
        life = run.experiment.life_of(task)
        for proposer in run.proposers(task):
            curves = run.curves(Condition(task, proposer))
            if len(curves):
                _curve(axis, curves, life, look[proposer])
        _parts(axis, life)
        axis.set_title(f"{life.title}: share of the time {life.event}", pad=16)
        axis.set_xlabel("simulated hours")
        in_per_cent(axis)
    _legend(figure, {short_name(name): own for name, own in look.items()})
    return figure


def _curve(axis: Axes, curves: np.ndarray, life: Life, look: dict[str, Any]) -> None:
    """Draws the learning curve of n robots; `curves` has their shares by minute, shape (n, M).

    No point averages minutes of both a test and training.
    """
    steps, minutes = life.steps_of_minutes(), curves.shape[1]
    # A minute that two stages share is a point of its own.
    parts = [life.minutes_of(part) for part in STAGES]
    borders = sorted({end for part in parts for end in (part.start, part.stop)})
    edges = [0]
    for first, last in zip(borders[:-1], borders[1:], strict=True):
        count = min(last - first, max(1, round((last - first) * _STEPS / minutes)))
        edges += [*np.linspace(first, last, count + 1).round().astype(int)[1:]]
    points = [
        np.average(curves[:, a:b], axis=1, weights=steps[a:b])
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    means = np.array([point.mean() for point in points])
    low, high = np.array([intervals.mean(point, intervals.SHARE) for point in points]).T
    times = np.concatenate([[0], steps.cumsum()])[edges] / control_steps(60)
    hours = (times[:-1] + times[1:]) / 2
    mark = "o" if len(points) == 1 else None  # in a rehearsal
    axis.plot(hours, means, marker=mark, **look)
    axis.fill_between(hours, low, high, color=look["color"], alpha=0.2, linewidth=0)


def _parts(axis: Axes, life: Life) -> None:
    """Marks tests, training and changes of the world; the upper axis names tests and training."""
    parts: list[Stage] = [part for part in STAGES if life.steps_of(part)]
    hours = [life.steps_of(part) / control_steps(60) for part in parts]
    ends = np.cumsum(hours)
    for border in ends[:-1]:
        axis.axvline(border, color=INK, linewidth=0.7, linestyle=(0, (2, 3)))
    mark_changes(axis, life)
    axis.set_xlim(0, ends[-1])
    upper = axis.secondary_xaxis("top")
    upper.set_xticks(ends - np.array(hours) / 2, [_NAMES[part] for part in parts], fontsize=8)
    upper.tick_params(length=0, pad=1)
    upper.spines[:].set_visible(False)


def _legend(figure: Figure, styles: Mapping[str, Mapping[str, Any]]) -> None:
    """Draws a legend below a figure: each name with a line that has its properties."""
    handles = [Line2D([], [], label=name, **{"color": INK, **own}) for name, own in styles.items()]
    where = "outside lower center"
    figure.legend(handles=handles, loc=where, ncols=3, frameon=False, fontsize=8)


# ---- Categories ----


def categories(run: Run) -> Figure | None:
    """Draws the share of robots in each category, with the paper's below unless ours are few.

    Returns None for lives without tests.
    """
    bars: dict[str, list[tuple[str, str, Summary]]] = {}
    for condition in run.conditions():
        if not run.experiment.life_of(condition.life).tested:
            continue
        own = bars.setdefault(condition.life, [])
        own.append((condition.proposer, "here", run.summary(condition)))
        if not run.few and (paper := paper_column(condition)):
            own.append((condition.proposer, "paper", paper.summary))
    if not bars:
        return None
    heights = [0.29 * len(own) + 0.95 for own in bars.values()]
    figure, axes = canvas(sum(heights), len(bars), 1, height_ratios=heights)
    for (task, own), axis in zip(bars.items(), axes[:, 0], strict=True):
        _stacks(axis, run.experiment.life_of(task), own)
    return figure


def _stacks(axis: Axes, life: Life, rows: list[tuple[str, str, Summary]]) -> None:
    """Draws a stacked bar for each row: proposer, source ("here" or "paper") and column."""
    proposers = [proposer for proposer, _, _ in rows]
    places = [i + 0.35 * len({*proposers[: i + 1]}) for i in range(len(rows))]
    shares = np.array([summary.shares for _, _, summary in rows]).T
    names = [c if c != "unmeasured" else life.unmeasured for c in CATEGORIES]
    left = np.zeros(len(rows))
    for name, values, shade in zip(names, shares, CATEGORY_COLOURS, strict=True):
        bars = axis.barh(places, values, left=left, height=0.86, color=shade, lw=0, label=name)
        texts = [f"{100 * share:.0f}" if share >= _LEAST_LABELLED else "" for share in values]
        ink = "white" if shade == CATEGORY_COLOURS[0] else DARK  # the darkest
        axis.bar_label(bars, texts, label_type="center", fontsize=8, color=ink)
        left += values
    axis.set_yticks(places, [f"{short_name(proposer)}, {whose}" for proposer, whose, _ in rows])
    axis.tick_params(length=0, labelbottom=False)
    axis.spines[:].set_visible(False)
    axis.set_xlim(0, 1)
    axis.invert_yaxis()
    axis.set_title(f"{life.title}: per cent of the robots", pad=20)
    axis.legend(
        loc="lower left", bbox_to_anchor=(0, 1), ncols=len(names), frameon=False, fontsize=8,
        borderpad=0, borderaxespad=0.2, handlelength=0.8, handletextpad=0.4, columnspacing=1.2,
    )  # fmt: skip


# ---- Learn Ability ----


def abilities(run: Run) -> Figure | None:
    """Draws the distribution of L over the robots that have one; L = -1 and L = 1 have own bars.

    Returns None for lives without tests.
    """
    tasks = [task for task in run.tasks() if run.experiment.life_of(task).tested]
    if not tasks:
        return None
    look = looks(condition.proposer for condition in run.conditions())
    figure, axes = canvas(1.35 * len(look) + 0.6, len(look), len(tasks), sharex=True, sharey="col")
    for task, column in zip(tasks, axes.T, strict=True):
        for axis, (proposer, own) in zip(column, look.items(), strict=True):
            title = _histogram(axis, run, Condition(task, proposer), own["color"])
            first = f"{run.experiment.life_of(task).title}\n" if axis is column[0] else ""
            axis.set_title(f"{first}{title}", fontsize=8)
        column[-1].set_xlabel("Learn Ability L")
    return figure


def _histogram(axis: Axes, run: Run, condition: Condition, shade: str) -> str:
    """Draws the histogram of a condition's L; returns its title."""
    values = run.abilities(condition)
    values = values[~np.isnan(values)]
    inner = values[np.abs(values) < 1]
    counts, edges = np.histogram(inner, bins=np.linspace(-1, 1, 18))  # one bin is centred on 0
    total = max(len(values), 1)
    axis.bar((edges[:-1] + edges[1:]) / 2, counts / total, width=0.11, color=shade, alpha=0.55)
    ends = [(values == end).sum() / total for end in (-1, 1)]
    bars = axis.bar((-1.12, 1.12), ends, width=0.1, color=shade)
    if len(values):
        axis.bar_label(bars, [f"{share:.0%}" for share in ends], padding=2, fontsize=8)
    axis.set_xticks([-1.12, -0.5, 0, 0.5, 1.12], ["-1", "-.5", "0", ".5", "1"])
    axis.set_xlim(-1.45, 1.45)  # room for the labels of the bars at the ends
    axis.set_yticks([0, 0.5, 1])
    in_per_cent(axis, 1.25)
    mean = f", mean {values.mean():{'z.2g' if run.few else 'z.2f'}}" if len(values) else ""
    return f"{short_name(condition.proposer)}, {len(values)} measured{mean}"


# ---- What the robots do ----


def spinning(run: Run, behaviour: Behaviour) -> Figure:
    """Draws each robot's share of time spinning, before and after training, and the means."""
    tasks = [*dict.fromkeys(condition.life for condition in behaviour.spinning)]
    figure, axes = canvas(2.9, 1, len(tasks), sharey=True)
    jitter = np.random.default_rng(0)
    for task, axis in zip(tasks, axes[0], strict=True):
        names = [condition.proposer for condition in behaviour.spinning if condition.life == task]
        for place, proposer in enumerate(names):
            own, shade = behaviour.spinning[Condition(task, proposer)], colour(proposer)
            for shares, middle, face in zip(own.T, (-0.2, 0.2), ("none", shade), strict=True):
                x = place + middle + jitter.uniform(-0.09, 0.09, len(shares))
                axis.plot(
                    x, shares, "o", ms=3.5, mew=0.8, mec=shade, alpha=0.7, mfc=face, clip_on=False
                )
                ends = place + middle - 0.15, place + middle + 0.15
                axis.plot(ends, [shares.mean()] * 2, color=shade, lw=2)
        axis.set_xticks(range(len(names)), names)
        axis.tick_params(axis="x", length=0)
        axis.set_xlim(-0.5, len(names) - 0.5)
        axis.set_title(run.experiment.life_of(task).title, pad=10)
        in_per_cent(axis, 1)
    axes[0, 0].set_ylabel("share of the time spinning")
    marks = {"marker": "o", "ls": "", "ms": 3.5}
    faces = {"before training": {"mfc": "none"}, "after training": {"mfc": INK}}
    _legend(figure, {name: marks | face for name, face in faces.items()})
    return figure


def stays(found: Mapping[str, Stay]) -> Figure:
    """Draws by minute how often learning robots follow the spot's contour and spin inside it."""
    figure, axes = canvas(2.6, 1, len(found), sharey=True)
    styles = {"along the contour": (0, (3, 1.5)), "spinning inside": "-"}
    for axis, (proposer, stay) in zip(axes[0], found.items(), strict=True):
        following, inside = stay.minutes.T
        for values, style in zip((following, inside), styles.values(), strict=True):
            axis.plot(np.arange(len(values)) + 0.5, values, color=colour(proposer), linestyle=style)
        axis.set_title(f"{proposer}, {int(stay.staying.sum())} robots")
        axis.set_xlabel("simulated minutes")
        in_per_cent(axis, 1)
    axes[0, 0].set_ylabel("share of the time at the spot")
    _legend(figure, {name: {"ls": style} for name, style in styles.items()})
    return figure
