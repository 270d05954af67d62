"""Stores brains at nine times of their training, and evaluates them with frozen weights."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...agents.factory import make_agent
from ...agents.neurocontroller import NeurocontrollerAgent
from ...analysis.regret import regret
from ...errors import DamagedFileError, InputError, RunError
from ...experiment.conditions import CohortKey, Condition
from ...experiment.experiment import Experiment, check_same
from ...experiment.manifest import UNREADABLE, experiment_from
from ...experiment.schedules import control_steps
from ...playback.rollout import Tick, count_events
from ...results.checks import check_same_shapes
from ...simulation.cohort import Cohort, shapes_of
from ...simulation.jobs import Report, Stop
from ...simulation.placement import place
from ...storage import digest, load_arrays, save_arrays
from ..jobs import MinuteTick, StoppedError, advance, check_shares, own_arrays

TIMES = 9  # of the training, its beginning and its end among them
SEEDS = (0, 1)  # of the two tests: the first chooses the best time, the second evaluates it
# Distance of the spot's centre from the nose in metres; for no smell the spot is behind.
SMELLS = {"no smell": None, "20 cm ahead": 0.2, "7 cm ahead": 0.07, "in the spot": 0.0}

CONDITION = Condition("spot_finding", "creative")
_TOGETHER = 250  # robots in lockstep in a test
_STORED = "known."  # prefix of the networks' names in the file of a life


@dataclasses.dataclass(frozen=True)
class BrainsInTime:
    """Networks of R robots at T times of their training.

    Attributes:
      experiment: Experiment of the robots.
      name: Name of the robots' brain.
      hours: Simulated hours of training at each time, shape (T,).
      networks: Networks of the valid robots at each time, each of shape (T, R, ...).
      invalid: Number of robots whose simulation became unstable.
    """

    experiment: Experiment
    name: str
    hours: np.ndarray
    networks: dict[str, np.ndarray]
    invalid: int = 0

    @property
    def robots(self) -> int:
        """Number of valid robots, R."""
        return self.experiment.cohort_size - self.invalid

    def brains(self, which: np.ndarray, seed: int = 0) -> NeurocontrollerAgent:
        """Returns chosen brains as one batch.

        Args:
          which: For each brain, the index of its time (first row) and of its robot (second row),
            shape (2, B).
          seed: Seed of the batch's random stream.
        """
        agent = make_agent(self.experiment, CONDITION, which.shape[1], seed)
        assert isinstance(agent, NeurocontrollerAgent)
        agent.load_weights({name: nets[tuple(which)] for name, nets in self.networks.items()})
        return agent


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Performance of R brains at T times of their training.

    Attributes:
      progress: Evaluated brains.
      tests: Share of time in the spot of each frozen brain in two tests, shape (2, T, R); NaN where
        the simulation became unstable.
      spread: Mean distance between an idea and the mean of all ideas, in motor values, for each of
        S smells, shape (T, S, R).
      regret: Regret of the ideas (`analysis.regret`) for each of S smells, shape (T, S, R).
    """

    progress: BrainsInTime
    tests: np.ndarray
    spread: np.ndarray
    regret: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """Share of the time in the spot in the second test, shape (T, R)."""
        return self.tests[1]

    @property
    def best(self) -> np.ndarray:
        """Share of each robot at its best time so far, shape (T, R).

        The first test chooses the best time, the second test gives the share at that time. With one
        test, the best result is partly luck and exceeds later results even without forgetting.
        """
        first = np.nan_to_num(self.tests[0], nan=-1.0)
        times = [first[: time + 1].argmax(axis=0) for time in range(len(first))]
        return np.take_along_axis(self.shares, np.array(times), axis=0)


def times(experiment: Experiment) -> list[int]:
    """Returns the T control steps of a life at which the networks are stored."""
    before, training, _ = experiment.schedule(CONDITION.task).steps()
    return (before + np.linspace(0, training, TIMES).round().astype(int)).tolist()


