"""The study of readings of the paper: a hypothesis, newborns, and a screening of choices."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...controller import PROPOSERS
from ...tasks import CONTROL_TIMESTEP
from ..analysis import intervals
from ..analysis.paper_numbers import PAPER
from ..analysis.scores import log_likelihood, main_effect, newborn_score, unmet_before, verdict
from ..errors import InputError
from ..experiment.conditions import PAPER_TASKS, CohortKey, Condition
from ..experiment.experiment import Experiment
from ..experiment.overrides import READINGS
from ..experiment.plan import Plan
from ..experiment.schedules import TASK_NAMES
from ..reporting.markdown import table
from ..reporting.tables import joint_tests
from ..results.learn_ability import total_variation
from ..results.run import Run
from ..results.run_files import read_run
from ..simulation.cohort import Cohort
from ..simulation.jobs import CohortJob, Job, Report, Stop
from ..storage import resolved, save_arrays
from .study import MinuteTick, Page, StoppedError, check_positive, own_arrays
from .variants import Variant, VariantStudy

PLAIN, NEWBORNS = "plain", "newborns"
SEEDS = (2004, 2104, 2204)  # of the three stages
SPEEDS = (0.2, 0.25, 0.12, 0.3)  # [m/s], in the order in which newborns are simulated
WALLS = ("refuses", "holds", "slides")
COLUMNS = [Condition(task, proposer) for task in PAPER_TASKS for proposer in PROPOSERS]

_REWARDED = {"walls": "wall_avoidance", "spot": "spot_finding"}


@dataclasses.dataclass(frozen=True)
class Choice:
    """A choice of two values in the screening.

    Attributes:
      says: What +1 and -1 mean, in words.
      values: Values of the experiment's fields at level +1, and at level -1, by field; "part.field"
        is a field of a part.
      tasks: Tasks in which the choice can affect the robots.
    """

    says: str
    values: tuple[Mapping[str, Any], Mapping[str, Any]]
    tasks: tuple[str, ...] = PAPER_TASKS


CHOICES = (
    Choice(
        "a refused move, not one up to the wall",
        ({"kinematics.wall": "refuses"}, {"kinematics.wall": "holds"}),
    ),
    Choice("0.2, not 0.25 m/s", ({"motor_speed": 0.2}, {"motor_speed": 0.25})),
    Choice(
        "nose at the centre, not at the front",
        ({"nose_place": "centre"}, {"nose_place": "front"}),
        ("spot_finding",),
    ),
    Choice(
        "Eq. 3 as printed, not r/d", ({"nose": "printed"}, {"nose": "inverse"}), ("spot_finding",)
    ),
    Choice(
        "value of the selected, not of the best action",
        ({"brain.bootstrap": "on_policy"}, {"brain.bootstrap": "max"}),
    ),
    Choice(
        "no learning across a placement",
        ({"learn_across_placement": False}, {"learn_across_placement": True}),
        ("wall_avoidance",),
    ),
    Choice("start faces the corner, not away", ({"turned_start": 0.0}, {"turned_start": 180.0})),
    Choice("Euler's step, not an arc", ({"kinematics.path": "euler"}, {"kinematics.path": "arc"})),
)
_FIRST = (1, 1, -1, 1, 1, 1, -1, -1, -1, 1, -1)  # row of Plackett and Burman's design of 12 runs
DESIGN = np.array([np.roll(_FIRST, shift) for shift in range(11)] + [[-1] * 11])


def plain(seed: int, robots: int, time_scale: float) -> Experiment:
    """Returns the plain reading (docs/paper.md) with one cohort of robots in each condition."""
    own: Any = READINGS[PLAIN]
    return Experiment(seed=seed, cohort_size=robots, time_scale=time_scale, **own)


def changed(experiment: Experiment, values: Mapping[str, Any]) -> Experiment:
    """Returns an experiment with some fields replaced; "brain.epsilon" is a field of a part."""
    for name, value in values.items():
        part, _, inner = name.partition(".")
        if inner:
            value = dataclasses.replace(getattr(experiment, part), **{inner: value})
        experiment = dataclasses.replace(experiment, **{part: value})
    return experiment


@dataclasses.dataclass(frozen=True)
class NewbornJob:
    """Simulates the tests before training of a cohort, and stores the time of the event.

    Attributes:
      folder: Folder of the file, an absolute path.
      cell: Name of the experiment.
      experiment: Experiment of the robots.
      condition: Condition of the robots.
    """

    folder: Path
    cell: str
    experiment: Experiment
    condition: Condition

    def __str__(self) -> str:
        return f"{self.cell}, {self.condition}"

    @property
    def path(self) -> Path:
        """See `Job.path`."""
        return self.folder / f"{self.cell}-{self.condition.proposer}.safetensors"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return self._steps * CONTROL_TIMESTEP * self.experiment.cohort_size

    @property
    def _steps(self) -> int:
        return self.experiment.schedule(self.condition.task).steps_of("pre")

    def done(self) -> bool:
        """See `Job.done`."""
        return self.path.exists()

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; tests that were stopped start from the beginning."""
        cohort = Cohort(self.experiment, CohortKey(self.condition, 0))
        tick = MinuteTick(self, self.experiment.cohort_size, stop, report)
        try:
            while cohort.step < self._steps:
                cohort.advance(min(600, self._steps - cohort.step))
                tick()
        except StoppedError:
            return False
        steps = cohort.lives().events[:, 0]
        save_arrays(self.path, {"steps": steps}, **self._identity)
        return True

    def unmet(self) -> float:
        """Returns the share of robots without the event; NaN if the job is not done."""
        if not self.done():
            return math.nan
        return float((self.steps() == 0).mean())

    def steps(self) -> np.ndarray:
        """Reads the steps with the event in each robot's test, shape (B,).

        Raises:
          DamagedFileError: the file is damaged, or another job's.
        """
        shapes = {"steps": ("I32", (self.experiment.cohort_size,))}
        return own_arrays(self.path, shapes, self._identity)["steps"]

    @property
    def _identity(self) -> dict[str, str]:
        return {"cell": self.cell, "proposer": self.condition.proposer}


