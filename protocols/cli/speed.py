"""Measures speed: times a piece of work and a reference for it, in alternation.

On a CPU, the clock is the processor time of the thread, which other programs hardly change.
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
from ..progress import tracked
from ..runs.cohort import Cohort
from ..runs.conditions import CohortKey, Condition
from ..runs.experiment import BODIES, Experiment
from ..runs.plan import Plan
from ..runs.simulation import check_device

_POPULATION = Condition("spot_finding", "creative")
SIMULATORS: dict[str, dict[str, Any]] = {
    "kinematic": {"body": "kinematic"},
    "MuJoCo Warp": {"physics": "warp"},
}
_MOST_STEPS = 250  # in a repetition, so that all end before robots are placed again
_OUT_OF_MEMORY = re.compile("out of memory|Failed to allocate")  # messages of PyTorch and of Warp


@dataclasses.dataclass(frozen=True)
class Effort:
    """How many robots and steps are timed, and how often."""

    repetitions: int = 7
    robot_steps: int = 12_500  # in a repetition, approximately
    cohorts: tuple[int, ...] = (50, 250)  # robots
    backends: tuple[int, ...] = (1, 8, 60, 250, 1000)  # robots
    populations: tuple[int, ...] = (256, 1024, 4096, 16_384, 65_536)  # robots on a GPU
    population_steps: int = 100  # control steps in a repetition

    def steps(self, robots: int) -> int:
        """Returns the number of control steps in a repetition."""
        return max(1, min(self.robot_steps // robots, _MOST_STEPS))


FULL = Effort()
QUICK = Effort(2, 6, (2, 3), (2,), (2,), 2)


def paired(
    robot_steps: int,
    repetitions: int,
    work: Callable[[], object],
    other: Callable[[], object],
    device: str = "cpu",
) -> dict[str, float]:
    """Times `work` and `other`, of `robot_steps` each: once to warm up, then in repetitions.

    On a GPU, the clock is wall-clock time.

    Returns:
      The median rates of `work` and of `other` in robot-steps per second, and the ratio of these
      rates: the median of the repetitions' ratios, with their range, `lowest` and `highest`.
    """

    def now() -> float:
        if device == "cpu":
            return time.thread_time()
        torch.cuda.synchronize(device)
        return time.perf_counter()

    times = []
    for _ in range(1 + repetitions):
        began = now()
        work()
        between = now()
        other()
        times.append((between - began, now() - between))
    seconds, reference = np.array(times[1:]).T
    ratios = reference / seconds
    return {
        "rate": float(robot_steps / np.median(seconds)),
        "rate_alone": float(robot_steps / np.median(reference)),
        "ratio": float(np.median(ratios)),
        "lowest": float(ratios.min()),
        "highest": float(ratios.max()),
    }


def cohort_in_training(experiment: Experiment, condition: Condition) -> Cohort:
    """Returns a cohort at the start of its training; the test before is skipped."""
    cohort = Cohort(experiment, CohortKey(condition, 0))
    legs = experiment.life_of(condition.life).legs()
    cohort.step = next(leg.start for leg in legs if leg.phase.learning)
    cohort.advance(1)  # places the robots
    return cohort


def against_mujoco(cohort: Cohort, steps: int) -> tuple[Callable[[], None], Callable[[], None]]:
    """Returns two functions: one simulates a cohort's steps in MuJoCo, the other their physics.

    The second repeats the motor values of the first, from the same states, by `mujoco.rollout`. Any
    program that chooses new motor values in every control step must simulate this physics. The last
    substep is a rollout of its own, where the solver begins anew, as in a `Batch`. The second
    function raises RunError if it ends in other states.
    """
    batch: Any = cohort.batch
    recorded, model = cohort.recorded(), batch.model
    engine, data = rollout.Rollout(nthread=0), mujoco.MjData(model)  # in the calling thread
    models, state = [model] * batch.robots, batch.arrays()["state"].copy()
    parts = [substeps for substeps in (substeps_of(model) - 1, 1) if substeps]
    widths = state.shape[1], model.nsensordata
    found = [[np.zeros((batch.robots, n, width)) for width in widths] for n in parts]

    def live() -> None:
        recorded.clear()
        state[:] = batch.arrays()["state"]
        cohort.advance(steps)

    def replay() -> None:
        for motors in recorded:
            control = motors[:, None].astype(float)
            for substeps, (after, sensed) in zip(parts, found, strict=True):
                engine.rollout(
                    models,
                    [data],
                    state,
                    control.repeat(substeps, axis=1),
                    nstep=substeps,
                    state=after,
                    sensordata=sensed,
                    skip_checks=True,
                )
                state[:] = after[:, -1]
        if not np.array_equal(state, batch.arrays()["state"]):
            raise RunError("the physics alone did not end in the states of the life it repeats")

    return live, replay


def life(cohort: Cohort, steps: int, repetitions: int) -> dict[str, float]:
    """Times control steps of a cohort, and of its physics; see `paired`.

    MuJoCo's physics repeats the same motor values, see `against_mujoco`; that of other simulators
    gets random ones.
    """
    batch: Any = cohort.batch
    if isinstance(batch, Batch):
        return paired(steps * batch.robots, repetitions, *against_mujoco(cohort, steps))
    device, on_tensors = cohort.experiment.device, cohort.experiment.on_tensors
    motors: Any = torch.rand(batch.robots, 2, device=device) - 0.5
    motors = motors if on_tensors else motors.numpy()

    def physics() -> None:
        for _ in range(steps):
            batch.step(motors)

    work = functools.partial(cohort.advance, steps)
    return paired(steps * batch.robots, repetitions, work, physics, device)


def lives(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each body, task, brain and size of a cohort of creative robots."""
    kinds = [*itertools.product(BODIES, PAPER_LIVES, ("paper", "steady"), effort.cohorts)]
    for body, task, brain, robots in tracked(kinds, "lives"):
        experiment = Experiment(body=body, brain=BRAINS[brain], cohort_size=robots)
        cohort = cohort_in_training(experiment, Condition(task, "creative"))
        labels = {"body": body, "task": task, "brain": brain, "robots": robots}
        yield labels | life(cohort, effort.steps(robots), effort.repetitions)


