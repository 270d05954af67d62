"""Measures speed: some work and the physics in it, timed in alternation.

On a CPU the clock is the processor time of the thread, which other programs hardly change.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import multiprocessing
import re
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.synchronize import Barrier
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco import rollout

from ... import tasks
from ...controller import BRAINS
from ...tasks import CONTROL_TIMESTEP, Batch
from ..errors import RunError
from ..lives.cohort import Cohort
from ..lives.conditions import PAPER_TASKS, CohortKey, Condition
from ..lives.experiment import Experiment
from ..lives.jobs import DIED
from ..lives.local import prepare_process, single_threaded_children
from ..lives.plan import Plan
from ..lives.runs import check_device

_POPULATION = Condition("spot_finding", "creative")
SIMULATORS = {"kinematic": {"body": "kinematic"}, "MuJoCo Warp": {"physics": "warp"}}
_BODIES = ("mujoco", "kinematic")
_BRAINS = ("paper", "steady")
_MOST_STEPS = 250  # in a repetition, so that all end before the robots are placed again
_OUT_OF_MEMORY = re.compile("out of memory|Failed to allocate")  # of PyTorch and of Warp
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value

State = dict[str, np.ndarray]
Pair = tuple[float, float]  # duration of some work and of its reference in [s]


@dataclasses.dataclass(frozen=True)
class Effort:
    """How much is measured."""

    repetitions: int = 7
    robot_steps: int = 12_500  # about, in a repetition
    cohorts: tuple[int, ...] = (50, 250)
    populations: tuple[int, ...] = (256, 1024, 4096, 16_384, 65_536)  # on a GPU
    population_steps: int = 100  # control steps in a repetition

    def steps(self, robots: int) -> int:
        """Returns the number of control steps in a repetition."""
        return max(1, min(self.robot_steps // robots, _MOST_STEPS))


FULL = Effort()
QUICK = Effort(2, 6, (2, 3), (2,), 2)


@dataclasses.dataclass(frozen=True)
class Paired:
    """Durations of some work and of its reference in [s], of repetitions in alternation.

    Attributes:
      robot_steps: Number of robot-steps (control steps of one robot) in a repetition.
      seconds: Duration of the work, one value for each repetition.
      reference: Duration of the reference, one value for each repetition.
    """

    robot_steps: int
    seconds: tuple[float, ...]
    reference: tuple[float, ...]

    @classmethod
    def of(cls, robot_steps: int, repetitions: int, pair: Callable[[], Pair]) -> Paired:
        """Calls a function that times both, once to warm up and then for each repetition."""
        pair()
        seconds, reference = zip(*(pair() for _ in range(repetitions)), strict=True)
        return cls(robot_steps, seconds, reference)

    def numbers(self) -> dict[str, float]:
        """Returns the median rates of the work and of the reference, and the ratio of the rates.

        Rates are in robot-steps per second. The ratio is the median of the repetitions' ratios;
        `lowest` and `highest` are its range.
        """
        ratios = np.array(self.reference) / np.array(self.seconds)
        return {
            "rate": float(self.robot_steps / np.median(self.seconds)),
            "rate_alone": float(self.robot_steps / np.median(self.reference)),
            "ratio": float(np.median(ratios)),
            "lowest": float(ratios.min()),
            "highest": float(ratios.max()),
        }


class BareMujoco:
    """MuJoCo alone: one call for each control step, with all sensors and without checks.

    One robot is simulated by `mj_step`, several by `mujoco.rollout`: the faster one for each. Any
    program that chooses new motor values in every control step must do at least this.
    """

    def __init__(self, model: mujoco.MjModel, robots: int) -> None:
        """Allocates the arrays of B robots."""
        self._model, self._data = model, mujoco.MjData(model)
        self._substeps = round(CONTROL_TIMESTEP / model.opt.timestep)
        self._models = [model] * robots
        self._engine = rollout.Rollout(nthread=0)  # in the calling thread
        self._states = np.zeros((robots, self._substeps, mujoco.mj_stateSize(model, _STATE)))
        self._sensors = np.zeros((robots, self._substeps, model.nsensordata))

    def replay(self, start: State, motors: np.ndarray) -> tuple[float, State]:
        """Simulates T control steps.

        Args:
          start: MuJoCo's full physics states as "state", shape (B, n).
          motors: Motor values, shape (T, B, 2).

        Returns:
          The duration in [s], and the final states.
        """
        state = start["state"].copy()
        if len(state) == 1:
            return self._one(state, motors)
        controls = np.repeat(motors[:, :, None].astype(float), self._substeps, axis=2)
        began = time.thread_time()
        for control in controls:
            self._engine.rollout(
                self._models,
                [self._data],
                state,
                control,
                nstep=self._substeps,
                state=self._states,
                sensordata=self._sensors,
                skip_checks=True,
            )
            state[:] = self._states[:, -1]
        return time.thread_time() - began, {"state": state}

    def _one(self, state: np.ndarray, motors: np.ndarray) -> tuple[float, State]:
        mujoco.mj_setState(self._model, self._data, state[0], _STATE)
        began = time.thread_time()
        for control in motors:
            self._data.ctrl[:] = control[0]
            mujoco.mj_step(self._model, self._data, self._substeps)
        seconds = time.thread_time() - began
        mujoco.mj_getState(self._model, self._data, state[0], _STATE)
        return seconds, {"state": state}


def over_bare(
    work: Callable[[], np.ndarray],
    state: Callable[[], State],
    replay: Callable[[State, np.ndarray], tuple[float, State]],
) -> Pair:
    """Times some work, and then the same physics alone; returns both durations in [s].

    Args:
      work: Function that simulates robots and returns their motor values, shape (T, B, 2).
      state: Function that returns the robots' states.
      replay: Function that simulates the physics alone, see `BareMujoco.replay`.

    Raises:
      RunError: The final states differ, so the physics was not the same.
    """
    start = {name: array.copy() for name, array in state().items()}
    began = time.thread_time()
    motors = work()
    seconds = time.thread_time() - began
    bare, end = replay(start, motors)
    now = state()
    if not all(np.array_equal(array, now[name]) for name, array in end.items()):
        raise RunError("the physics alone did not end in the states of the work that it repeats")
    return seconds, bare


def cohort_in_training(experiment: Experiment, condition: Condition) -> Cohort:
    """Returns a cohort at the start of its training, without the tests before it."""
    cohort = Cohort(experiment, CohortKey(condition, 0))
    legs = experiment.schedule(condition.task).legs()
    cohort.step = next(leg.start for leg in legs if leg.phase.learning)
    cohort.advance(1)  # places the robots
    return cohort


def lives(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each body, task, brain and cohort of creative robots."""
    kinds = itertools.product(_BODIES, PAPER_TASKS, _BRAINS, effort.cohorts)
    for body, task, brain, robots in kinds:
        settings: dict[str, Any] = {"body": body, "brain": BRAINS[brain], "cohort_size": robots}
        cohort = cohort_in_training(Experiment(**settings), Condition(task, "creative"))
        timed = life(cohort, effort.steps(robots), effort.repetitions)
        labels = {"body": body, "task": task, "brain": brain, "robots": robots}
        yield labels | timed.numbers()