@dataclasses.dataclass
class Reading(VariantStudy):
    """Compare readings of the paper by what they make of its tables.

    Stage 0 simulates the plain reading, stage 1 the tests before training of newborns in other
    worlds, stage 2 creative robots with twelve combinations of eight choices
    (docs/plans/reading.md). The page shows what is finished.
    """

    name: ClassVar[str] = "reading"

    robots: int = 500
    """number of robots in each condition of stage 0"""
    newborns: int = 250
    """number of robots in each cell of stage 1"""
    screened: int = 250
    """number of robots in each cell of stage 2"""
    stage: int = 2
    """last stage to simulate: 0, 1 or 2"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def baseline(self) -> Experiment:
        """See `VariantStudy.baseline`."""
        return plain(SEEDS[0], self.robots, self.time_scale)

    def variants(self) -> Sequence[Variant]:
        """See `VariantStudy.variants`."""
        return [Variant(PLAIN, "the plain reading", {})]

    def check(self, out: Path) -> None:
        """See `VariantStudy.check`; the newborns' files are read, too."""
        super().check(out)
        for job in self.newborn_jobs(out):
            if job.done():
                job.steps()

    def screen(self) -> Mapping[str, Plan]:
        """Returns the plans of stage 2, by name."""
        start = plain(SEEDS[2], self.screened, self.time_scale)
        creative = [Condition(task, "creative") for task in PAPER_TASKS]
        return {
            f"screen-{number:02}": Plan.of(_combined(start, row), creative, self.screened)
            for number, row in enumerate(DESIGN, start=1)
        }

    def plans(self) -> Mapping[str, Plan]:
        """See `VariantStudy.plans`: the runs of stages 0 and 2."""
        check_positive(newborns=self.newborns, screened=self.screened)
        if self.stage not in (0, 1, 2):
            raise InputError(f"stage must be 0, 1 or 2, got {self.stage}")
        return {**super().plans(), **self.screen()}

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        return {**super().experiments(), **{n: one for n, (one, _) in self.cells().items()}}

    def cells(self) -> Mapping[str, tuple[Experiment, str]]:
        """Returns the experiments of stage 1 and their tasks, by name, in their order."""
        start = plain(SEEDS[1], self.newborns, self.time_scale)
        found = {}
        for speed, wall, second in itertools.product(SPEEDS, WALLS, (0, 1)):
            base = changed(start, {"motor_speed": speed, "kinematics.wall": wall})
            felt, place = ("pushed", "near")[second], ("centre", "front")[second]
            name = f"{wall}-{round(1000 * speed)}mm"
            walls = changed(base, {"kinematics.felt": felt})
            found[f"walls-{name}-{felt}"] = walls, "wall_avoidance"
            spot = changed(base, {"nose_place": place})
            found[f"spot-{name}-{place}"] = spot, "spot_finding"
        return found

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [*super().folders(out), out / NEWBORNS]

    def newborn_jobs(self, out: Path) -> list[NewbornJob]:
        """Returns the jobs of stage 1."""
        folder = resolved(out) / NEWBORNS
        return [
            NewbornJob(folder, name, experiment, Condition(task, proposer))
            for name, (experiment, task) in self.cells().items()
            for proposer in PROPOSERS
        ]

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`."""
        yield from self.runs(out, super().plans())
        if self.stage > 0:
            yield self.newborn_jobs(out)
        if self.stage > 1:
            yield from self.runs(out, self.screen())

    def finished(self, job: Job) -> None:
        """See `Study.finished`."""
        if isinstance(job, CohortJob):
            super().finished(job)

    def page(self, out: Path) -> Page:
        """See `Study.page`: what is finished."""
        names = [name for name in self.plans() if (out / name / "robots.csv").is_file()]
        return self.report({name: read_run(out / name) for name in names}, self.newborn_jobs(out))

    def report(self, runs: Mapping[str, Run], jobs: Sequence[NewbornJob] = ()) -> Page:
        """Returns the page made from the finished runs and newborns."""
        parts = [_hypothesis(runs[PLAIN])] if PLAIN in runs else []
        parts += _newborns(jobs, self.newborns)
        parts += _screening({name: run for name, run in runs.items() if name != PLAIN})
        return Page("\n".join(parts) or "Nothing is finished yet.\n")


def _combined(start: Experiment, row: np.ndarray) -> Experiment:
    for choice, sign in zip(CHOICES, row, strict=False):
        start = changed(start, choice.values[int(sign < 0)])
    return start


# ---- The page ----


def _hypothesis(run: Run) -> str:
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


def _newborns(jobs: Sequence[NewbornJob], robots: int) -> list[str]:
    """Returns the tables of stage 1; empty if no cell is finished."""
    shares: dict[str, dict[Condition, float]] = {}
    for job in jobs:
        shares.setdefault(job.cell, {})[job.condition] = job.unmet()
    done = {n: own for n, own in shares.items() if not any(map(math.isnan, own.values()))}
    if not done:
        return []
    scores = {
        n: {c: newborn_score(x, robots, c) for c, x in own.items()} for n, own in done.items()
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
                cells = [f"{own[column]:.3f}" for column in columns]
                rows.append([name.removeprefix(f"{short}-"), *cells, f"{total:.1f}"])
        lines += [*table(rows), ""]
    rows = [["instead of the plain reading's", *TASK_NAMES.values(), "error", "verdict"]]
    for own, others in _LEVELS:
        rows += [_matched(done, scores, robots, (own, other)) for other in others]
    lines += [
        "Mean difference of the score, other value minus the plain reading's, over cells that "
        "differ in nothing else; its standard error from the robots drawn. Left out: refused moves "
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
    shares: Mapping[str, Mapping[Condition, float]],
    scores: Mapping[str, Mapping[Condition, float]],
    robots: int,
    levels: tuple[str, str],
) -> list[str]:
    """Returns a row: the mean difference of matched cells in each task, and the verdict."""
    own, other = levels
    kept = [n for n in shares if not ("refuses" in n and n.endswith("near"))]
    pairs = [(n, m) for n in kept if (m := n.replace(other, own)) != n and m in kept]
    means: dict[Condition, float] = {}
    noise = 0.0
    random = np.random.default_rng(1)
    for condition in COLUMNS:
        mine = [(n, m) for n, m in pairs if condition in shares[n]]
        if not mine:
            continue
        means[condition] = float(
            np.mean([scores[n][condition] - scores[m][condition] for n, m in mine])
        )
        for name in sorted({*itertools.chain(*mine)}):  # equal data, equal draws
            drawn = random.binomial(robots, shares[name][condition], 200) / robots
            spread = np.std([newborn_score(x, robots, condition) for x in drawn])
            noise += float(spread / len(mine)) ** 2
    by_task = {t: sum(d for c, d in means.items() if c.task == t) for t in PAPER_TASKS}
    cells = [f"{by_task[t]:+.1f}" if any(c.task == t for c in means) else "-" for t in PAPER_TASKS]
    found = verdict(means, math.sqrt(noise)) if means else "not simulated"
    return [f"{other} for {own}", *cells, f"{math.sqrt(noise):.1f}", found]


def standard_error(effects: Sequence[float]) -> float:
    """Returns the standard error of stage 2's effects, one of each column of `DESIGN`."""
    empty = np.array(effects[len(CHOICES) :])
    return float(np.sqrt(np.mean(empty**2)))  # without noise they are 0: no mean is subtracted


def _screening(runs: Mapping[str, Run]) -> list[str]:
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