def backends(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each number of robots: Numba and PyTorch in the kinematic simulator."""
    for robots in tracked(effort.backends, "backends"):
        steps = effort.steps(robots)
        advances = []
        for backend in ("numba", "torch"):
            experiment = Experiment(body="kinematic", cohort_size=robots, backend=backend)
            cohort = cohort_in_training(experiment, _POPULATION)
            advances.append(functools.partial(cohort.advance, steps))
        yield {"robots": robots} | paired(steps * robots, effort.repetitions, *advances)


def interfaces(effort: Effort) -> Iterator[dict[str, Any]]:
    """Yields a row for each interface to wall avoidance, with Gymnasium's if it is installed."""
    environment = tasks.load("arena", "wall_avoidance", task_kwargs={"random": 1})
    environment.reset()
    yield _interface_row("dm_control", 1, lambda a: environment.step(a[0]), effort)
    try:
        import gymnasium
    except ImportError:
        return
    name, several = "musebot/WallAvoidance-v0", effort.cohorts[0]
    single = gymnasium.make(name, max_episode_steps=-1)
    single.reset(seed=0)
    yield _interface_row("Gymnasium, single", 1, lambda a: single.step(a[0]), effort)
    for kind, mode in (("vector of singles", "sync"), ("batch", "vector_entry_point")):
        vector = gymnasium.make_vec(name, several, vectorization_mode=mode, max_episode_steps=-1)
        vector.reset(seed=0)
        yield _interface_row(f"Gymnasium, {kind}", several, vector.step, effort)


def _interface_row(
    name: str, robots: int, step: Callable[[np.ndarray], object], effort: Effort
) -> dict[str, Any]:
    """Returns the row of an interface, whose `step` takes motor values of shape (B, 2)."""
    batch, steps = tasks.make_batch("wall_avoidance", robots), effort.steps(robots)
    random = np.random.default_rng(0)
    motors = random.uniform(-0.5, 0.5, (steps, robots, 2)).astype(np.float32)

    def drive(step: Callable[[np.ndarray], object]) -> None:
        for command in motors:
            step(command)

    work, physics = functools.partial(drive, step), functools.partial(drive, batch.step)
    found = paired(steps * robots, effort.repetitions, work, physics)
    return {"interface": name, "robots": robots} | found


def check_populations(device: str) -> None:
    """Raises InputError if the device is missing, or MuJoCo Warp is not installed."""
    for fields in SIMULATORS.values():
        experiment = Experiment(cohort_size=1, device=device, **fields)
        check_device(Plan.of(experiment, [_POPULATION], 1))


def populations(effort: Effort, device: str) -> Iterator[dict[str, Any]]:
    """Yields a row for each simulator and number of robots; no rates if memory is too small."""
    sizes = effort.cohorts if device == "cpu" else effort.populations
    kinds = [*itertools.product(SIMULATORS.items(), sizes)]
    for (simulator, fields), robots in tracked(kinds, "populations"):
        row: dict[str, Any] = {"simulator": simulator, "robots": robots}
        try:
            experiment = Experiment(cohort_size=robots, device=device, **fields)
            length = effort.population_steps, effort.repetitions
            # The cohort has no name, so that it is freed before the next one is made.
            row |= life(cohort_in_training(experiment, _POPULATION), *length)
        except RuntimeError as error:
            if not _OUT_OF_MEMORY.search(str(error)):
                raise
        if device != "cpu":
            torch.cuda.empty_cache()  # Warp has memory of its own
        yield row