@dataclasses.dataclass(frozen=True)
class StoredLifeJob:
    """Simulates a cohort of B robots to the end of its training, and stores its networks.

    Attributes:
      out: Folder of the study, an absolute path.
      name: Name of the robots' brain.
      experiment: Experiment of the robots.
    """

    out: Path
    name: str
    experiment: Experiment

    def __str__(self) -> str:
        return f"life of {self.name}"

    @property
    def path(self) -> Path:
        """See `Job.path`; the file is also the checkpoint."""
        return self.out / f"brains-{self.name}.safetensors"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return self.experiment.robot_seconds(times(self.experiment)[-1])

    def done(self) -> bool:
        """See `Job.done`."""
        return self.path.exists() and len(_first(self.restored()[1])) == TIMES

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; continues bit-exactly from the last time at which networks were stored."""
        cohort, stored = self.restored()
        robots, begun = self.experiment.cohort_size, self.experiment.robot_seconds(cohort.step)
        tick = MinuteTick(self, robots, stop, report, begun)
        for time in times(self.experiment)[len(_first(stored)) :]:
            try:
                advance(cohort, time, tick)
                stopped = False
            except StoppedError:
                if cohort.step < time:
                    return False
                stopped = True  # at a time of storing: its networks are stored first
            for name, weights in cohort.agent.weights().items():
                stored[name] = np.concatenate([stored[name], weights[None]], dtype=weights.dtype)
            arrays, notes = cohort.checkpoint()
            arrays |= {_STORED + name: array for name, array in stored.items()}
            save_arrays(self.path, arrays, **notes, experiment=dataclasses.asdict(self.experiment))
            if stopped and time < times(self.experiment)[-1]:
                return False
        report(self.cost, "")
        return True

    def restored(self) -> tuple[Cohort, dict[str, np.ndarray]]:
        """Returns the robots as stored in their file; untrained robots if there is no file.

        Returns:
          The cohort, and its networks at the t times stored so far, each of shape (t, B, ...).

        Raises:
          InputError: the file is damaged, or belongs to other robots.
        """
        cohort = Cohort(self.experiment, CohortKey(CONDITION, 0))
        newborn = cohort.agent.weights()
        if not self.path.exists():
            return cohort, {name: np.empty((0, *array.shape)) for name, array in newborn.items()}
        arrays, notes = load_arrays(self.path)
        try:
            if "experiment" in notes:  # files of earlier versions do not name theirs
                held = experiment_from(notes["experiment"])
                check_same("an experiment", held, self.experiment)
            stored = {name: arrays.pop(_STORED + name) for name in newborn}
            cohort.check_shapes(shapes_of(arrays))
            cohort.restore(arrays, notes)
            count = len(_first(stored))
            shapes = {name: ("F32", (count, *array.shape)) for name, array in newborn.items()}
            check_same_shapes(shapes, shapes_of(stored))
            for name, array in stored.items():
                if not np.isfinite(array[:, cohort.batch.valid]).all():
                    raise ValueError(f"{name} is not finite")
            if not count or cohort.step != times(self.experiment)[count - 1]:
                raise ValueError(f"{count} networks are not those of step {cohort.step}")
        except (InputError, *UNREADABLE) as error:
            raise DamagedFileError(f"{self.path} is of other robots ({error!r})") from error
        return cohort, stored

    def progress(self) -> BrainsInTime:
        """Returns the networks of the valid robots at all times.

        Raises:
          InputError: the job is not finished, or `restored` raises it.
          RunError: no robot is valid.
        """
        cohort, stored = self.restored()
        if len(_first(stored)) < TIMES:
            raise InputError(f"{self.path} lacks networks of later times")
        valid = cohort.batch.valid
        if not valid.any():
            raise RunError(f"{self.name}: every simulation became unstable")
        networks = {name: array[:, valid] for name, array in stored.items()}
        steps = np.array(times(self.experiment))
        hours = (steps - steps[0]) / control_steps(60)
        return BrainsInTime(self.experiment, self.name, hours, networks, int((~valid).sum()))


def _first(networks: Mapping[str, np.ndarray]) -> np.ndarray:
    return next(iter(networks.values()))


@dataclasses.dataclass(frozen=True)
class FrozenTest:
    """Evaluates all brains of a finished `StoredLifeJob` in one test.

    Attributes:
      life: Job that stored the brains.
      seed: Seed of the brains' noise.
    """

    life: StoredLifeJob
    seed: int

    def __str__(self) -> str:
        return f"test {self.seed} of {self.life.name}"

    @property
    def path(self) -> Path:
        """See `Job.path`."""
        return self.life.out / f"test-{self.life.name}-{self.seed}.safetensors"

    @property
    def cost(self) -> float:
        """See `Job.cost`; assumes that all robots are valid."""
        experiment = self.life.experiment
        steps = control_steps(experiment.schedule(CONDITION.task).phases[-1].minutes)
        return experiment.robot_seconds(TIMES * steps)

    def done(self) -> bool:
        """See `Job.done`; False for the file of other brains, such as those of another machine."""
        if not self.path.exists():
            return False
        return load_arrays(self.path)[1] == self._notes(self.life.progress())

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; a test that was stopped starts from the beginning."""
        progress = self.life.progress()
        brains = progress.robots * TIMES
        groups = -(-brains // _TOGETHER)
        try:
            tick = MinuteTick(self, brains / groups, stop, report)
            shares = evaluate(progress, self.seed, tick)
        except StoppedError:
            return False
        save_arrays(self.path, {"shares": shares}, **self._notes(progress))
        return True

    def shares(self, progress: BrainsInTime) -> np.ndarray:
        """Reads the shares that `evaluate` returned for these brains.

        Raises:
          InputError: the file is missing, damaged, or belongs to other brains.
        """
        if not self.path.exists():
            raise InputError(f"{self.life.out} lacks {self.path.name}")
        shapes = {"shares": ("F64", (TIMES, progress.robots))}
        shares = own_arrays(self.path, shapes, self._notes(progress))["shares"]
        check_shares(self.path, shares)
        return shares

    def _notes(self, progress: BrainsInTime) -> dict[str, Any]:
        return {"seed": self.seed, "brains": digest(progress.networks)}


def evaluate(progress: BrainsInTime, seed: int, tick: Tick = lambda: None) -> np.ndarray:
    """Evaluates all brains in the test after training, with frozen weights.

    Args:
      progress: Brains to evaluate.
      seed: Seed of the brains' noise.
      tick: Function called after every simulated minute of each group of robots; the robots of a
        group are simulated in lockstep.

    Returns:
      Share of the time in the spot, shape (T, R); NaN where the simulation became unstable.
    """
    experiment = progress.experiment
    test = experiment.schedule(CONDITION.task).phases[-1]
    everyone = np.indices((len(progress.hours), progress.robots)).reshape(2, -1)
    shares = []
    for first in range(0, everyone.shape[1], _TOGETHER):
        which = everyone[:, first : first + _TOGETHER]
        batch = experiment.batch(CONDITION.task, which.shape[1])
        place(batch, test, np.random.default_rng(0))
        agent = progress.brains(which, seed)
        steps = control_steps(test.minutes)
        counts = count_events(batch, agent, steps, tick=tick)
        shares.append(np.where(batch.valid, counts / steps, np.nan))
    return np.concatenate(shares).reshape(len(progress.hours), -1)


def evaluation(life: StoredLifeJob) -> Evaluation:
    """Returns the evaluation of the brains of a finished job, read from its files.

    Raises:
      InputError: a file is missing or damaged.
      RunError: no robot is valid.
    """
    progress = life.progress()
    tests = [FrozenTest(life, seed).shares(progress) for seed in SEEDS]
    return Evaluation(progress, np.array(tests), *ideas(progress))


def smells(experiment: Experiment) -> np.ndarray:
    """Returns the sensor signals at each of `SMELLS`, far from all walls, shape (S, signals)."""
    batch = experiment.batch(CONDITION.task, len(SMELLS))
    everyone, nose = np.arange(batch.robots), batch.dimensions.nose
    # The spot is in the middle and ahead of the robot; for no smell it is far behind.
    poses = [(0.3 if far is None else -nose - far, 0.0, 0.0) for far in SMELLS.values()]
    batch.place_spot(everyone, np.zeros((batch.robots, 2)))
    batch.place(everyone, np.array(poses))
    return batch.rules.state(batch.sensordata).astype(np.float32)


@torch.inference_mode()
def ideas(progress: BrainsInTime) -> tuple[np.ndarray, np.ndarray]:
    """Returns `Evaluation.spread` and `Evaluation.regret` of brains at each of `SMELLS`."""
    count, robots = len(progress.hours), progress.robots
    spread, missing = np.zeros((2, count, len(SMELLS), robots))
    for time in range(count):
        brain = progress.brains(np.stack([np.full(robots, time), np.arange(robots)])).controller
        for smell, state in enumerate(torch.from_numpy(smells(progress.experiment))):
            sensed = state.expand(robots, -1)
            proposed = brain.propose(sensed)
            around = proposed - proposed.mean(dim=1, keepdim=True)
            spread[time, smell] = around.norm(dim=-1).mean(dim=1)
            missing[time, smell] = regret(brain, sensed, proposed[:, None])[:, 0]
    return spread, missing
