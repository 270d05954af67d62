"""Why a brain learns to find the spot, or does not: what it knows by the hour of its training.

    python -m musebot.protocols.hours OUT --brains paper steady --robots 20

lives a cohort for each brain, keeps what it knows at the beginning and at eight times of its
training, lets every one of these brains sit the paper's test twice, without learning, and asks it
at four smells which ideas occur to it and what it thinks of every action. It prints a table and
draws, as SVG and PNG, `OUT/hours` and, of one robot of each brain, `OUT/values-BRAIN`. The same
command goes on where it was stopped.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...controller import Neurocontroller
from ...models import Kinematics
from ..agents.base import Brain, make_agent
from ..errors import InputError, RunError, run_module
from ..experiment.experiment import (
    Body,
    CohortKey,
    Experiment,
    check_same,
    experiment_of,
    is_physics_of,
    named_brain,
    physics_probe,
    told,
)
from ..experiment.schedules import Phase, control_steps
from ..options import KinematicsTold, Out, cores
from ..playback.observation import minutes_of, watch
from ..reporting import figures, tables
from ..reporting.robot_figures import draw_values, lacking
from ..simulation import engine, pool
from ..simulation.cohort import Cohort, place
from ..simulation.local import prepare_process
from ..storage import check_folder, digest, load_arrays, remove_drafts, save_arrays

TIMES = 8  # of the training, and its beginning
SEEDS = (0, 1)  # of the two tests: by the first the best time is chosen, by the other judged
SMELLS = {"no smell": None, "weak: 20 cm ahead": 0.2, "strong: 7 cm ahead": 0.07, "full": 0.0}
SHOWN = (0, 2, 4, 8)  # times of the figure of values
_TASK = "spot_finding"
_STRIDE = control_steps(1)
_TOGETHER = 250  # robots in lockstep
_KNOWN = "known."  # names of networks in the file of a life

Count = Callable[[int], None]  # told of control steps, or minutes, of all robots together


@dataclasses.dataclass(frozen=True)
class Diary:
    """What the brains of a cohort of R robots knew at T times of their training.

    Attributes:
      experiment: that they lived.
      name: of their brain.
      hours: simulated hours of training at each time, shape (T,).
      networks: what they knew, each of shape (T, R, ...); only of robots whose lives were valid.
      invalid: lives that ended in an unstable simulation.
    """

    experiment: Experiment
    name: str
    hours: np.ndarray
    networks: dict[str, np.ndarray]
    invalid: int = 0

    @property
    def robots(self) -> int:
        """R."""
        return self.experiment.cohort_size - self.invalid

    def brains(self, which: np.ndarray, seed: int = 0) -> Brain:
        """Brains back in robots.

        Args:
          which: times and robots, shape (2, B).
          seed: of their one random stream.
        """
        agent = make_agent(self.experiment, _TASK, "creative", which.shape[1], seed)
        assert isinstance(agent, Brain)
        kept = {name: torch.from_numpy(nets[tuple(which)]) for name, nets in self.networks.items()}
        agent.controller.load_networks(kept)
        return agent


@dataclasses.dataclass(frozen=True)
class Findings:
    """What is known of a diary.

    Attributes:
      diary: the diary.
      tests: shares of a frozen brain's two tests that it was in the spot, shape (2, T, R); NaN
        where the simulation became unstable.
      spread: of the ideas, as their mean distance from their mean, in motor values, by smell,
        shape (T, 4, R).
      missing: what the best idea lacks to the best of all actions, as a share of what actions
        differ by, by smell, shape (T, 4, R).
    """

    diary: Diary
    tests: np.ndarray
    spread: np.ndarray
    missing: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """Of the second test, shape (T, R)."""
        return self.tests[1]

    @property
    def best(self) -> np.ndarray:
        """Of each robot, the share at its best time so far, shape (T, R).

        The best time by the first test, the share of the second: the best of many tests is good
        luck, too, and would be better than the last where nothing was ever forgotten.
        """
        first = np.nan_to_num(self.tests[0], nan=-1.0)
        times = [first[: time + 1].argmax(axis=0) for time in range(len(first))]
        return np.take_along_axis(self.shares, np.array(times), axis=0)


@dataclasses.dataclass(frozen=True)
class Job:
    """The first cohort of creative robots of an experiment, in spot finding.

    Attributes:
      out: folder of what is kept of them.
      name: of their brain.
      experiment: that they live.
    """

    out: Path
    name: str
    experiment: Experiment

    @property
    def times(self) -> list[int]:
        """Control steps of a life at which what they know is kept, of length T."""
        before, training, _ = self.experiment.schedule(_TASK).steps()
        return (before + np.linspace(0, training, TIMES + 1).round().astype(int)).tolist()

    @property
    def brains(self) -> Path:
        """The file that keeps what they know."""
        return self.out / f"brains-{self.name}.safetensors"

    def test(self, seed: int) -> Path:
        """The file that keeps what came out of one of their tests."""
        return self.out / f"test-{self.name}-{seed}.safetensors"

    def notes(self) -> dict[str, Any]:
        """What tells their files from others', for JSON."""
        experiment = self.experiment
        return {
            "experiment": dataclasses.asdict(experiment),
            "physics": physics_probe(experiment.body, experiment.kinematics),
            "times": self.times,
        }

    def read(self, path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """One of their files.

        Raises:
          InputError: it is damaged, none of these robots', of another physics, or kept at other
            times.
        """
        arrays, notes = load_arrays(path)
        asked = self.experiment
        try:
            held, times = experiment_of(notes["experiment"]), notes["times"]
            check_same(f"{path} is of robots", held, asked)
            same = is_physics_of(notes["physics"], asked.body, asked.kinematics)
        except (KeyError, TypeError, ValueError) as error:
            raise _foreign(path, error) from error
        if not same:
            raise InputError(f"{path} was lived in another physics than this version's")
        if times != self.times:
            raise InputError(f"{path} was kept at other times than this version's")
        return arrays, notes

    def restored(self) -> tuple[Cohort, dict[str, np.ndarray]]:
        """The robots as their file has them, or newborn.

        Returns:
          The cohort, and its networks at the t times so far, each of shape (t, B, ...).

        Raises:
          InputError: see `read`.
        """
        cohort = Cohort(self.experiment, CohortKey(_TASK, "creative", 0))
        born = cohort.agent.weights()
        if not self.brains.exists():
            return cohort, {name: np.empty((0, *array.shape)) for name, array in born.items()}
        arrays, notes = self.read(self.brains)
        try:
            known = {name: arrays.pop(_KNOWN + name) for name in born}
            cohort.restore(arrays, notes)
            count = len(known[next(iter(known))])
            shapes = {name: (count, *array.shape) for name, array in born.items()}
            if shapes != {name: array.shape for name, array in known.items()}:
                raise ValueError(f"networks must have shapes {shapes}")
            if not count or cohort.step != self.times[count - 1]:
                raise ValueError(f"{count} networks are not those of step {cohort.step}")
        except (KeyError, ValueError, TypeError) as error:
            raise _foreign(self.brains, error) from error
        return cohort, known

    def lived(self) -> int:
        """How many control steps, of all robots together.

        Raises:
          InputError: see `read`.
        """
        return self.restored()[0].step * self.experiment.cohort_size

    def diary(self) -> Diary | None:
        """What they knew at all times; None as long as these are not over.

        Raises:
          InputError: see `read`.
        """
        cohort, known = self.restored()
        if any(len(networks) < len(self.times) for networks in known.values()):
            return None
        valid = cohort.batch.valid
        networks = {name: array[:, valid] for name, array in known.items()}
        hours = (np.array(self.times) - self.times[0]) / control_steps(60)
        return Diary(self.experiment, self.name, hours, networks, int((~valid).sum()))

    def shares(self, seed: int, kept: Diary) -> np.ndarray | None:
        """What `examined` gave, where these brains have sat this test, or else None.

        Lived anew, brains may come out otherwise: on another machine, or in another version.

        Args:
          seed: of the test.
          kept: see `diary`.

        Raises:
          InputError: see `read`.
        """
        if not self.test(seed).exists():
            return None
        arrays, notes = self.read(self.test(seed))
        return arrays["shares"] if notes.get("sat") == _sat(kept, seed) else None


def _sat(kept: Diary, seed: int) -> dict[str, Any]:
    """What tells a test from others."""
    return {"seed": seed, "brains": digest(kept.networks)}


def _foreign(path: Path, error: Exception) -> InputError:
    return InputError(f"{path} is another version's, or none of this command's ({error!r})")


def live(job: Job, tick: Count) -> None:
    """Lives a cohort up to the end of its training, and keeps what it knows on the way.

    The file is written anew at each of the times, and the life goes on from it to the same bits.

    Args:
      job: whose.
      tick: told of the control steps lived.

    Raises:
      InputError: see `Job.read`.
      OSError: the file cannot be written.
    """
    cohort, known = job.restored()
    robots = job.experiment.cohort_size
    for time in job.times[len(known[next(iter(known))]) :]:
        while cohort.step < time:
            before = cohort.step
            cohort.advance(min(_STRIDE, time - before))
            tick((cohort.step - before) * robots)
        for name, weights in cohort.agent.weights().items():
            known[name] = np.concatenate([known[name], weights[None]], dtype=weights.dtype)
        arrays, notes = cohort.checkpoint()
        arrays |= {_KNOWN + name: array for name, array in known.items()}
        save_arrays(job.brains, arrays, **job.notes(), **notes)


def examined(diary: Diary, seed: int, tick: Count) -> np.ndarray:
    """Lets all brains of a diary sit the test after training, without learning.

    Args:
      diary: whose brains.
      seed: of what occurs to them.
      tick: told of the simulated minutes of all robots.

    Returns:
      The share of it that each was in the spot, shape (T, R); NaN where the simulation became
      unstable.
    """
    experiment, test = diary.experiment, _test(diary.experiment)
    steps = control_steps(test.minutes)
    everyone = np.indices((len(diary.hours), diary.robots)).reshape(2, -1)
    shares = []
    for first in range(0, everyone.shape[1], _TOGETHER):
        which = everyone[:, first : first + _TOGETHER]
        batch = experiment.batch(_TASK, which.shape[1])
        place(batch, test, np.random.default_rng(0))
        brains = diary.brains(which, seed)
        minute = functools.partial(tick, batch.robots)
        track = watch(batch, brains, steps, learning=False, tick=minute)
        shares.append(np.where(batch.valid, track.events.mean(axis=0), np.nan))
    return np.concatenate(shares).reshape(len(diary.hours), -1)


def _test(experiment: Experiment) -> Phase:
    return experiment.schedule(_TASK).phases[-1]


def findings(jobs: Sequence[Job], processes: int) -> list[Findings]:
    """Lives and tests what is not kept yet, and asks all brains.

    Args:
      jobs: whose.
      processes: lives, and then tests, at a time, one core each.

    Returns:
      What all of it comes to, in the order of the jobs.

    Raises:
      InputError: a file cannot be gone on with; nothing was done then.
      RunError: no life with a brain was valid, or see `pool.work_off`.
      Interrupted, OSError: see `pool.work_off`.
    """
    # What cannot be gone on with is refused before anything is done.
    begun = {job: job.diary() for job in jobs}
    for job, seed in itertools.product(jobs, SEEDS):
        if job.test(seed).exists():
            job.read(job.test(seed))
    asleep = [job for job, kept in begun.items() if kept is None]
    total = sum(job.times[-1] * job.experiment.cohort_size for job in asleep)
    done = sum(job.lived() for job in asleep)
    pool.work_off("lives", _live, [(job,) for job in asleep], processes, total, done)
    diaries = {}
    for job in jobs:
        kept = job.diary()
        if not (kept and kept.robots):
            raise RunError(f"{job.name}: every simulation became unstable")
        diaries[job] = kept
    unsat = [
        (job, kept, seed)
        for (job, kept), seed in itertools.product(diaries.items(), SEEDS)
        if job.shares(seed, kept) is None
    ]
    total = sum(
        kept.robots * len(kept.hours) * minutes_of(_test(kept.experiment).minutes)
        for _, kept, _ in unsat
    )
    pool.work_off("tests", _sit, unsat, processes, total)
    prepare_process()
    found = []
    for job, kept in diaries.items():
        shares = [job.shares(seed, kept) for seed in SEEDS]
        found.append(Findings(kept, np.array(shares), *asked(kept)))
    return found


def _live(job: Job) -> None:
    live(job, pool.tick)


def _sit(job: Job, kept: Diary, seed: int) -> None:
    shares = examined(kept, seed, pool.tick)
    save_arrays(job.test(seed), {"shares": shares}, sat=_sat(kept, seed), **job.notes())


def smells(experiment: Experiment) -> np.ndarray:
    """What a robot senses at each of `SMELLS`, far from all walls, shape (4, S)."""
    batch = experiment.batch(_TASK, len(SMELLS))
    everyone, radius = np.arange(batch.robots), batch.dimensions.radius
    # The spot is in the middle, and ahead; or, where nothing is to be smelled, far behind.
    poses = [(0.3 if far is None else -radius - far, 0.0, 0.0) for far in SMELLS.values()]
    batch.place_spot(everyone, np.zeros((batch.robots, 2)))
    batch.place(everyone, np.array(poses))
    return batch.rules.state(batch.sensordata).astype(np.float32)


@torch.inference_mode()
def asked(diary: Diary) -> tuple[np.ndarray, np.ndarray]:
    """Asks all brains of a diary at each of `SMELLS` for ideas, and for what these lack.

    Returns:
      `Findings.spread` and `Findings.missing`.
    """
    times, robots = len(diary.hours), diary.robots
    spread, missing = np.zeros((2, times, len(SMELLS), robots))
    for time in range(times):
        brain = diary.brains(np.stack([np.full(robots, time), np.arange(robots)])).controller
        for smell, state in enumerate(torch.from_numpy(smells(diary.experiment))):
            sensed = state.expand(robots, -1)
            ideas = brain.propose(sensed)
            around = ideas - ideas.mean(dim=1, keepdim=True)
            spread[time, smell] = around.norm(dim=-1).mean(dim=1)
            missing[time, smell] = lacking(brain, sensed, ideas[:, None])[:, 0]
    return spread, missing


def markdown(found: Sequence[Findings]) -> str:
    """A row a brain: how well it did at the best time, how well in the end, what its ideas lack."""
    head = ["brain", "robots", "in the spot, at its best time", "in the end", "forgotten"]
    head += [f"ideas lack, {smell.partition(':')[0]}" for smell in SMELLS]
    rows = [head, ["---", *["---:"] * (len(head) - 1)]]
    for one in found:
        sound = ~np.isnan(one.tests).any(axis=(0, 1))
        best, end = one.best[-1][sound], one.shares[-1][sound]
        cells = [tables.mean_cell(values) for values in (best, end, best - end)]
        lacks = [f"{share:.0%}" for share in one.missing[-1].mean(axis=-1)]
        left_out = one.diary.experiment.cohort_size - sound.sum()
        robots = f"{sound.sum()}" + (f" (and {left_out} invalid)" if left_out else "")
        rows.append([one.diary.name, robots, *cells, *lacks])
    note = (
        "Shares of the test after training, sat by frozen brains. Each robot's best time is chosen "
        "by one test, and judged, as the end is, by another: a robot that was best in the end has "
        "forgotten nothing. In brackets 95 % intervals, BCa bootstrap over robots; none where all "
        "are alike. Ideas lack, in the end, by how much the value of the best idea falls short of "
        "that of the best action, as a share of the range of all actions' values."
    )
    return "\n".join([*map(tables.line, rows), "", note])


def draw(found: Sequence[Findings]) -> Figure:
    """A column a brain: its frozen tests by the hour, the spread of its ideas, what they lack."""
    figure, axes = figures.canvas(6.0, 3, len(found), sharex=True, sharey="row")
    for column, one in enumerate(found):
        above, middle, below = axes[:, column]
        hours = one.diary.hours
        above.set_title(one.diary.name)
        _line(above, hours, one.best, figures.INK, "at its best time so far")
        above.lines[-1].set_linestyle("--")
        _line(above, hours, one.shares, figures.colour("creative"), "now")
        for smell, (name, shade) in enumerate(zip(SMELLS, figures.PALETTE, strict=False)):
            label = name.partition(":")[0]
            _line(middle, hours, one.spread[:, smell], shade, label)
            _line(below, hours, one.missing[:, smell], shade, label)
        below.set_xlabel("hours of training")
    for axis, label in zip(
        axes[:, 0], ("in the spot,\nfrozen", "spread of ideas", "what ideas lack"), strict=True
    ):
        axis.set_ylabel(label)
    for row, top in enumerate((1, None, None)):
        axes[row, 0].set_ylim(0, top)
    for row in (0, 2):
        figures.in_per_cent(axes[row, 0].yaxis)
    for row in (0, 1):
        axes[row, -1].legend(frameon=False, fontsize=8)
    return figure


def _line(axis: Axes, hours: np.ndarray, values: np.ndarray, shade: str, label: str) -> None:
    axis.plot(hours, np.nanmean(values, axis=1), color=shade, label=label)


@torch.inference_mode()
def draw_hours(one: Findings) -> Figure:
    """The value of every action of a robot of middling success, by the hour and smell."""
    middle = np.nanmedian(one.shares[-1])
    robot = int(np.nanargmin(np.abs(one.shares[-1] - middle)))
    states = smells(one.diary.experiment)
    figure, axes = figures.canvas(6.0, len(SHOWN), len(SMELLS), sharex=True, sharey=True)
    for row, time in enumerate(SHOWN):
        brain: Neurocontroller = one.diary.brains(np.array([[time], [robot]])).controller
        for axis, state in zip(axes[row], states, strict=True):
            draw_values(axis, brain, state)
        axes[row, 0].set_ylabel(f"{one.diary.hours[time]:.3g} h\nright motor")
    for axis, name in zip(axes[0], SMELLS, strict=True):
        axis.set_title(name.replace(": ", "\n"))
    figure.supxlabel("left motor", fontsize=9, color=figures.INK)
    return figure


def main(
    out: Out,
    brains: tuple[str, ...] = ("paper", "steady"),
    robots: int = 20,
    seed: int = 1,
    processes: int = cores(),
    body: Body = "mujoco",
    kinematics: KinematicsTold = (),
    time_scale: float = 1.0,
) -> None:
    """Prints and draws what brains know by the hour of their training in spot finding.

    Args:
      out: folder for what is kept and for the figures; an unfinished one goes on.
      brains: named ones, one column each.
      robots: of each, creative ones, in one cohort.
      seed: of every random stream.
      processes: cohorts or tests at a time, one core each.
      body: mujoco, or the kinematic stand-in.
      kinematics: of the stand-in, such as lag=0.08.
      time_scale: below 1 shortens every duration, for rehearsals.
    """
    if not 1 <= len(brains) <= 4 or len(set(brains)) < len(brains):
        raise InputError(f"a figure holds 1 to 4 different brains, got {' '.join(brains)}")
    for name, number in (("robots", robots), ("processes", processes)):
        if number < 1:
            raise InputError(f"the number of {name} must be at least 1, got {number}")
    shared = Experiment(
        seed=seed,
        cohort_size=robots,
        time_scale=time_scale,
        body=body,
        kinematics=told(Kinematics(), kinematics),
    )
    wanted = {name: dataclasses.replace(shared, brain=named_brain(name)) for name in brains}
    jobs = [Job(out, name, experiment) for name, experiment in wanted.items()]
    check_folder(out)
    with engine.locked(out):
        remove_drafts(out)
        found = findings(jobs, processes)
        with figures.styled():
            figures.save(draw(found), out, "hours")
            for one in found:
                figures.save(draw_hours(one), out, f"values-{one.diary.name}")
    print(markdown(found))


if __name__ == "__main__":
    run_module(main)
