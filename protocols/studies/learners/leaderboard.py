"""The study that ranks learners by kept runs, between a newborn and a hand-coded robot.

R. Agarwal, M. Schwarzer, P. S. Castro, A. Courville and M. G. Bellemare, "Deep Reinforcement
Learning at the Edge of the Statistical Precipice", NeurIPS 2021: interquartile means.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from ...agents.agent_check import Costs
from ...agents.names import MOVED, is_own, short_name
from ...analysis import intervals
from ...analysis.hypothesis_tests import holm, same_statistic
from ...errors import InputError
from ...experiment.conditions import Condition
from ...experiment.experiment import Experiment
from ...experiment.manifest import UNREADABLE
from ...experiment.schedules import TASK_NAMES
from ...reporting import style
from ...reporting.markdown import bracket, mean_cell, table
from ...results.run import Run
from ...results.run_files import read_runs
from ...shared_options import Runs, option
from ...simulation.jobs import Job
from ...storage import read_json, resolved
from ..study import STUDY_FILE, Page, Study
from .costs import CostJob

LOWER, UPPER = "newborn", "hand_coded"
FOLDER = "costs"
_RESAMPLES, _SEED = 2000, 1
_LINE_STYLES = ("-", "--")


@dataclasses.dataclass
class Leaderboard(Study):
    """Rank learners in kept runs, between a newborn and a hand-coded robot.

    Each protocol and task is a board; the runs of a board must hold the agents `newborn` and
    `hand_coded`, which are its bounds.
    """

    name: ClassVar[str] = "leaderboard"

    runs: Runs
    """folders of finished runs of `musebot run`"""
    tuned: Annotated[tuple[Path, ...], option("OUT ..", "none")] = ()
    """folders of `musebot study tune`, whose effort is printed"""

    @functools.cached_property
    def _read(self) -> list[Run]:
        return read_runs(self.runs)

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        boards(self._read)
        return {run.name: run.experiment for run in self._read}

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`: the effort of tuning."""
        return {"effort": self._effort}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / FOLDER]

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: measures each learner once in each task and protocol."""
        yield [
            self._job(out, entry)
            for entries in boards(self._read).values()
            for entry in entries
            if is_own(entry.condition.proposer)
        ]

    @functools.cached_property
    def _effort(self) -> dict[str, str]:
        """What was tuned, by agent and signals, in words."""
        return dict(map(effort, self.tuned))

    def _job(self, out: Path, entry: Entry) -> CostJob:
        experiment, name = entry.experiment, entry.name.replace(", ", "-").replace(" ", "-")
        name = f"{experiment.protocol}-{entry.condition.task}-{experiment.arena_scale:g}-{name}"
        return CostJob(resolved(out) / FOLDER / f"{name}.safetensors", experiment, entry.condition)

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        parts, figures = [], {}
        with style.styled():
            for name, entries in boards(self._read).items():
                jobs = {entry.name: self._job(out, entry) for entry in entries}
                costs = {name: job.costs() for name, job in jobs.items() if job.done()}
                parts += markdown(name, entries, costs, self._effort)
                figures[name.replace(" ", "-").replace(",", "")] = draw(entries)
        return Page("\n".join(parts), figures)


@dataclasses.dataclass(frozen=True)
class Entry:
    """A learner on a board.

    Attributes:
      name: Name of the learner, with its track or its brain.
      command: Words of `musebot run` that simulate it.
      experiment: Experiment of its run.
      condition: Condition of its robots.
      after: Value of each valid robot in the test after training, shape (n,): share of the time in
        the spot, or without contact.
      training: The same over all of training.
      curve: Mean value in each minute of training, shape (M,).
      abilities: Learn Ability of each robot; NaN without one.
    """

    name: str
    command: str
    experiment: Experiment
    condition: Condition
    after: np.ndarray
    training: np.ndarray
    curve: np.ndarray
    abilities: np.ndarray


def boards(runs: Sequence[Run]) -> dict[str, list[Entry]]:
    """Returns the entries of each board, by "protocol task", with the arena's scale if it is not 1.

    Raises:
      InputError: a learner stands twice on a board, has no valid robot, or a board lacks a bound.
    """
    found: dict[str, list[Entry]] = {}
    for run in runs:
        for condition in run.conditions():
            entry = _entry(run, condition)
            name = f"{run.experiment.protocol} {condition.task}"
            if run.experiment.arena_scale != 1:
                name += f" {run.experiment.arena_scale:g}"
            board = found.setdefault(name, [])
            if not len(entry.after):
                raise InputError(f"{run.name} has no valid robot of {entry.name}")
            if any(entry.name == other.name for other in board):
                raise InputError(f"{entry.name} stands in two runs with {condition.task}")
            board.append(entry)
    for name, entries in found.items():
        for bound in (LOWER, UPPER):
            if bound not in {entry.name for entry in entries}:
                raise InputError(f"the runs of {name} hold no robots of {bound}, a bound")
    return found


def _entry(run: Run, condition: Condition) -> Entry:
    experiment = run.experiment
    schedule = experiment.schedule(condition.task)
    curves = run.curves(condition)[:, schedule.minutes_of("training")].astype(float)
    after = run.shares(condition, "post")
    if not schedule.wanted:
        curves, after = 1 - curves, 1 - after
    if condition.has_brain:
        name = f"{experiment.brain_name}, {condition.proposer}"
        command = f"--brain {experiment.brain_name} --proposer {condition.proposer}"
    else:
        short = short_name(condition.proposer)
        raw = experiment.signals == "raw" and short not in (LOWER, UPPER)
        name = f"{short}, raw signals" if raw else short
        command = f"--agent {short}" + (" --signals raw" if raw else "")
        if experiment.settings:
            command += f" --agent-set {' '.join(experiment.settings)}"
    if experiment.arena_scale != 1:
        command += f" --arena-scale {experiment.arena_scale:g}"
    return Entry(
        name,
        command,
        experiment,
        condition,
        after,
        curves.mean(axis=1),
        curves.mean(axis=0),
        run.abilities(condition),
    )


def scores(entry: Entry, lower: Entry, upper: Entry) -> np.ndarray:
    """Returns each robot's score: the mean of both values, 0 like a newborn and 1 like hand-coded.

    NaN where the bounds do not differ.
    """
    parts = []
    for own, low, high in (
        (entry.after, lower.after, upper.after),
        (entry.training, lower.training, upper.training),
    ):
        span = high.mean() - low.mean()
        parts.append((own - low.mean()) / span if span > 0 else np.full(len(own), math.nan))
    return np.mean(parts, axis=0)


def interquartile_mean(values: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Returns the mean without the lowest and highest quarter, and its 95 % bootstrap interval."""
    random = np.random.default_rng(_SEED)
    draws = values[random.integers(len(values), size=(_RESAMPLES, len(values)))]
    means = stats.trim_mean(draws, 0.25, axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(stats.trim_mean(values, 0.25)), (float(low), float(high))


def ranked(entries: Sequence[Entry]) -> list[tuple[Entry, np.ndarray]]:
    """Returns the entries with their robots' scores, the highest interquartile mean first."""
    by_name = {entry.name: entry for entry in entries}
    lower, upper = by_name[LOWER], by_name[UPPER]
    found = [(entry, scores(entry, lower, upper)) for entry in entries]
    return sorted(
        found, key=lambda one: (-np.nan_to_num(interquartile_mean(one[1])[0]), one[0].name)
    )


def behind_the_first(ranking: Sequence[tuple[Entry, np.ndarray]]) -> list[float]:
    """Returns p of each learner against the first, Holm over all pairs of learners.

    Bounds have NaN, and so has the first learner. Permutation tests of the mean score.
    """
    learners = [n for n, (entry, _) in enumerate(ranking) if entry.name not in (LOWER, UPPER)]
    pairs = list(itertools.combinations(learners, 2))
    values = [
        same_statistic(ranking[a][1], ranking[b][1], np.nanmean, False, max(2000, 200 * len(pairs)))
        for a, b in pairs
    ]
    found = dict(zip(pairs, holm(np.array(values)), strict=True))
    return [
        float(found.get((learners[0], n), math.nan)) if learners else math.nan
        for n in range(len(ranking))
    ]


def effort(folder: Path) -> tuple[str, str]:
    """Returns the agent and signals that a study has tuned, "name, signals", and its effort.

    Raises:
      InputError: the folder holds no study that tunes.
    """
    path = folder / STUDY_FILE
    try:
        held = read_json(path)
        details, whole = held["details"], held["experiments"]["whole"]
        key = f"{details['agent']}, {whole['signals']}"
        trials, robots = len(details["trials"]), int(whole["cohort_size"])
        return key, f"{trials} settings, {int(details['kept'])} in whole lives, {robots} robots"
    except (*UNREADABLE, OSError) as error:
        raise InputError(f"{path} is no study `tune` of musebot's ({error!r:.200})") from error


def markdown(
    name: str,
    entries: Sequence[Entry],
    costs: Mapping[str, Costs],
    efforts: Mapping[str, str],
) -> list[str]:
    """Returns a board: a row for each learner.

    Args:
      name: Name of the board, see `boards`.
      entries: Learners and bounds.
      costs: What each costs, by its name.
      efforts: Effort of tuning, by "agent, signals".
    """
    ranking = ranked(entries)
    protocol, task, *scale = name.split()
    arena = f", arena {scale[0]} times as large" if scale else ""
    what = "in the spot" if task == "spot_finding" else "without contact"
    rows = [
        [
            "learner", "robots", "score", f"{what} after training", "during training",
            "worst tenth", "fail", "mean L", "p against the first",
        ]
    ]  # fmt: skip
    for (entry, values), p in zip(ranking, behind_the_first(ranking), strict=True):
        middle, interval = interquartile_mean(values)
        worst = np.sort(entry.after)[: math.ceil(len(entry.after) / 10)].mean()
        abilities = entry.abilities[~np.isnan(entry.abilities)]
        rows.append(
            [
                f"*{entry.name}*" if entry.name in (LOWER, UPPER) else entry.name,
                str(len(values)),
                "-" if math.isnan(middle) else f"{middle:.3f} {bracket(interval)}".strip(),
                mean_cell(entry.after, intervals.SHARE),
                mean_cell(entry.training, intervals.SHARE),
                f"{worst:.3f}",
                f"{(values < 0.5).mean():.0%}",
                f"{abilities.mean():.2f}" if len(abilities) else "-",
                "" if math.isnan(p) else f"{p:.4f}",
            ]
        )
    made = [["learner", "time", "KiB", "tuned", "module", "`musebot run OUT` with"]]
    made += [
        [
            entry.name,
            *_costs(costs.get(entry.name)),
            _tuned(entry, efforts),
            f"`{module_of(entry.condition.proposer)}`",
            f"`{entry.command}`",
        ]
        for entry, _ in ranking
    ]
    return [
        f"## {TASK_NAMES[task]}, protocol {protocol}{arena}",
        "",
        *table(rows),
        "",
        "Score: mean of the time after training and of that during all of training, each 0 for "
        "the mean newborn and 1 for the mean hand-coded robot; interquartile mean over robots with "
        "its 95 % bootstrap interval. Fail: share of robots with a score below 0.5. p: permutation "
        "test of the mean score, Holm over all pairs of learners. In italics the bounds.",
        "",
        *table(made),
        "",
        "Time: of a robot-step without the simulation, as a multiple of the paper's creative "
        "brain's, measured right after; KiB: a robot's in a checkpoint. Tuned: settings that were "
        "tried for a quarter of the time, then in whole lives.",
        "",
    ]


def _costs(found: Costs | None) -> list[str]:
    if found is None:
        return ["-", "-"]
    return [f"{found.microseconds / found.papers:.1f}", f"{found.bytes / 1024:.1f}"]


def _tuned(entry: Entry, efforts: Mapping[str, str]) -> str:
    if entry.name in (LOWER, UPPER):
        return ""
    if entry.condition.has_brain:
        return "by hand" if entry.experiment.brain_name.startswith("steady") else "as published"
    key = f"{entry.condition.proposer}, {entry.experiment.signals}"
    return efforts.get(key, "defaults")


def module_of(proposer: str) -> str:
    """Returns the module of an agent, or that of the three proposers' brain."""
    name = MOVED.get(proposer, proposer)
    return name.partition(":")[0] if ":" in name else "musebot.controller"


def draw(entries: Sequence[Entry]) -> Figure:
    """Draws the learning curve of each entry, ten minutes a point, named at its end."""
    figure, axes = style.canvas(3.2, 1, 1)
    axis = axes.flat[0]
    ends = {}
    for number, (entry, _) in enumerate(ranked(entries)):
        whole = max(len(entry.curve) // 10 * 10, 1)
        width = min(10, whole)
        points = entry.curve[: whole // width * width].reshape(-1, width).mean(axis=1)
        hours = (np.arange(len(points)) + 1) * width / 60
        shade = style.PALETTE[number % len(style.PALETTE)]
        dashes = _LINE_STYLES[number // len(style.PALETTE) % len(_LINE_STYLES)]
        axis.plot(hours, points, color=shade, linestyle=dashes, linewidth=1.2)
        ends[entry.name] = (float(points[-1]), shade)
    axis.set(xlabel="hours of training", ylabel="share of time", ylim=(0, 1))
    style.label_ends(axis, float(axis.lines[0].get_xdata()[-1]), ends)
    return figure
