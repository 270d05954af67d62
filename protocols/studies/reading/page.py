"""The page of the study: what each finished stage says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ....controller import PROPOSERS
from ...analysis import intervals
from ...analysis.paper_numbers import PAPER
from ...analysis.scores import log_likelihood, main_effect, newborn_score, unmet_before, verdict
from ...experiment.conditions import PAPER_TASKS, Condition
from ...experiment.schedules import TASK_NAMES
from ...reporting.markdown import table
from ...reporting.tables import joint_tests
from ...results.learn_ability import total_variation
from ...results.run import Run
from .choices import CHOICES, COLUMNS, DESIGN, FINALISTS
from .newborns import NewbornJob

_DRAWS = 200  # of the newborns, for the error of a choice
_REWARDED = {"walls": "wall_avoidance", "spot": "spot_finding"}


def hypothesis(run: Run) -> str:
    """Returns the table of stage 0."""
    head = ["condition", "shares of the classes", "paper", "total variation (by chance)"]
    rows = [[*head, "mean L", "paper", "time after training", "paper", "log likelihood"]]
    for condition in run.conditions():
        own, paper = run.summary(condition), PAPER[condition]
        chance = intervals.chance_variation(own, paper)
        rows.append(
            [
                str(condition),
                " ".join(map(str, own.counts)),
                " ".join(map(str, paper.counts)),
                f"{total_variation(own, paper):.3f} ({chance:.3f})",
                *(f"{x:.3f}" for x in (own.mean, paper.mean, own.post_share, paper.post_share)),
                f"{log_likelihood(run, condition):.1f}",
            ]
        )
    joint = ", ".join(f"{name} p = {p:.4f}" for name, p in joint_tests(run).items())
    robots = max(run.summary(condition).robots for condition in run.conditions())
    return "\n".join(
        [
            "### Stage 0: the plain reading",
            "",
            f"{robots} robots in each condition, seed {run.experiment.seed}. Classes: L = 1, "
            "0 < L < 1, L = 0, L < 0, unmeasured; L rounded to two decimals.",
            "",
            *table(rows),
            "",
            f"Joint test: {joint}.",
            "",
        ]
    )


def newborns(jobs: Sequence[NewbornJob], robots: int) -> list[str]:
    """Returns the tables of stage 1; empty if no cell is finished."""
    unmet: dict[str, dict[Condition, np.ndarray | None]] = {}
    for job in jobs:
        unmet.setdefault(job.cell, {})[job.condition] = job.unmet()
    done = {
        name: {c: x for c, x in own.items() if x is not None}
        for name, own in unmet.items()
        if not any(x is None for x in own.values())
    }
    if not done:
        return []
    scores = {
        n: {c: newborn_score(x.mean(), robots, c) for c, x in o.items()} for n, o in done.items()
    }
    lines = [
        "### Stage 1: newborns",
        "",
        f"Share of {robots} newborns without contact, or never in the spot, before training. "
        "Score: see docs/plans/reading.md; higher is better.",
        "",
    ]
    for short, task in _REWARDED.items():
        columns = [Condition(task, proposer) for proposer in PROPOSERS]
        rows = [[TASK_NAMES[task].lower(), *PROPOSERS, "score"]]
        bounds = [unmet_before(column) for column in columns]
        printed = [f"{a:.3f}" if a == b else f"{a:.3f} to {b:.3f}" for a, b in bounds]
        rows.append(["paper", *printed, ""])
        for name, own in done.items():
            if name.startswith(short):
                total = sum(scores[name].values())
                cells = [f"{own[column].mean():.3f}" for column in columns]
                rows.append([name.removeprefix(f"{short}-"), *cells, f"{total:.1f}"])
        lines += [*table(rows), ""]
    rows = [["instead of the plain reading's", *TASK_NAMES.values(), "error", "verdict"]]
    for own, others in _LEVELS:
        rows += [_matched(done, (own, other)) for other in others]
    lines += [
        "Mean difference of the score, other value minus the plain reading's, over cells that "
        f"differ in nothing else; its standard error from {_DRAWS} draws of robots, which are the "
        "same newborns in all cells. Left out: refused moves "
        "with contact `near`, which is hardly ever sensed, because a refused robot stops short of "
        "the wall.",
        "",
        *table(rows, "lrrrl"),
        "",
    ]
    return lines


# Parts of a cell's name after its task: the plain reading's value, and the others.
_LEVELS = (
    ("refuses", ("holds", "slides")),
    ("200mm", ("250mm", "120mm", "300mm")),
    ("pushed", ("near",)),
    ("centre", ("front",)),
)


def _matched(
    unmet: Mapping[str, Mapping[Condition, np.ndarray]], levels: tuple[str, str]
) -> list[str]:
    """Returns a row: the mean difference of matched cells in each task, and the verdict."""
    own, other = levels
    kept = [n for n in unmet if not ("refuses" in n and n.endswith("near"))]
    pairs = [(n, m) for n in kept if (m := n.replace(other, own)) != n and m in kept]
    means: dict[Condition, float] = {}
    noise = 0.0
    random = np.random.default_rng(1)
    for condition in COLUMNS:
        mine = [
            (unmet[n][condition], unmet[m][condition]) for n, m in pairs if condition in unmet[n]
        ]
        if not mine:
            continue
        robots = len(mine[0][0])
        draws = np.vstack([np.arange(robots), random.integers(robots, size=(_DRAWS, robots))])
        found = [
            np.mean(
                [
                    newborn_score(first[draw].mean(), robots, condition)
                    - newborn_score(second[draw].mean(), robots, condition)
                    for first, second in mine
                ]
            )
            for draw in draws
        ]
        means[condition] = float(found[0])
        noise += float(np.var(found[1:]))
    by_task = {t: sum(d for c, d in means.items() if c.task == t) for t in PAPER_TASKS}
    cells = [f"{by_task[t]:+.1f}" if any(c.task == t for c in means) else "-" for t in PAPER_TASKS]
    said = verdict(means, math.sqrt(noise)) if means else "not simulated"
    return [f"{other} for {own}", *cells, f"{math.sqrt(noise):.1f}", said]


def standard_error(effects: Sequence[float]) -> float:
    """Returns the standard error of stage 2's effects, one of each column of `DESIGN`."""
    empty = np.array(effects[len(CHOICES) :])
    return float(np.sqrt(np.mean(empty**2)))  # without noise they are 0: no mean is subtracted


