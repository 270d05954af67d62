"""A cohort: robots in lockstep, each alone in its arena, from the first test to the last."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ...tasks.batch import Robots
from ...tasks.tensors.robots import Part
from ..agents.base import sound
from ..agents.names import TRAINED_BEFORE, is_own, short_name
from ..agents.settings import settings_from
from ..errors import InputError
from ..lives.agent import make_agent
from ..storage import DTYPES, Shapes
from .budget import check_agent_memory
from .conditions import CohortKey, Condition
from .device import agent_on_device, on_host, robots_on_device, step_work
from .experiment import Experiment
from .placement import legs, place
from .plan import Plan
from .random_streams import random_streams
from .run import Lives, Measured, check_events, check_finite, check_same_shapes
from .schedules import PARTS, Phase, control_steps

_MINUTE = control_steps(1)


class Cohort:
    """B robots that follow a schedule.

    Attributes:
      experiment: Experiment that decides the robots' lives.
      key: Condition and number of the cohort.
      batch: Robots in their arenas.
      agent: Agent that drives the robots.
      step: Number of control steps simulated so far.
      steps: Number of control steps of a whole life.
      unsound: Whether a weight of each robot has been seen that was not finite, since this object
        was made, shape (B,).
    """

    def __init__(self, experiment: Experiment, key: CohortKey, batch: Robots | None = None) -> None:
        """Makes robots at the start of their lives.

        Args:
          experiment: Experiment that decides the robots' lives.
          key: Condition and number of the cohort.
          batch: Robots that have not moved yet; None makes them.
        """
        robots, task = experiment.cohort_size, key.condition.task
        self.experiment, self.key = experiment, key
        seed, self._random = random_streams(experiment.seed, key)
        self.batch = robots_on_device(experiment, task)[0] if batch is None else batch
        self.agent = agent_on_device(
            experiment, lambda: make_agent(experiment, key.condition, robots, seed)
        )
        self._work = step_work(self)
        self._before = {k: v.copy() for k, v in self.agent.weights().items()}
        self._legs = legs(experiment.schedule(task))
        self.step = 0
        self.steps = self._legs[-1].stop
        self._events = np.zeros((robots, len(PARTS)), dtype=np.int32)
        self._minutes = np.zeros((robots, -(-self.steps // _MINUTE)), dtype=np.int16)
        self.unsound = np.zeros(robots, dtype=bool)
        self._stop_unsound()

    @property
    def finished(self) -> bool:
        """Whether the last test is over."""
        return self.step == self.steps

    @property
    def valid(self) -> np.ndarray:
        """Whether each robot's simulation is stable so far, shape (B,)."""
        return on_host(self.batch.valid)

    def advance(self, steps: int) -> None:
        """Simulates the given number of control steps, or fewer if the life ends before."""
        for motors in self.stepping(steps):
            self.batch.step(motors)

    def stepping(self, steps: int) -> Iterator[Any]:
        """Yields motor values, shape (B, 2), before each of the physics' next control steps.

        Args:
          steps: Number of control steps; fewer if the life ends before.
        """
        until = min(self.step + steps, self.steps)
        for leg in self._legs:
            if leg.stop <= self.step:
                continue
            if leg.start >= until:
                break
            if leg.start == self.step:
                self._place(leg.phase)
            yield from self._simulate(leg.phase, min(leg.stop, until))

    def _place(self, phase: Phase) -> None:
        place(self.batch, phase, self._random)
        if phase.robot is not None:
            self.agent.reset()

    def _simulate(self, phase: Phase, until: int) -> Iterator[Any]:
        part = PARTS.index(phase.part)
        while self.step < until:
            yield self._work.decide(phase.learning)
            self._work.count()  # after the physics' step
            self.step += 1
            over = self.step % _MINUTE == 0 or self.finished
            if over or self.step == until:
                counted = self._work.counted()
                self._events[:, part] += counted
                self._minutes[:, (self.step - 1) // _MINUTE] += counted
            if over:
                self._stop_unsound()

    def _stop_unsound(self) -> None:
        """Stops robots with a weight that is not finite: at birth, every minute, at the end."""
        unsound = ~sound(self.agent.weights(), self.batch.robots)
        self.unsound |= unsound
        self.batch.stop(np.flatnonzero(unsound))

    def lives(self) -> Lives:
        """Returns the results of the finished cohort."""
        return Lives(
            self._events,
            self._minutes,
            self.valid,
            self._before,
            {k: v.copy() for k, v in self.agent.weights().items()},
        )

    def checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Returns arrays and JSON notes from which `restore` continues bit-exactly."""
        arrays = {
            "events": self._events,
            "minutes": self._minutes,
            **{f"before.{k}": v for k, v in self._before.items()},
            **{f"brain.{k}": v for k, v in self.agent.state().items()},
            **{f"batch.{k}": v for k, v in self.batch.arrays().items()},
        }
        return arrays, {"step": self.step, "random": self._random.bit_generator.state}

    def check_shapes(self, shapes: Shapes) -> None:
        """Checks names, dtypes and shapes of a checkpoint's arrays before any is read.

        Arrays of a user's agent are not checked here: its `load_state` does that.

        Raises:
          ValueError: an array is missing, foreign, or of another dtype or shape.
        """
        own, _ = self.checkpoint()
        wanted = shapes_of(own)
        if not self.key.condition.has_brain:
            wanted, shapes = (
                {name: shape for name, shape in group.items() if not name.startswith("brain.")}
                for group in (wanted, shapes)
            )
        check_same_shapes(wanted, shapes)

    def restore(self, arrays: Mapping[str, np.ndarray], notes: Mapping[str, Any]) -> None:
        """Continues from a checkpoint of the same cohort.

        Args:
          arrays: Arrays of the checkpoint, of the shapes that `check_shapes` allows.
          notes: Notes of the checkpoint.

        Raises:
          KeyError, ValueError: an array is missing, its shape differs, or a value is impossible.
        """
        groups: dict[str, dict[str, Any]] = {"before": {}, "brain": {}, "batch": {}}
        for name, array in arrays.items():
            group, _, rest = name.partition(".")
            if rest:
                groups[group][rest] = array
        step = notes["step"]
        if type(step) is not int or not 0 <= step <= self.steps:
            raise ValueError(f"step must be a whole number in [0, {self.steps}], got {step!r:.60}")
        schedule = self.experiment.schedule(self.key.condition.task)
        check_events(schedule, arrays["events"], arrays["minutes"], step)
        self._check_robots(groups)
        self._set_random(notes["random"])
        self.batch.load_arrays(groups["batch"])
        try:
            self.agent.load_state(groups["brain"])
        except MemoryError:
            raise  # the checkpoint is sound
        except Exception as error:  # a user's agent may raise anything for a state of another's
            raise ValueError(f"its agent does not continue ({error!r})") from error
        for name, weights in self._before.items():
            weights[:] = groups["before"][name]
        self._events[:] = arrays["events"]
        self._minutes[:] = arrays["minutes"]
        self.step = step

    def _check_robots(self, groups: Mapping[str, Mapping[str, np.ndarray]]) -> None:
        """Raises ValueError where a valid robot has a number that is not finite."""
        valid = groups["batch"]["valid"]
        check_finite(groups["batch"], valid)
        check_finite(groups["before"], valid)

    def _set_random(self, state: Any) -> None:
        """Sets the world's random stream; raises ValueError where a state is not one."""
        generator = self._random.bit_generator
        try:
            generator.state = state
        except (ValueError, TypeError, KeyError, OverflowError, AttributeError) as error:
            raise ValueError(f"its random stream is damaged ({error!r:.100})") from error
        if generator.state != state:
            raise ValueError("its random stream is damaged")


def advance_together(cohorts: Sequence[Cohort], steps: int) -> None:
    """Simulates control steps of cohorts whose robots are parts of one batch.

    A process that was killed may have saved some of the cohorts only: those at the earliest step go
    first, while the others keep their states.

    Args:
      cohorts: Cohorts, one of them not finished.
      steps: Number of control steps; fewer if a life ends or others are reached before.
    """
    if len(cohorts) == 1:
        cohorts[0].advance(steps)
        return
    earliest = min(cohort.step for cohort in cohorts)
    moving = [cohort for cohort in cohorts if cohort.step == earliest]
    resting = [cohort for cohort in cohorts if cohort.step > earliest]
    states = [cohort.batch.get_state() for cohort in resting]
    steps = min(steps, *(cohort.step - earliest for cohort in resting)) if resting else steps
    parts = [cohort.batch for cohort in moving if isinstance(cohort.batch, Part)]
    whole = parts[0].whole
    for commands in zip(*(cohort.stepping(steps) for cohort in moving), strict=True):
        motors = commands[0].new_zeros(whole.robots, 2)
        for part, own in zip(parts, commands, strict=True):
            motors[part.rows] = own
        whole.step(motors)
    for cohort, state in zip(resting, states, strict=True):
        cohort.batch.set_state(state)


def shapes_of(arrays: Mapping[str, np.ndarray]) -> Shapes:
    """Returns the dtype, as safetensors names it, and the shape of each array."""
    return {
        name: (DTYPES.get(array.dtype, array.dtype.str), array.shape)
        for name, array in arrays.items()
    }


def _check_few(plan: Plan, condition: Condition) -> None:
    """Estimates the memory of a cohort's agent from those of few robots, before it is allocated."""
    experiment = plan.experiment
    if not is_own(condition.proposer) or short_name(condition.proposer) == TRAINED_BEFORE:
        return  # it may need all its robots
    settings = settings_from(experiment.settings, several=True)
    if any(len(values) > 1 for values in settings.values()):  # a tuning, whose robots differ
        return
    few = [make_agent(experiment, condition, robots, 0) for robots in (1, 2)]
    parts = ([agent.state() for agent in few], [agent.weights() for agent in few])
    sizes = []
    for part in parts:
        one, two = (sum(array.nbytes for array in some.values()) for some in part)
        sizes.append(one + (experiment.cohort_size - 1) * (two - one))
    check_agent_memory(plan, condition, *sizes)


def check_agents(plan: Plan, held: Measured | None = None) -> None:
    """Makes a cohort of every user's agent in a plan and lets the agent act once.

    Args:
      plan: Plan with the robots that are missing.
      held: Robots to which they will be added.

    Raises:
      InputError: there is no such agent, it needs more memory than the machine has, does not
        return motor values, or keeps other weights than the robots that are there.
    """
    for condition in plan.conditions:
        if condition.has_brain:
            continue
        _check_few(plan, condition)
        cohort = Cohort(plan.experiment, CohortKey(condition, 0))
        cohort.agent.reset()
        state = cohort.batch.rules.state(cohort.batch.sensordata).astype(np.float32)
        cohort.agent.act(state, False)  # checks what it returns
        state, weights = cohort.checkpoint()[0], cohort.agent.weights()
        sizes = (sum(array.nbytes for array in some.values()) for some in (state, weights))
        check_agent_memory(plan, condition, *sizes)
        if held and condition in held:
            check_same_weights(condition, weights, held[condition].after)


def check_same_weights(
    who: Condition | CohortKey, own: Mapping[str, np.ndarray], kept: Mapping[str, np.ndarray]
) -> None:
    """Raises InputError where an agent's weights are not of the kind that earlier robots have.

    Args:
      who: Whose weights they are.
      own: Weights of the agent, by name, each of shape (B, ...).
      kept: Weights of robots that another version of the agent may have simulated.
    """
    kinds, known = (
        {(name, array.dtype, array.shape[1:]) for name, array in weights.items()}
        for weights in (own, kept)
    )
    if kinds != known:
        names = sorted({name for name, *_ in kinds ^ known})
        raise InputError(
            f"{who} keeps other weights than the robots of the run, which another version "
            f"simulated: {', '.join(names)}"
        )
