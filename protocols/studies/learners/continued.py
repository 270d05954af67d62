"""The study of agents that explore, or go on learning, in the test after training."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np

from ...agents.base import Agent, sound
from ...agents.names import is_own, recorded_name, short_name
from ...agents.trust import check_trusted, trust
from ...analysis import intervals
from ...errors import InputError
from ...experiment.conditions import CohortKey, Condition
from ...experiment.experiment import Experiment
from ...experiment.random_streams import random_streams
from ...experiment.schedules import TASK_NAMES
from ...playback.episode import check_seed
from ...playback.measured_behaviour import sample
from ...playback.rollout import FROZEN, Mode, Tick, repeat_test
from ...playback.stored_brains import stored_agent
from ...reporting.labels import described
from ...reporting.markdown import MEANS, mean_cell, table, with_interval
from ...results.results import When
from ...results.run import Run
from ...results.run_files import check_names, read_run, read_runs
from ...shared_options import Runs, option
from ...simulation.jobs import Job, Report, Stop
from ...storage import digest, resolved
from ..jobs import FileJob, MinuteTick, check_shares, identity_of
from ..study import Page, Study, check_positive

MODES: Mapping[str, Mode] = MappingProxyType(
    {"frozen": FROZEN, "exploring": Mode(exploring=True), "learning": Mode(True, True)}
)


@dataclasses.dataclass
class ContinuedLearning(Study):
    """Repeat the test after training while agents explore, or while they go on learning.

    The agents have their weights from the end of training; our own agents also have their age. What
    runs do not keep starts as in a newborn: moments of the optimizer and of the reward, eligibility
    traces, replay memory, and the target network, which is soon copied.
    """

    name: ClassVar[str] = "continued-learning"

    runs: Runs
    """folders of finished runs, with brains until the study is finished"""
    agent: Annotated[tuple[str, ...], option("NAME ..", "all in the runs")] = ()
    """agents that are tested, or proposers; the code of one of yours runs only if it is named"""
    robots: int = 60
    """largest number of robots of each condition"""
    seed: int = 0
    """seed of the robots' random streams, the same in each mode"""

    @functools.cached_property
    def _runs(self) -> list[Run]:
        check_names(self.runs)
        return read_runs(self.runs, needs="curves")

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        check_positive(robots=self.robots)
        check_seed(self.seed)
        _ = self._tested
        return {run.name: run.experiment for run in self._runs}

    @functools.cached_property
    def _tested(self) -> list[tuple[Path, Run, Condition]]:
        """The folder of each run, the run, and a condition of it that is tested."""
        wanted = [recorded_name(name) for name in self.agent]
        trust(*wanted)
        found = [
            (resolved(folder), run, condition)
            for folder, run in zip(self.runs, self._runs, strict=True)
            for condition in run.conditions()
            if not wanted or condition.proposer in wanted
            if run.valid_rows(condition)
        ]
        for name in wanted:
            if not any(condition.proposer == name for *_, condition in found):
                raise InputError(f"no run has robots of {short_name(name)}")
        if not found:
            raise InputError("all robots of the runs were stopped")
        return found

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`."""
        return {"robots": self.robots, "seed": self.seed}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / run.name for run in self._runs]

    def check(self, out: Path) -> None:
        """See `Study.check`: whether the agents take over their weights, before any test."""
        left: dict[tuple[Path, Condition], ContinuedTest] = {}
        for job in self._jobs(out):
            if job.done():
                job.shares()
            else:
                check_trusted(job.condition.proposer, job.folder)
                left[job.folder, job.condition] = job
        for job in left.values():
            stored_agent(job.with_brains(), job.condition, job.which[:1], self.seed)

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: a job for each condition and mode."""
        yield sorted(self._jobs(out), key=lambda job: -job.cost)

    def _jobs(self, out: Path) -> list[ContinuedTest]:
        return [
            ContinuedTest(
                out / run.name / f"{condition.task}-{short_name(condition.proposer)}-{mode}"
                ".safetensors",
                folder,
                run,
                condition,
                mode,
                tuple(sample(run, condition, self.robots)),
                self.seed,
            )
            for folder, run, condition in self._tested
            for mode in MODES
        ]

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        tests: dict[tuple[Path, Condition], list[ContinuedTest]] = {}
        for job in self._jobs(out):
            tests.setdefault((job.folder, job.condition), []).append(job)
        lines: list[str] = []
        for task, title in TASK_NAMES.items():
            rows = [_row(jobs) for (_, condition), jobs in tests.items() if condition.task == task]
            if rows:
                head = ["robots", "number", *MODES, "learning - frozen"]
                lines += [f"### {title}", "", *table([head, *rows]), ""]
        lines += [
            "The test after training once more: share of the time in the spot, or without contact. "
            "*frozen*: as in the run; *exploring*: as in training, without learning (running "
            "moments of the signals go on); *learning*: exploring and learning. Mean over robots, "
            f"in brackets its 95 % interval ({MEANS}); the difference robot by robot, without "
            "robots that were stopped in one of the modes. The agents have the weights of the end "
            "of training, agents of ours also the age; moments of an optimizer and of the reward, "
            "traces, a replay memory and a target network begin as at birth.",
            "",
            *(described(run) for run in self._runs),
            "",
        ]
        return Page("\n".join(lines))


@dataclasses.dataclass(frozen=True)
class ContinuedTest(FileJob):
    """Repeats the test after training of a condition's robots in one mode.

    Attributes:
      path: File to which the result is written.
      folder: Folder of the run, an absolute path.
      evaluated: The run, without its brains.
      condition: Condition of the robots.
      mode: Name of the mode, a key of `MODES`.
      rows: Rows of the robots within the condition.
      seed: Seed of the random streams.
    """

    path: Path
    folder: Path
    evaluated: Run
    condition: Condition
    mode: str
    rows: tuple[int, ...]
    seed: int

    def __str__(self) -> str:
        return f"{self.evaluated.name}/{self.path.stem}"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return len(self.rows) * self.evaluated.test_seconds(self.condition.task)

    @property
    def which(self) -> list[tuple[int, When]]:
        """The brains after training, see `stored_agent`."""
        return [(row, "after") for row in self.rows]

    def with_brains(self) -> Run:
        """Reads the run with its brains.

        Raises:
          InputError: it is kept without them, or is damaged.
        """
        return read_run(self.folder, replay=True)

    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """See `FileJob.work`."""
        trust(self.condition.proposer)  # checked by the study
        shares = self._repeated(MinuteTick(self, len(self.rows), stop, report))
        report(self.cost, "")
        return {"shares": shares}

    def _repeated(self, tick: Tick) -> np.ndarray:
        """Returns the share of the test in which each robot did as wanted, see `shares`."""
        run, mode, robots = self.with_brains(), MODES[self.mode], len(self.rows)
        schedule = run.experiment.schedule(self.condition.task)
        seed, random = random_streams(self.seed, CohortKey(self.condition, 0))
        agent = stored_agent(run, self.condition, self.which, seed)
        if is_own(self.condition.proposer):
            _let_age(agent, schedule.steps_of("training"))
        batch = run.experiment.batch(self.condition.task, robots)
        phases = [phase for phase in schedule.phases if phase.part == "post"]
        events = repeat_test(batch, agent, phases, random, tick=tick, mode=mode)
        shares = events / schedule.steps_of("post")
        valid = batch.valid & sound(agent.weights(), robots)
        return np.where(valid, shares if schedule.wanted else 1 - shares, np.nan)

    def shares(self) -> np.ndarray:
        """Reads each robot's share of the test in the spot, or without contact, shape (B,).

        NaN for a robot that was stopped.

        Raises:
          FileNotFoundError: there is no such file.
          DamagedFileError: the file is damaged, or another job's.
        """
        shapes = {"shares": ("F64", (len(self.rows),))}
        shares = self.read(shapes)["shares"]
        check_shares(self.path, shares)
        return shares

    @property
    def identity(self) -> dict[str, Any]:
        """See `FileJob.identity`."""
        times = [(row.t_pre_s, row.t_post_s) for row in self.evaluated.robots(self.condition)]
        return identity_of(self.evaluated.experiment, self.condition) | {
            "mode": self.mode,
            "test_seed": self.seed,
            "run": digest({"times": np.array(times)}),
        }


def _row(jobs: Sequence[ContinuedTest]) -> list[str]:
    """Returns the row of a condition's tests, one in each mode."""
    first, found = jobs[0], {job.mode: job.shares() for job in jobs}
    kept = ~np.isnan([*found.values()]).any(axis=0)
    found = {mode: shares[kept] for mode, shares in found.items()}
    frozen, learning = found["frozen"], found["learning"]
    interval = intervals.difference_of_means(learning, frozen, paired=True, span=intervals.SHARE)
    name = f"{short_name(first.condition.proposer)} (`{first.evaluated.name}`)"
    row = [name, f"{len(frozen)} of {len(first.rows)}"]
    if not len(frozen):
        return [*row, *["-"] * (len(MODES) + 1)]
    return [
        *row,
        *(mean_cell(own, intervals.SHARE) for own in found.values()),
        with_interval(f"{(learning - frozen).mean():+.3f}", interval),
    ]


def _let_age(agent: Agent, steps: int) -> None:
    """Sets the age of an agent of ours, by which its exploration and its learning rate fall."""
    state = {name: array.copy() for name, array in agent.state().items()}
    if "age" in state:
        state["age"][...] = steps
        agent.load_state(state)
