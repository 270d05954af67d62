"""The demonstration: a trained robot, then a small experiment with two brains and its films."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from ...controller.brains import BRAINS
from ..errors import InputError
from ..examples import ROBOT
from ..lives.conditions import PAPER_TASKS, Condition
from ..lives.experiment import Experiment
from ..lives.plan import Plan
from ..lives.run import Run
from ..lives.run_files import read_run
from ..lives.schedules import SCHEDULES, TASK_NAMES
from ..pages.film import film
from ..pages.markdown import table
from ..pages.stored_brains import StoredRobot
from ..terminal import notice
from .study import Page, RunJobs, Study, check_positive, simulate_runs

FILMS, TRAINED = "films", "trained_robot"
_PROPOSER = "creative"
_FILM_SECONDS = 10.0
_SPEEDS = {"wall_avoidance": 10.0, "spot_finding": 20.0}
_TRAINED_SPEED = 4.0  # of the film of the kept robot


@dataclasses.dataclass(frozen=True)
class Shown:
    """A robot that a film shows.

    Attributes:
      kind: "best" or "typical".
      brain: Name of the robot's brain and run.
      task: Task of the robot.
      robot: Number of the robot.
      before: Share of the time in contact, or in the spot, in the test before training, in [0, 1].
      after: Share of the time in contact, or in the spot, in the test after training, in [0, 1].
    """

    kind: str
    brain: str
    task: str
    robot: int
    before: float
    after: float

    @property
    def file(self) -> str:
        """Name of the film's file."""
        return f"{self.task}_{self.kind}_{self.brain}_{self.robot}.mp4"

    @property
    def caption(self) -> str:
        """The robot and its numbers in the run, in a few words."""
        numbers = f"{SCHEDULES[self.task].event} {self.before:.0%} before, {self.after:.0%} after"
        return f"brain {self.brain}, robot {self.robot}: {numbers}"


@dataclasses.dataclass
class Demo(Study):
    """Show a trained robot, then let a few robots learn and film the best and a typical one.

    Attributes:
      robots: Number of robots with each brain in each task.
      time_scale: Factor on every duration of the paper.
      seed: Seed from which all random streams derive.
    """

    name: ClassVar[str] = "demo"
    folders: ClassVar[tuple[str, ...]] = (FILMS,)

    robots: int = 6
    time_scale: float = 0.5
    seed: int = 1

    def identity(self) -> Mapping[str, Any]:
        """See `Study.identity`."""
        check_positive(robots=self.robots)
        return dataclasses.asdict(self)

    def plans(self) -> Mapping[str, Plan]:
        """See `Study.plans`: the paper's brain and `steady`."""
        experiment = Experiment(cohort_size=self.robots, time_scale=self.time_scale, seed=self.seed)
        conditions = [Condition(task, _PROPOSER) for task in PAPER_TASKS]
        return {
            name: Plan.of(
                dataclasses.replace(experiment, brain=BRAINS[name]), conditions, self.robots
            )
            for name in ("paper", "steady")
        }

    def work(self, out: Path, run_jobs: RunJobs) -> None:
        """See `Study.work`; the first film is made before the robots learn, the others after."""
        kept = StoredRobot(read_run(ROBOT), Condition("spot_finding", _PROPOSER), 0, "post")
        words = "brain steady, trained for four hours"
        self._film(kept, words, _TRAINED_SPEED, out / FILMS / f"{TRAINED}.mp4")
        simulate_runs(out, self.plans(), run_jobs)
        runs = self._runs(out)
        for one in chosen(runs):
            condition = Condition(one.task, _PROPOSER)
            robot = StoredRobot(runs[one.brain], condition, one.robot, "post")
            self._film(robot, one.caption, _SPEEDS[one.task], out / FILMS / one.file)

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        return Page(markdown(self._runs(out)))

    def _runs(self, out: Path) -> dict[str, Run]:
        return {name: read_run(out / name) for name in self.plans()}

    def _film(self, robot: StoredRobot, words: str, speed: float, path: Path) -> None:
        """Films a robot's test after training, unless the film exists; without EGL it says so."""
        if path.exists():
            return
        try:
            episode = dataclasses.replace(robot.episode(), driver=words)
            film(episode, path, seconds=_FILM_SECONDS, speed=speed)
            notice(f"watch {path}")
        except InputError as error:
            notice(f"{path.name} is not filmed: {error}")


def chosen(runs: Mapping[str, Run]) -> list[Shown]:
    """Returns the robots to film: in each task the best one of all, and a typical one.

    The best robot was longest in the spot (or shortest in contact) in the test after training; if
    several were, the one that gained most since the test before training. The typical robot is the
    median of the paper's brain, the lower one of two.

    Args:
      runs: Runs, keyed by the name of their brain; the paper's brain comes first.
    """
    found = []
    for task in PAPER_TASKS:
        condition, sign = Condition(task, _PROPOSER), 1 if SCHEDULES[task].wanted else -1
        robots = [
            Shown("best", brain, task, row.robot, float(before), float(after))
            for brain, run in runs.items()
            for row, before, after in zip(
                run.valid(condition),
                run.shares(condition, "pre"),
                run.shares(condition, "post"),
                strict=True,
            )
        ]
        if robots:
            found.append(max(robots, key=lambda r: (sign * r.after, sign * (r.after - r.before))))
        own = sorted((r for r in robots if r.brain == "paper"), key=lambda robot: robot.after)
        if own:
            found.append(dataclasses.replace(own[(len(own) - 1) // 2], kind="typical"))
    return found


def markdown(runs: Mapping[str, Run]) -> str:
    """Returns the page: the numbers, the films, what was seen in either task, what to do next.

    Args:
      runs: Runs, keyed by the name of their brain; the paper's brain comes first.
    """
    rows = [["share of the test"]]
    rows[0] += [f"`{brain}`, {when} learning" for brain in runs for when in ("before", "after")]
    seen = []
    for task in PAPER_TASKS:
        condition, cells = Condition(task, _PROPOSER), []
        for run in runs.values():
            cells += [f"{run.shares(condition, part).mean():.0%}" for part in ("pre", "post")]
        rows.append([SCHEDULES[task].event, *cells])
        changes = zip(runs, cells[::2], cells[1::2], strict=True)
        seen.append(" and ".join(f"from {a} to {b} with `{brain}`" for brain, a, b in changes))
    experiment = next(iter(runs.values())).experiment
    robots, scale = experiment.cohort_size, experiment.time_scale
    length = "at full length" if scale == 1 else f"with {scale:g} times the paper's durations"
    films = [
        f"- `{FILMS}/{one.file}`: {TASK_NAMES[one.task].lower()}, {one.kind} robot; {one.caption} "
        "training."
        for one in chosen(runs)
    ]
    lines = [
        *table(rows),
        "",
        f"Means of {robots} creative robots with each brain, simulated in MuJoCo {length}. So few "
        "robots are an example, not a measurement: the tables of the README have 500 at full "
        "length.",
        "",
        f"- `{FILMS}/{TRAINED}.mp4`: a robot that was trained beforehand.",
        *films,
        "",
        "The best robot was longest in the spot (or shortest in contact) after training; the "
        "typical one is the median of the paper's brain. A film shows the beginning of the test "
        "after training again, with new noise. The paper's brain often gets worse in the spot: its "
        "tables say so, too (docs/results.md).",
        "",
        f"Contact with walls went {seen[0]}. Time in the spot went {seen[1]}. Next, watch the "
        "films, make a page of a run with `musebot report OUT/steady`, or let an agent of your own "
        "learn (docs/agents.md).",
    ]
    return "\n".join(lines) + "\n"
