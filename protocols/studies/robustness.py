"""The study of robustness: trained brains in robots and arenas that differ from training."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from ...controller import PROPOSERS
from ...models import Dimensions, Kinematics, enlarge
from ...tasks import CONTROL_TIMESTEP, Robots
from ...tasks.rules import RANGEFINDERS
from ..agents.perturbed import PerturbedBrain
from ..analysis import intervals
from ..errors import DamagedFileError, InputError
from ..experiment.conditions import PAPER_TASKS, CohortKey, Condition
from ..experiment.experiment import Body, Experiment, MotorTorque
from ..experiment.random_streams import random_streams
from ..experiment.schedules import (
    SCHEDULES,
    TASK_NAMES,
    UPPER_LEFT,
    Phase,
    Schedule,
)
from ..playback.episode import check_seed
from ..playback.measured_behaviour import sample, with_brains
from ..playback.rollout import Tick, repeat_test
from ..playback.stored_brains import stored_brains
from ..reporting import markdown
from ..reporting.labels import described, durations
from ..results.results import When
from ..results.run import Run
from ..results.run_files import check_names, flat_networks, read_runs
from ..shared_options import BODY_CHOICES, PROPOSER_CHOICES, Runs, option
from ..simulation.jobs import Job, Report, Stop
from ..storage import digest
from .jobs import FileJob, MinuteTick
from .study import Page, Study, check_positive

_WALLS, _SPOTS = ("wall_avoidance",), ("spot_finding",)
_LOWER_LEFT = (UPPER_LEFT[0], -UPPER_LEFT[1])


@dataclasses.dataclass(frozen=True)
class Perturbation:
    """A difference of robot or arena from training.

    Attributes:
      name: Name of the perturbation in file names.
      says: Description in words.
      tasks: Tasks whose robots are evaluated with the perturbation.
      speed: Factor by which the robot's speed is multiplied.
      torque: Torque of the motors at another speed (see `Experiment.motor_torque`).
      arena: Factor by which both side lengths of the arena are multiplied; the start places of
        robot and spot keep their distances from the corners.
      spot: Centre of the spot in the test, x, y in [m]; None for the place in the schedule.
      noise: Standard deviation of the noise. Each signal is multiplied by a normally distributed
        factor with mean 1, drawn anew for every robot and control step, and then clipped to its
        range.
      dead: Name of the distance sensor that is switched off; None for no sensor.
    """

    name: str
    says: str
    tasks: tuple[str, ...] = PAPER_TASKS
    speed: float = 1.0
    torque: MotorTorque = "constant"
    arena: float = 1.0
    spot: tuple[float, float] | None = None
    noise: float = 0.0
    dead: str | None = None

    def batch(self, experiment: Experiment, task: str, robots: int) -> Robots:
        """Returns robots in lockstep, with the perturbed body and arena."""
        if self.speed != 1:
            own = experiment.batch(task, 1).dimensions.motor_speed
            # The kinematic simulator has one lag for all speeds.
            torque: Any = self.torque if experiment.body == "mujoco" else "constant"
            experiment = dataclasses.replace(
                experiment, motor_speed=self.speed * own, motor_torque=torque
            )
        edits = [functools.partial(enlarge, factor=self.arena)] if self.arena != 1 else []
        return experiment.batch(task, robots, edits)

    def test(self, schedule: Schedule, size: Dimensions) -> list[Phase]:
        """Returns the phases of the test after training, in an arena of the perturbed size."""
        grown = 1 - 1 / self.arena
        phases = tuple(
            dataclasses.replace(phase, spot=self.spot or phase.spot)
            for phase in schedule.phases
            if phase.part == "post"
        )
        test = dataclasses.replace(schedule, phases=phases)
        return [*test.moved_out(grown * size.half_length, grown * size.half_width).phases]


REFERENCE = Perturbation("unchanged", "nothing")

PERTURBATIONS = (
    REFERENCE,
    Perturbation("half-speed", "robot at half speed", speed=0.5),
    Perturbation("double-speed", "robot at double speed", speed=2.0),
    Perturbation("half-speed-lag", "half speed, equal lag", speed=0.5, torque="scaled"),
    Perturbation("double-speed-lag", "double speed, equal lag", speed=2.0, torque="scaled"),
    Perturbation(
        "spot-lower-left",
        "spot in the lower left corner's place, 0.50 m from the robot's start instead of 0.85 m",
        _SPOTS,
        spot=_LOWER_LEFT,
    ),
    Perturbation("larger-arena", "arena a third larger in both directions", arena=4 / 3),
    Perturbation("noise", "10 % noise on every signal", noise=0.1),
    # Each of the four: which one matters depends on the way in which a robot drives and turns.
    *(
        Perturbation(f"dead-{name}", f"{name} distance sensor sees nothing", _WALLS, dead=name)
        for name in RANGEFINDERS
    ),
)


@dataclasses.dataclass
class Robustness(Study):
    """Evaluate trained brains in robots and arenas that differ from training.

    Repeats the test after training with frozen weights, once with each perturbation.
    """

    name: ClassVar[str] = "robustness"
    perturbations: ClassVar[Sequence[Perturbation]] = PERTURBATIONS

    runs: Runs
    """folders of finished runs"""
    robots: int = 60
    """largest number of robots of each condition"""
    body: Annotated[Body | None, option(BODY_CHOICES, "each run's own")] = None
    """body of the robots in the tests"""
    seed: int = 0
    """seed of the brains' noise and of the perturbations"""
    proposer: Annotated[tuple[str, ...], option(f"{PROPOSER_CHOICES} ..", "all three")] = PROPOSERS
    """proposers whose brains are evaluated"""

    @functools.cached_property
    def evaluated(self) -> list[EvaluatedRun]:
        """Runs with the brains to evaluate.

        Raises:
          InputError: an option is invalid, a run has no such brains, or the runs cannot be in one
            table.
        """
        check_positive(robots=self.robots)
        check_seed(self.seed)
        for name in self.proposer:
            if name not in PROPOSERS:
                raise InputError(
                    f"the proposer must be one of {', '.join(PROPOSERS)}, got {name!r}"
                )
        check_names(self.runs)
        found = [self._evaluated(run) for run in read_runs(self.runs, replay=True)]
        scales = sorted({one.run.experiment.time_scale for one in found})
        if len(scales) > 1:
            raise InputError(
                "the runs cannot be in one table: their time scales are "
                f"{' and '.join(f'{scale:g}' for scale in scales)}"
            )
        return found

    def _evaluated(self, run: Run) -> EvaluatedRun:
        experiment = dataclasses.replace(run.experiment, seed=self.seed)
        if self.body and self.body != experiment.body:  # kinematics are of the other body
            experiment = dataclasses.replace(experiment, body=self.body, kinematics=Kinematics())
        chosen = {
            condition: count
            for condition in with_brains(run)
            if condition.proposer in self.proposer
            and (count := len(sample(run, condition, self.robots)))
        }
        if not chosen:
            raise InputError(f"{run.name} has no brain of a {' or '.join(self.proposer)} robot")
        return EvaluatedRun(Run(run.name, experiment, run.results), chosen, described(run))

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        found = {one.name: one.run.experiment for one in self.evaluated}
        for name, experiment in found.items():
            if experiment.arena_scale != 1:
                raise InputError(f"the run {name} has a larger arena, which this study changes")
        return found

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`."""
        return {
            "robots": {
                one.name: {str(condition): count for condition, count in one.robots.items()}
                for one in self.evaluated
            },
            "brains": {
                one.name: digest(flat_networks(one.run.results, ["after"]))
                for one in self.evaluated
            },
        }

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / one.name for one in self.evaluated]

    def check(self, out: Path) -> None:
        """See `Study.check`."""
        for job in self.jobs(out):
            if job.done():
                job.measured()

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: a job for each condition and perturbation."""
        yield self.jobs(out)

    def jobs(self, out: Path) -> list[PerturbedTest]:
        """Returns all jobs, the longest first, so that all processes end at about the same time."""
        found = [
            one.job(out, condition, perturbation)
            for one in self.evaluated
            for condition in one.robots
            for perturbation in self.perturbations
            if condition.task in perturbation.tasks
        ]
        return sorted(found, key=lambda job: -job.cost)

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        parts = [self._table(out, task) for task in PAPER_TASKS]
        return Page("\n".join([*filter(None, parts), self._note()]))

    def _table(self, out: Path, task: str) -> str:
        """Returns a task's table, a row for each perturbation; empty without robots."""
        event = SCHEDULES[task].event
        rows = [one for one in self.perturbations if task in one.tasks]
        head, table = ["perturbation"], [[one.says] for one in rows]
        for evaluated in self.evaluated:
            for condition in evaluated.robots:
                if condition.task != task:
                    continue
                head.append(f"{evaluated.name}, {condition.proposer}: {event}")
                head += ["difference", f"never {event}"]
                found = [evaluated.shares(out, condition, one) for one in rows]
                for row, shares in zip(table, found, strict=True):
                    row += cells(shares, None if shares is found[0] else found[0])
        if len(head) == 1:
            return ""
        title = f"### {TASK_NAMES[task]}"
        title += durations(self.evaluated[0].run.experiment)
        return "\n".join([title, "", *markdown.table([head, *table]), ""])

    def _note(self) -> str:
        lines = [
            "Trained brains repeat the test after training with frozen weights: share of the time, "
            f"mean over robots, in brackets its 95 % interval ({markdown.MEANS}). *Difference*: "
            "from the test without a perturbation, and how many robots have more and less time "
            "than there. No interval where robots are too few. The tests have the seed "
            f"{self.seed}{f' and the body {self.body}' if self.body else ''}. The runs:",
            "",
            *(one.trained for one in self.evaluated),
            "",
        ]
        return "\n".join(lines)


@dataclasses.dataclass(frozen=True)
class EvaluatedRun:
    """A run whose brains are evaluated.

    Attributes:
      run: The run; its experiment has the body and the seed of the study.
      robots: Number of robots to evaluate, by condition; the first valid robots are taken.
      trained: The run as it was simulated, in words.
    """

    run: Run
    robots: Mapping[Condition, int]
    trained: str

    @property
    def name(self) -> str:
        """Name of the run, and of the folder of its files."""
        return self.run.name

    def job(self, out: Path, condition: Condition, perturbation: Perturbation) -> PerturbedTest:
        """Returns the job that evaluates a condition's robots with a perturbation."""
        name = f"{condition.task}-{condition.proposer}-{perturbation.name}.safetensors"
        rows = tuple(sample(self.run, condition, self.robots[condition]))
        return PerturbedTest(out / self.name / name, self.run, condition, rows, perturbation)

    def shares(self, out: Path, condition: Condition, perturbation: Perturbation) -> np.ndarray:
        """Reads the results of a condition's robots with a perturbation.

        Returns:
          Share of the test in contact (or in the spot) of each robot, shape (B,); NaN for a robot
          whose simulation became unstable.

        Raises:
          InputError: the file is missing, damaged, or of another perturbation with this name.
        """
        job = self.job(out, condition, perturbation)
        if not job.done():
            raise InputError(f"{out} lacks {job.path.relative_to(out)}")
        arrays = job.measured()
        times = arrays["events"] * CONTROL_TIMESTEP
        return np.where(arrays["valid"], times / self.run.test_seconds(condition.task), np.nan)


@dataclasses.dataclass(frozen=True)
class PerturbedTest(FileJob):
    """Evaluates a condition's robots with one perturbation, in lockstep.

    Attributes:
      path: File to which the results are written.
      evaluated: Run of the robots, with the study's body and seed.
      condition: Condition of the robots.
      rows: Rows of the robots within the condition.
      perturbation: Difference of robot or arena from training.
    """

    path: Path
    evaluated: Run
    condition: Condition
    rows: tuple[int, ...]
    perturbation: Perturbation

    def __str__(self) -> str:
        return f"{self.evaluated.name}/{self.path.stem}"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return len(self.rows) * self.evaluated.test_seconds(self.condition.task)

    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """See `FileJob.work`."""
        return evaluate(self, MinuteTick(self, len(self.rows), stop, report))

    @property
    def identity(self) -> dict[str, Any]:
        """See `FileJob.identity`."""
        weights = self.evaluated.results[self.condition].networks["after"]
        change = dataclasses.asdict(self.perturbation)
        if self.perturbation.torque == "constant":  # files made before there was a choice
            del change["torque"]
        return {
            "change": change,
            "condition": str(self.condition),
            "seed": self.evaluated.experiment.seed,
            "brains": digest({name: array[[*self.rows]] for name, array in weights.items()}),
        }

    def measured(self) -> dict[str, np.ndarray]:
        """Reads what `evaluate` returned.

        Raises:
          FileNotFoundError: there is no such file.
          DamagedFileError: the file is damaged, or another job's.
        """
        robots = (len(self.rows),)
        shapes = {"events": ("I32", robots), "valid": ("BOOL", robots)}
        arrays = self.read(shapes)
        most = self.evaluated.test_seconds(self.condition.task) / CONTROL_TIMESTEP
        if (wrong := (arrays["events"] < 0) | (arrays["events"] > most + 0.5)).any():
            value = arrays["events"][wrong][0]
            raise DamagedFileError(f"{self.path}: events must lie in [0, {most:.0f}], got {value}")
        return arrays


def evaluate(job: PerturbedTest, tick: Tick = lambda: None) -> dict[str, np.ndarray]:
    """Repeats the test after training, with frozen weights.

    The random streams of brains and noise depend on the condition and the seed only, not on the
    perturbation.

    Args:
      job: Job that names the robots and the perturbation.
      tick: Function called after every simulated minute.

    Returns:
      Two arrays of shape (B,). `events`: number of control steps in contact (or in the spot).
      `valid`: whether the simulation remained stable.
    """
    experiment, perturbation, task = job.evaluated.experiment, job.perturbation, job.condition.task
    seed, random = random_streams(experiment.seed, CohortKey(job.condition, 0))
    which: list[tuple[int, When]] = [(row, "after") for row in job.rows]
    brains = stored_brains(job.evaluated, job.condition, which, seed)
    agent = PerturbedBrain(
        brains, experiment.arena_task(task), random, perturbation.noise, perturbation.dead
    )
    batch = perturbation.batch(experiment, task, len(job.rows))
    phases = perturbation.test(experiment.schedule(task), batch.dimensions)
    events = repeat_test(batch, agent, phases, random, tick=tick)
    return {"events": events, "valid": batch.valid}


def cells(shares: np.ndarray, reference: np.ndarray | None) -> list[str]:
    """Returns a condition's cells of a row: share, difference, robots without the event.

    The difference has the number of robots with more and with less: many small changes in one
    direction say more than an interval of the mean, which allows for rare robots.

    Args:
      shares: Share of the test in contact (or in the spot) of each robot, shape (B,); NaN if its
        simulation became unstable.
      reference: Shares without a perturbation, shape (B,); None for these themselves, which have
        no difference.
    """
    sound = shares[~np.isnan(shares)]
    mean = markdown.number(float(sound.mean()))
    share = markdown.with_interval(mean, intervals.mean(sound, intervals.SHARE))
    never = f"{int((sound == 0).sum())} of {len(sound)}"
    if reference is None:
        return [share, "", never]
    both = ~np.isnan(shares - reference)
    interval = intervals.difference_of_means(
        shares[both], reference[both], paired=True, span=intervals.SHARE
    )
    change = (shares - reference)[both]
    difference = markdown.with_interval(f"{float(change.mean()):+.4f}", interval)
    counts = f"{int((change > 0).sum())} more, {int((change < 0).sum())} less"
    return [share, f"{difference}; {counts}", never]
