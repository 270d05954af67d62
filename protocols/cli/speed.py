"""Measures speed: some work and the physics in it, timed in alternation.

On a CPU the clock is the processor time of the thread, which other programs hardly change.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco import rollout

from ... import tasks
from ...controller import BRAINS
from ...tasks import Batch
from ...tasks.batch import substeps_of
from ...tasks.lives import PAPER_LIVES
from ..errors import RunError
from ..lives.cohort import Cohort
from ..lives.conditions import CohortKey, Condition
from ..lives.experiment import Body, Experiment
from ..lives.plan import Plan
from ..lives.runs import check_device

_POPULATION = Condition("spot_finding", "creative")
SIMULATORS: dict[str, dict[str, Any]] = {
    "kinematic": {"body": "kinematic"},
    "MuJoCo Warp": {"physics": "warp"},
}
_BODIES: tuple[Body, ...] = ("mujoco", "kinematic")
_MOST_STEPS = 250  # in a repetition, so that all end before the robots are placed again
_OUT_OF_MEMORY = re.compile("out of memory|Failed to allocate")  # of PyTorch and of Warp
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value

State = dict[str, np.ndarray]
Pair = tuple[float, float]  # duration of some work and of its reference in [s]
# Simulates robots from their states, given motor values of shape (T, B, 2); returns the duration in
# [s] and the final states.
Replay = Callable[[State, np.ndarray], tuple[float, State]]


@dataclasses.dataclass(frozen=True)
class Effort:
    """How much is measured."""

    repetitions: int = 7
    robot_steps: int = 12_500  # about, in a repetition
    cohorts: tuple[int, ...] = (50, 250)
    backends: tuple[int, ...] = (1, 8, 60, 250, 1000)
    populations: tuple[int, ...] = (256, 1024, 4096, 16_384, 65_536)  # on a GPU
    population_steps: int = 100  # control steps in a repetition

    def steps(self, robots: int) -> int:
        """Returns the number of control steps in a repetition."""
        return max(1, min(self.robot_steps // robots, _MOST_STEPS))


FULL = Effort()
QUICK = Effort(2, 6, (2, 3), (2,), (2,), 2)


def paired(robot_steps: int, repetitions: int, pair: Callable[[], Pair]) -> dict[str, float]:
    """Times some work of `robot_steps` and its reference, once to warm up, then in repetitions.

    Returns:
      The median rates of the work and of the reference in robot-steps per second, and the ratio of
      the rates: the median of the repetitions' ratios, with their range, `lowest` and `highest`.
    """
    pair()
    seconds, reference = np.array([pair() for _ in range(repetitions)]).T
    ratios = reference / seconds
    return {
        "rate": float(robot_steps / np.median(seconds)),
        "rate_alone": float(robot_steps / np.median(reference)),
        "ratio": float(np.median(ratios)),
        "lowest": float(ratios.min()),
        "highest": float(ratios.max()),
    }


def bare_mujoco(model: mujoco.MjModel, robots: int) -> Replay:
    """Returns a function that simulates B robots by MuJoCo's rollouts alone.

    Any program that chooses new motor values in every control step must do at least this. The last
    substep is a rollout of its own, where the solver begins anew, as in a `Batch`.
    """
    substeps, size = substeps_of(model), mujoco.mj_stateSize(model, _STATE)
    engine, data = rollout.Rollout(nthread=0), mujoco.MjData(model)  # in the calling thread
    models = [model] * robots
    parts = [steps for steps in (substeps - 1, 1) if steps]
    states, sensors = (
        [np.zeros((robots, steps, width)) for steps in parts] for width in (size, model.nsensordata)
    )

    def replay(start: State, motors: np.ndarray) -> tuple[float, State]:
        state, motors = start["state"].copy(), motors[:, :, None].astype(float)
        controls = [np.repeat(motors, steps, axis=2) for steps in parts]
        began = time.thread_time()
        for step in range(len(motors)):
            for nstep, control, after, sensed in zip(parts, controls, states, sensors, strict=True):
                engine.rollout(
                    models,
                    [data],
                    state,
                    control[step],
                    nstep=nstep,
                    state=after,
                    sensordata=sensed,
                    skip_checks=True,
                )
                state[:] = after[:, -1]
        return time.thread_time() - began, {"state": state}

    return replay


def over_bare(work: Callable[[], np.ndarray], state: Callable[[], State], replay: Replay) -> Pair:
    """Times some work, and then the same physics alone; returns both durations in [s].

    The work simulates robots and returns their motor values, shape (T, B, 2).

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
    legs = experiment.life_of(condition.task).legs()
    cohort.step = next(leg.start for leg in legs if leg.phase.learning)
    cohort.advance(1)  # places the robots
    return cohort