def screening(runs: Mapping[str, Run]) -> list[str]:
    """Returns the tables of stage 2; effects only if all combinations are finished."""
    if not runs:
        return []
    creative = [Condition(task, "creative") for task in PAPER_TASKS]
    scores = {n: {c: log_likelihood(run, c) for c in creative} for n, run in runs.items()}
    rows = [["combination", *(TASK_NAMES[c.task].lower() for c in creative)]]
    rows += [[name, *(f"{own[c]:.1f}" for c in creative)] for name, own in scores.items()]
    lines = ["### Stage 2: screening", "", "Log likelihood, creative robots.", "", *table(rows), ""]
    if len(scores) < len(DESIGN):
        return [*lines, f"{len(scores)} of {len(DESIGN)} combinations are finished.", ""]
    effects = {
        c: [main_effect([own[c] for own in scores.values()], column) for column in DESIGN.T]
        for c in creative
    }
    errors = {c: standard_error(own) for c, own in effects.items()}
    rows = [["choice", *(TASK_NAMES[c.task].lower() for c in creative), "verdict"]]
    for number, choice in enumerate(CHOICES):
        own = {c: effects[c][number] for c in creative if c.task in choice.tasks}
        error = math.hypot(*(errors[c] for c in own))
        cells = [f"{own[c]:+.1f}" if c in own else "-" for c in creative]
        rows.append([choice.says, *cells, verdict(own, error)])
    said = ", ".join(f"{TASK_NAMES[c.task].lower()} {errors[c]:.1f}" for c in creative)
    return [
        *lines,
        *table(rows, "lrrl"),
        "",
        f"Standard errors, from three empty columns: {said}.",
        "",
    ]


def finals(runs: Mapping[str, Run]) -> list[str]:
    """Returns the table of stage 3, a row for each finished finalist; empty without one."""
    rows = [["differs in", *map(str, COLUMNS), *TASK_NAMES.values(), "score minus the plain's"]]
    for name, finalist in FINALISTS.items():
        if name not in runs:
            continue
        run, cells, totals = runs[name], [], dict.fromkeys(PAPER_TASKS, 0.0)
        beside = _beside(run, runs.get("final-plain", run))
        for condition in COLUMNS:
            if condition not in run.results:
                cells.append("")
                totals[condition.task] = math.nan
                continue
            own, paper = run.summary(condition), PAPER[condition]
            chance = intervals.chance_variation(own, paper)
            variation = f"{total_variation(own, paper):.3f} ({chance:.3f})"
            cells.append(f"{variation}, {own.mean:.2f}, {own.post_share:.3f}")
            totals[condition.task] += log_likelihood(run, condition)
        tests = joint_tests(run)
        ends = [
            ""
            if math.isnan(total)
            else f"{total:.1f}, p = {tests.get(TASK_NAMES[task].lower(), math.nan):.4f}"
            for task, total in totals.items()
        ]
        rows.append([finalist.says, *cells, *ends, beside])
    if len(rows) == 1:
        return []
    return [
        "### Stage 3: finalists",
        "",
        "Of each column total variation (by chance), mean L, time after training; of each table "
        "the sum of its columns' log likelihoods, and p of its joint test. Last, the sum of the "
        "log likelihoods of the row's own columns minus that of the plain reading's same columns, "
        "for each table. Empty: not simulated, since the choice does not act there.",
        "",
        *table(rows),
        "",
    ]


def _beside(run: Run, plain: Run) -> str:
    """Returns the score of a run's columns minus the plain reading's, for each table it has."""
    if run is plain:
        return ""
    found = {}
    for condition in COLUMNS:
        if condition in run.results and condition in plain.results:
            own, other = (log_likelihood(one, condition) for one in (run, plain))
            task = TASK_NAMES[condition.task].lower()
            found[task] = found.get(task, 0.0) + own - other
    return ", ".join(f"{task} {difference:+.1f}" for task, difference in found.items())