def life(cohort: Cohort, steps: int, repetitions: int) -> Paired:
    """Times so many control steps of a cohort, and its physics alone."""
    batch = cohort.batch

    def work() -> np.ndarray:
        recorded = []

        def step(motors: np.ndarray) -> None:
            recorded.append(motors.copy())
            type(batch).step(batch, motors)

        batch.step = step
        cohort.advance(steps)
        del batch.step
        return np.array(recorded)

    def kinematic(start: State, motors: np.ndarray) -> tuple[float, State]:
        batch.set_state(start)
        began = time.thread_time()
        for command in motors:
            batch.step(command)
        return time.thread_time() - began, batch.get_state()

    bare = BareMujoco(batch.model, batch.robots).replay if isinstance(batch, Batch) else kinematic
    pair = functools.partial(over_bare, work, batch.arrays, bare)
    return Paired.of(steps * batch.robots, repetitions, pair)


def interfaces(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each interface to wall avoidance; Gymnasium's where it is installed."""
    environment = tasks.load("arena", "wall_avoidance", task_kwargs={"random": 1})
    environment.reset()

    def dm_control_step(actions: np.ndarray) -> None:
        environment.step(actions[0])

    yield _interface_row("dm_control", [environment], dm_control_step, effort)
    try:
        import gymnasium
    except ImportError:
        return
    name = "musebot/WallAvoidance-v0"
    single = gymnasium.make(name, max_episode_steps=-1)
    single.reset(seed=0)
    one = [single.unwrapped]
    yield _interface_row("Gymnasium, single", one, lambda actions: single.step(actions[0]), effort)
    for kind, mode in (("vector of singles", "sync"), ("batch", "vector_entry_point")):
        vector: Any = gymnasium.make_vec(
            name, effort.cohorts[0], vectorization_mode=mode, max_episode_steps=-1
        )
        vector.reset(seed=0)
        inside = vector._batch if kind == "batch" else [one.unwrapped for one in vector.envs]
        yield _interface_row(f"Gymnasium, {kind}", inside, vector.step, effort)


def _interface_row(
    name: str, robots: Any, step: Callable[[np.ndarray], object], effort: Effort
) -> dict[str, Any]:
    """Returns the row of an interface.

    Args:
      name: Name of the interface.
      robots: A `Batch`, or a list of environments with dm_control's `physics`.
      step: Function that simulates one control step, given motor values of shape (B, 2).
      effort: How much is measured.
    """

    def state() -> State:
        states = np.empty((count, mujoco.mj_stateSize(model, _STATE)))
        for row, one in zip(states, robots, strict=True):
            mujoco.mj_getState(model, one.physics.data.ptr, row, _STATE)
        return {"state": states}

    if isinstance(robots, Batch):
        model, count, own = robots.model, robots.robots, robots.arrays
    else:
        model, count, own = robots[0].physics.model.ptr, len(robots), state
    steps, random = effort.steps(count), np.random.default_rng(0)

    def work() -> np.ndarray:
        motors = random.uniform(-0.5, 0.5, (steps, count, 2)).astype(np.float32)
        for control in motors:
            step(control)
        return motors

    pair = functools.partial(over_bare, work, own, BareMujoco(model, count).replay)
    timed = Paired.of(steps * count, effort.repetitions, pair)
    return {"interface": name, "robots": count} | timed.numbers()


def processes(effort: Effort, cores: int) -> Iterator[dict[str, Any]]:
    """Yields a row for two processes, and for one on each core: together, and one alone.

    `process_scaling` is the throughput of all together divided by that of one alone, if each has
    a core of its own.

    Raises:
      RunError: A process died.
    """
    most = max(cores, 2)
    context = multiprocessing.get_context("spawn")
    prepared = context.Barrier(most), effort
    with (
        single_threaded_children(),
        ProcessPoolExecutor(most, context, _prepare, prepared) as pool,
    ):

        def seconds(active: int) -> float:
            blocks = [pool.submit(_simulate, active) for _ in range(most)]
            return sum(block.result() for block in blocks) / active

        def pair(count: int) -> Pair:
            return seconds(count), seconds(1)

        robots = effort.cohorts[-1]
        robot_steps = robots * effort.steps(robots)
        for count in sorted({2, most}):
            both = functools.partial(pair, count)
            try:
                numbers = Paired.of(robot_steps, effort.repetitions, both).numbers()
            except BrokenProcessPool as error:
                raise RunError(DIED) from error
            labels = {"processes": count, "robots": robots}
            yield labels | numbers | {"process_scaling": count * numbers["ratio"]}


_worker: Any = None  # in a process of the pool: the barrier of all, a cohort, its control steps


def _prepare(together: Barrier, effort: Effort) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    prepare_process()
    robots = effort.cohorts[-1]
    condition = Condition("wall_avoidance", "creative")
    cohort = cohort_in_training(Experiment(cohort_size=robots), condition)
    _worker = together, cohort, effort.steps(robots)


def _simulate(active: int) -> float:
    """Returns the processor time of a block in [s]; all but so many processes wait: 0."""
    together, cohort, steps = _worker
    seconds = 0.0
    if together.wait() < active:
        began = time.thread_time()
        cohort.advance(steps)
        seconds = time.thread_time() - began
    together.wait()
    return seconds


def check_populations(device: str) -> None:
    """Raises InputError where a device is missing, or MuJoCo Warp is not installed."""
    for simulator in SIMULATORS:
        check_device(Plan.of(_experiment(simulator, device, 1), [_POPULATION], 1))


def populations(effort: Effort, device: str) -> Iterator[dict[str, Any]]:
    """Yields a row for each simulator and number of robots: lives, and their physics alone.

    The numbers are missing where the memory is too small. On a GPU the clock is the wall's.
    """
    sizes = effort.cohorts if device == "cpu" else effort.populations
    for simulator, robots in itertools.product(SIMULATORS, sizes):
        row = {"simulator": simulator, "robots": robots}
        try:
            row |= _population(_experiment(simulator, device, robots), effort).numbers()
        except RuntimeError as error:
            if not _OUT_OF_MEMORY.search(str(error)):
                raise
        if device != "cpu":
            torch.cuda.empty_cache()  # Warp has memory of its own
        yield row


def _experiment(simulator: str, device: str, robots: int) -> Experiment:
    settings: Any = SIMULATORS[simulator]
    return Experiment(cohort_size=robots, device=device, **settings)


def _population(experiment: Experiment, effort: Effort) -> Paired:
    cohort, device = cohort_in_training(experiment, _POPULATION), experiment.device
    batch: Any = cohort.batch
    steps = effort.population_steps
    motors: Any = torch.rand(batch.robots, 2, device=device) - 0.5
    motors = motors if experiment.on_tensors else motors.numpy()

    def now() -> float:
        if device == "cpu":
            return time.thread_time()
        torch.cuda.synchronize(device)
        return time.perf_counter()

    def pair() -> Pair:
        began = now()
        cohort.advance(steps)
        between = now()
        for _ in range(steps):
            batch.step(motors)
        return between - began, now() - between

    return Paired.of(steps * batch.robots, effort.repetitions, pair)