def lives(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each body, task, brain and cohort of creative robots."""
    kinds = itertools.product(_BODIES, PAPER_LIVES, ("paper", "steady"), effort.cohorts)
    for body, task, brain, robots in kinds:
        experiment = Experiment(body=body, brain=BRAINS[brain], cohort_size=robots)
        cohort = cohort_in_training(experiment, Condition(task, "creative"))
        labels = {"body": body, "task": task, "brain": brain, "robots": robots}
        yield labels | life(cohort, effort.steps(robots), effort.repetitions)


def life(cohort: Cohort, steps: int, repetitions: int) -> dict[str, float]:
    """Times so many control steps of a cohort, and its physics alone; see `paired`."""
    batch = cohort.batch
    recorder = cohort.recorded()

    def work() -> np.ndarray:
        recorder.motors.clear()
        cohort.advance(steps)
        return np.array(recorder.motors)

    def kinematic(start: State, motors: np.ndarray) -> tuple[float, State]:
        batch.set_state(start)
        began = time.thread_time()
        for command in motors:
            batch.step(command)
        return time.thread_time() - began, batch.get_state()

    bare = bare_mujoco(batch.model, batch.robots) if isinstance(batch, Batch) else kinematic
    pair = functools.partial(over_bare, work, batch.arrays, bare)
    return paired(steps * batch.robots, repetitions, pair)


def backends(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each number of robots: kinematic lives by Numba, and by PyTorch."""
    for robots in effort.backends:
        one, other = (
            cohort_in_training(
                Experiment(body="kinematic", cohort_size=robots, backend=backend), _POPULATION
            )
            for backend in ("numba", "torch")
        )
        steps = effort.steps(robots)

        def pair(one: Cohort = one, other: Cohort = other, steps: int = steps) -> Pair:
            began = time.thread_time()
            one.advance(steps)
            middle = time.thread_time()
            other.advance(steps)
            return middle - began, time.thread_time() - middle

        yield {"robots": robots} | paired(steps * robots, effort.repetitions, pair)


def interfaces(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each interface to wall avoidance; Gymnasium's where it is installed."""
    environment = tasks.load("arena", "wall_avoidance", task_kwargs={"random": 1})
    environment.reset()
    yield _interface_row("dm_control", [environment], lambda a: environment.step(a[0]), effort)
    try:
        import gymnasium
    except ImportError:
        return
    name = "musebot/WallAvoidance-v0"
    single = gymnasium.make(name, max_episode_steps=-1)
    single.reset(seed=0)
    one = [single.unwrapped]
    yield _interface_row("Gymnasium, single", one, lambda a: single.step(a[0]), effort)
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

    `robots` is a `Batch`, or a list of environments with dm_control's `physics`. `step` simulates
    one control step, given motor values of shape (B, 2).
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

    pair = functools.partial(over_bare, work, own, bare_mujoco(model, count))
    return {"interface": name, "robots": count} | paired(steps * count, effort.repetitions, pair)


def check_populations(device: str) -> None:
    """Raises InputError where a device is missing, or MuJoCo Warp is not installed."""
    for fields in SIMULATORS.values():
        experiment = Experiment(cohort_size=1, device=device, **fields)
        check_device(Plan.of(experiment, [_POPULATION], 1))


def populations(effort: Effort, device: str) -> Iterator[dict[str, Any]]:
    """Yields a row for each simulator and number of robots: lives, and their physics alone.

    The numbers are missing where the memory is too small. On a GPU the clock is the wall's.
    """
    sizes = effort.cohorts if device == "cpu" else effort.populations
    for (simulator, fields), robots in itertools.product(SIMULATORS.items(), sizes):
        row: dict[str, Any] = {"simulator": simulator, "robots": robots}
        try:
            row |= _population(Experiment(cohort_size=robots, device=device, **fields), effort)
        except RuntimeError as error:
            if not _OUT_OF_MEMORY.search(str(error)):
                raise
        if device != "cpu":
            torch.cuda.empty_cache()  # Warp has memory of its own
        yield row


def _population(experiment: Experiment, effort: Effort) -> dict[str, float]:
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

    return paired(steps * batch.robots, effort.repetitions, pair)
