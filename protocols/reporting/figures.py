"""Figures of populations: quiet, safe for the colour-blind, legible on light and on dark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..analysis import intervals
from ..experiment.experiment import Experiment
from ..experiment.schedules import NAMES, PARTS, SCHEDULES, control_steps
from ..playback.observation import Behaviour, Stay
from ..results.learn_ability import CATEGORIES, Summary
from ..results.results import Results
from .style import CATEGORY_COLOURS, INK, canvas, colour, in_per_cent
from .tables import papers

# ---- Learning curves ----


def learning_curves(experiment: Experiment, results: Results) -> Figure:
    """The mean share of the time in contact, or in the spot, over a life, with 95 % bands."""
    tasks = results.tasks()
    figure, axes = canvas(2.5 * len(tasks), len(tasks), 1)
    for task, axis in zip(tasks, axes[:, 0], strict=True):
        ends = []
        for proposer in results.proposers_of(task):
            curves = results.valid_curves(task, proposer)
            if len(curves):
                ends.append((_curve(axis, curves, proposer), proposer))
        _label_ends(axis, ends)
        _parts(axis, experiment, task)
        axis.set_title(f"{NAMES[task]}: share of the time {SCHEDULES[task].event}", pad=16)
        axis.set_xlabel("simulated hours")
        axis.set_ylim(0, None)
        in_per_cent(axis.yaxis)
    return figure


def _curve(axis: Axes, curves: np.ndarray, proposer: str) -> tuple[float, float]:
    """Draws a condition's curve in about 36 steps; returns where it ends."""
    minutes = curves.shape[1]
    width = -(-minutes // 36)
    edges = np.minimum(np.arange(0, minutes + width, width), minutes)
    edges = np.unique(edges)
    steps = [curves[:, a:b].mean(axis=1) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    means = np.array([step.mean() for step in steps])
    low, high = np.array([intervals.mean(step) for step in steps]).T
    middles = (edges[:-1] + edges[1:]) / 2 / 60
    axis.plot(middles, means, color=colour(proposer))
    axis.fill_between(middles, low, high, color=colour(proposer), alpha=0.2, linewidth=0)
    return float(middles[-1]), float(means[-1])


def _label_ends(axis: Axes, ends: Sequence[tuple[tuple[float, float], str]]) -> None:
    """Writes each proposer's name at its curve's end, one below the other where they meet."""
    low, high = axis.get_ylim()
    gap, previous = 0.085 * high, -np.inf
    for (x, y), proposer in sorted(ends):
        previous = max(y, previous + gap, low)
        axis.annotate(
            proposer,
            (x, previous),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            color=colour(proposer),
            weight="bold",
            annotation_clip=False,
        )


def _parts(axis: Axes, experiment: Experiment, task: str) -> None:
    """Marks the tests and the training."""
    schedule = experiment.schedule(task)
    names = {"pre": "test", "training": "training", "post": "test"}
    now = 0.0
    for part in PARTS:
        hours = schedule.steps_of(part) / control_steps(60)
        if part != "pre":
            axis.axvline(now, color=INK, linewidth=0.7, linestyle=(0, (2, 3)))
        axis.annotate(
            names[part],
            (now + hours / 2, 1),
            xytext=(0, 3),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            annotation_clip=False,
        )
        now += hours
    axis.set_xlim(0, now)


# ---- Categories ----


def categories(experiment: Experiment, results: Results) -> Figure:
    """Robots of each category, ours above the paper's."""
    bars: list[tuple[str, list[tuple[str, str, Summary]]]] = []
    for task in results.tasks():
        rows = []
        for proposer in results.proposers_of(task):
            rows.append((proposer, "here", results.summary(experiment, task, proposer)))
            if paper := papers(experiment, task, proposer):
                rows.append((proposer, "paper", paper.summary))
        bars.append((task, rows))
    heights = [0.29 * len(rows) + 0.75 for _, rows in bars]
    figure, axes = canvas(sum(heights), len(bars), 1, height_ratios=heights)
    for (task, rows), axis in zip(bars, axes[:, 0], strict=True):
        _stacks(axis, task, rows)
    return figure


def _stacks(axis: Axes, task: str, rows: list[tuple[str, str, Summary]]) -> None:
    places, y = [], 0.0
    for index, (proposer, whose, summary) in enumerate(rows):
        if index and rows[index - 1][0] != proposer:
            y += 0.35
        left = 0.0
        for share, shade in zip(summary.shares, CATEGORY_COLOURS, strict=True):
            axis.barh(y, share, left=left, height=0.86, color=shade, linewidth=0)
            if share >= 0.06:
                dark = shade in CATEGORY_COLOURS[1:3]
                text = f"{100 * share:.0f}"
                axis.text(
                    left + share / 2,
                    y,
                    text,
                    ha="center",
                    va="center",
                    fontsize=8,
                    color="#1b222b" if dark else "white",
                )
            left += share
        axis.text(-0.01, y, whose, ha="right", va="center", fontsize=8)
        if whose == "here":
            shift = 0.5 if index + 1 < len(rows) and rows[index + 1][0] == proposer else 0.0
            axis.text(
                -0.105, y + shift, proposer, ha="right", va="center",
                color=colour(proposer), weight="bold",
            )  # fmt: skip
        places.append(y)
        y += 1
    axis.set_xlim(-0.25, 1)
    axis.set_ylim(max(places) + 0.5, -0.5)
    axis.axis("off")
    axis.set_title(f"{NAMES[task]}: per cent of the robots", pad=18, x=0.2)
    _key(axis, [c if c != "unmeasured" else SCHEDULES[task].unmeasured for c in CATEGORIES])


def _key(axis: Axes, names: list[str]) -> None:
    """Names the colours above the bars, in the bars' order."""
    x = 0.2
    for name, shade in zip(names, CATEGORY_COLOURS, strict=True):
        axis.annotate(
            "\N{BLACK SQUARE}", (x, 1), xycoords="axes fraction", xytext=(0, 4),
            textcoords="offset points", color=shade, fontsize=10,
        )  # fmt: skip
        axis.annotate(
            name, (x, 1), xycoords="axes fraction", xytext=(11, 5),
            textcoords="offset points", fontsize=8,
        )  # fmt: skip
        x += 0.045 + 0.0155 * len(name)


# ---- Learn Ability ----


def abilities(results: Results) -> Figure:
    """How Learn Ability is distributed among measured robots, the two ends by themselves."""
    tasks = results.tasks()
    names = list(dict.fromkeys(proposer for _, proposer in results.conditions()))
    figure, axes = canvas(
        1.15 * len(names) + 0.6, len(names), len(tasks), sharex=True, sharey="col"
    )
    for row, proposer in enumerate(names):
        for column, task in enumerate(tasks):
            _histogram(axes[row, column], results, task, proposer)
            if row == 0:
                axes[row, column].set_title(NAMES[task])
            if row == len(names) - 1:
                axes[row, column].set_xlabel("Learn Ability L")
    return figure


def _histogram(axis: Axes, results: Results, task: str, proposer: str) -> None:
    values = np.array([row.learn_ability for row in results.of(task, proposer)])
    values = values[~np.isnan(values)]
    inner = values[np.abs(values) < 1]
    counts, edges = np.histogram(inner, bins=np.linspace(-1, 1, 17))
    total = max(len(values), 1)
    shade = colour(proposer)
    axis.bar((edges[:-1] + edges[1:]) / 2, counts / total, width=0.115, color=shade, alpha=0.55)
    for end in (-1, 1):
        share = (values == end).sum() / total
        axis.bar(end * 1.12, share, width=0.1, color=shade)
        axis.annotate(
            f"{share:.0%}", (end * 1.12, share), xytext=(0, 2), textcoords="offset points",
            ha="center", fontsize=8, color=shade,
        )  # fmt: skip
    mean = f", mean {values.mean():.2f}" if len(values) else ""
    axis.text(
        0.5, 0.97, f"{proposer}\n{len(values)} measured{mean}", transform=axis.transAxes,
        ha="center", va="top", color=shade, fontsize=8,
    )  # fmt: skip
    axis.set_xticks([-1.12, -0.5, 0, 0.5, 1.12], ["-1", "-.5", "0", ".5", "1"])
    axis.set_yticks([])
    axis.margins(y=0.18)
    axis.spines["left"].set_visible(False)


# ---- What the brains do ----


def spinning(behaviour: Behaviour) -> Figure:
    """Each robot's share of the time that it spins, before and after training, and the means."""
    tasks = [task for task in SCHEDULES if any(t == task for t, _ in behaviour.spinning)]
    figure, axes = canvas(2.6, 1, max(len(tasks), 1), sharey=True)
    jitter = np.random.default_rng(0)
    for task, axis in zip(tasks, axes[0], strict=False):
        names = [proposer for t, proposer in behaviour.spinning if t == task]
        for place, proposer in enumerate(names):
            shares, shade = behaviour.spinning[task, proposer], colour(proposer)
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
        axis.set_title(NAMES[task], pad=16)
        axis.annotate(
            "hollow before, filled after training", (0, 1), xycoords="axes fraction",
            xytext=(0, 4), textcoords="offset points", fontsize=8,
        )  # fmt: skip
    axes[0, 0].set_ylabel("spinning, of the test's beginning")
    return figure


def stays(found: dict[str, Stay]) -> Figure:
    """What learning robots do at the spot, minute by minute: along its contour, or spinning."""
    figure, axes = canvas(2.6, 1, max(len(found), 1), sharey=True)
    for axis, (proposer, stay) in zip(axes[0], found.items(), strict=False):
        minutes, following, inside = stay.minutes.T
        for values, style, name in (
            (following, (0, (3, 1.5)), "along the contour"),
            (inside, "-", "spinning inside"),
        ):
            axis.plot(minutes + 0.5, values, color=colour(proposer), linestyle=style, label=name)
        axis.set_title(f"{proposer}, {int(stay.staying.sum())} robots", color=colour(proposer))
        axis.set_xlabel("simulated minutes")
        axis.set_ylim(0, 1)
        in_per_cent(axis.yaxis)
    axes[0, 0].set_ylabel("of the time at the spot")
    lines = axes[0, 0].lines
    key = figure.legend(
        lines, [str(line.get_label()) for line in lines], frameon=False, fontsize=8,
        loc="outside lower center", ncols=2,
    )  # fmt: skip
    for handle in key.legend_handles:
        handle.set_color(INK)  # type: ignore[union-attr]
    return figure
