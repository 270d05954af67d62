"""A cohort: robots in lockstep, each alone in its arena, from the start to the end of a life."""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...controller.neurocontroller import Neurocontroller
from ...controller.parameters import PROPOSERS
from ...tasks.batch import Robots
from ...tasks.kinematic import KinematicBatch
from ...tasks.lives import STAGES, Leg, Phase, control_steps, place
from ..agents.base import Agent, sound
from ..agents.checked_agent import CheckedAgent
from ..agents.factory import factory_of
from ..agents.names import LOWER, OWN_BOUNDS, RECORDED_NAMES, is_own, short_name
from ..agents.neurocontroller import NeurocontrollerAgent
from ..agents.settings import checked_settings, settings_from
from ..agents.signals import RawSignals, raw_senses, senses_of
from ..errors import InputError
from .conditions import CohortKey, Condition
from .device import (
    add_events,
    captured_steps,
    decide,
    device_of,
    on_host,
    robots_on_device,
    zero_counts,
)
from .experiment import Experiment
from .run import Lives

_MINUTE = control_steps(1)


def random_streams(seed: int, key: CohortKey) -> tuple[int, np.random.Generator]:
    """Derives a cohort's random streams.

    They depend only on the seed, the condition's name and the cohort's number. Robots that are
    added later, and the number of processes, do not change them.

    Returns:
      The seed of the cohort's brains, and the generator that draws its placements.
    """
    name = zlib.crc32(str(key.condition).encode())
    brains, world = np.random.SeedSequence(seed, spawn_key=(name, key.index)).spawn(2)
    return int(brains.generate_state(1, np.uint64)[0] >> 1), np.random.default_rng(world)


def make_agent(experiment: Experiment, condition: Condition, robots: int, seed: int) -> Agent:
    """Makes an untrained agent that drives `robots` robots; `seed` starts its random stream.

    Raises:
      InputError: the agent's factory is not trusted, is not found, fails to import, lacks one of
        the settings, or returns no agent.
      RunError: the factory, or the import of its module, exits.
    """
    senses = senses_of(experiment.life_of(condition.life).task)
    proposer = condition.proposer
    if proposer in PROPOSERS:
        make_brain = Neurocontroller
        if experiment.backend == "numba" and experiment.brain.compilable:
            from ...controller.compiled import CompiledNeurocontroller  # needs Numba

            make_brain = CompiledNeurocontroller
        controller = make_brain(experiment.brain, proposer, robots, senses, seed)
        return NeurocontrollerAgent(controller, experiment.learn_across_placement)
    if experiment.nose == "printed" and proposer in OWN_BOUNDS:
        if any(signal.maximal for signal in senses.state):
            name = short_name(proposer)
            raise InputError(f"{name} uses the maximal smell: it needs the nose 'inverse'")
    factory = factory_of(proposer)
    words = settings_from(experiment.settings, several=True)
    settings = checked_settings(short_name(proposer), factory, words, robots) if words else {}

    # The newborn brain computes the raw signals itself.
    raw = experiment.signals == "raw" and proposer != RECORDED_NAMES[LOWER]
    sensed = raw_senses(senses) if raw else senses
    make = functools.partial(factory, robots, sensed, seed, **settings)
    agent = make() if is_own(proposer) else CheckedAgent(proposer, make, robots)
    return RawSignals(senses, agent) if raw else agent


def compiled_life(agent: Agent, batch: Robots) -> Callable[[int, bool, Any], bool] | None:
    """Returns a function that simulates control steps of a compiled brain in one loop, or None.

    The function takes the number of steps, whether robots learn, and the robots' counts of events,
    shape (B,), to which it adds. In a world that the loop cannot compute, it returns False and
    simulates nothing. None is returned if this agent or this simulator has no such loop.
    """
    # A subclass of the agent may act otherwise. A compiled brain shows that Numba is installed.
    if type(agent) is not NeurocontrollerAgent or type(agent.controller) is Neurocontroller:
        return None
    if type(batch) is not KinematicBatch:
        return None
    from .compiled_life import simulate

    return functools.partial(simulate, agent.controller, batch)


class Cohort:
    """B robots with the same life, simulated in lockstep.

    Attributes:
      experiment: Seed, cohort size, body, brain and other fields that decide the lives.
      key: Condition and number of the cohort.
      batch: The B robots in their arenas, on the experiment's device.
      agent: Agent that drives all B robots.
      step: Number of control steps simulated so far.
      steps: Number of control steps of the whole life.
    """

    def __init__(self, experiment: Experiment, key: CohortKey) -> None:
        """Makes robots at the start of their lives.

        Args:
          experiment: Seed, cohort size, body, brain and other fields that decide the lives.
          key: Condition and number of the cohort.
        """
        robots, task = experiment.cohort_size, key.condition.life
        self.experiment, self.key = experiment, key
        seed, self._random = random_streams(experiment.seed, key)
        self.batch = robots_on_device(experiment, task)
        if experiment.backend == "numba" and isinstance(self.batch, KinematicBatch):
            self.batch.compile()
        with device_of(experiment):
            self.agent = make_agent(experiment, key.condition, robots, seed)
        self._counts = zero_counts(self.batch)  # events since the last `store`
        # A step is simulated in one of three ways: directly; by kernels that a GPU has captured;
        # or, with all steps to the next placement, in a loop that Numba has compiled.
        self._captured = captured_steps(self.agent, self.batch, self._counts)
        self._compiled = compiled_life(self.agent, self.batch)
        self._recorded: list[np.ndarray] | None = None
        self._before = {k: v.copy() for k, v in self.agent.weights().items()}
        self._legs = experiment.life_of(task).legs()
        self.step, self._entered = 0, -1  # steps so far; step of the last placement
        self.steps = self._legs[-1].stop
        self._events = np.zeros((robots, len(STAGES)), dtype=np.int32)
        self._minutes = np.zeros((robots, -(-self.steps // _MINUTE)), dtype=np.int16)
        self._stopped = np.zeros(robots, dtype=bool)
        self.batch.stop(np.flatnonzero(self.unsound()))

    @property
    def finished(self) -> bool:
        """Whether the life is over."""
        return self.step == self.steps

    @property
    def valid(self) -> np.ndarray:
        """Whether each robot's simulation is stable so far, shape (B,)."""
        return on_host(self.batch.valid)

    @property
    def leg(self) -> Leg:
        """The stretch between two placements to which the next control step belongs."""
        return next(leg for leg in self._legs if self.step < leg.stop)

    def advance(self, steps: int) -> None:
        """Simulates the given number of control steps, or fewer if the life ends earlier."""
        until = min(self.step + steps, self.steps)
        while (now := self.step) < until:
            self.enter()
            leg, minute = self.leg, now - now % _MINUTE + _MINUTE
            self._simulate(min(leg.stop, until, minute) - now, leg.phase.learning)
            self.store(leg.phase)

    def enter(self) -> None:
        """Places robots and spots if the next step begins a `leg`; a second call does nothing."""
        leg = self.leg
        if self.step != leg.start or self._entered == leg.start:
            return
        place(self.batch, leg.phase, self._random)
        if leg.phase.robot is not None or not leg.start:
            self.agent.reset()
        self._entered = self.step

    def recorded(self) -> list[np.ndarray]:
        """Returns a list to which every later step adds the motor values, shape (B, 2).

        From now on, steps are simulated without the compiled loop. The robots must not be on
        tensors.
        """
        self._compiled, self._recorded = None, []
        return self._recorded

    def decide(self, learning: bool) -> Any:
        """Lets the agent decide, and learn if `learning`; returns motor values, shape (B, 2).

        For brains on a GPU, the next call overwrites the returned values.
        """
        if self._captured is not None:
            return self._captured.decide(learning)
        motors = decide(self.agent, self.batch, learning)
        if self._recorded is not None:
            self._recorded.append(motors.copy())
        return motors

    def _count_events(self) -> None:
        if self._captured is not None:
            self._captured.count()
        else:
            add_events(self.batch, self._counts)

    def _simulate(self, steps: int, learning: bool) -> None:
        """Simulates control steps of one leg and one minute, and counts their events.

        The steps are those of the compiled loop where it can compute them.
        """
        if self._compiled is not None and self._compiled(steps, learning, self._counts):
            self.step += steps
            return
        for _ in range(steps):
            self.batch.step(self.decide(learning))
            self._count_events()
            self.step += 1

    def store(self, phase: Phase) -> None:
        """Adds the counts, all from one phase and one minute, to the totals, and resets them to 0.

        When a minute or the life ends, robots with a NaN or infinite weight are stopped.
        """
        counts = on_host(self._counts)
        self._events[:, STAGES.index(phase.stage)] += counts
        self._minutes[:, (self.step - 1) // _MINUTE] += counts
        self._counts[:] = 0
        if self.step % _MINUTE == 0 or self.finished:
            self.batch.stop(np.flatnonzero(self.unsound()))

    def unsound(self) -> np.ndarray:
        """Returns which robots have a NaN or infinite weight."""
        return ~sound(self.agent.weights(), self.batch.robots)

    def newly_stopped(self) -> dict[str, list[int]]:
        """Returns the indices of the robots that were stopped since the last call, by cause."""
        new = ~self.valid & ~self._stopped
        self._stopped |= new
        unsound = self.unsound() if new.any() else new
        # An action that is not finite stops a robot before its weights are checked.
        causes = {
            "unstable simulation": new & ~unsound,
            "weights that are not finite": new & unsound,
        }
        return {cause: np.flatnonzero(own).tolist() for cause, own in causes.items() if own.any()}

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

    def restore(self, arrays: Mapping[str, np.ndarray], notes: Mapping[str, Any]) -> None:
        """Continues from the arrays and the notes of a checkpoint.

        Raises:
          ArithmeticError, AttributeError, KeyError, TypeError, ValueError: an array or a note is
            missing or invalid.
        """
        groups: dict[str, dict[str, Any]] = {"before": {}, "brain": {}, "batch": {}}
        for name, array in arrays.items():
            group, _, rest = name.partition(".")
            if rest:
                groups[group][rest] = array
        self._random.bit_generator.state = notes["random"]
        self.batch.set_state(groups["batch"])
        self._stopped[:] = ~self.valid  # reported before the checkpoint
        try:
            self.agent.load_state(groups["brain"])
        except MemoryError:
            raise  # the checkpoint is not damaged
        except Exception as error:  # an agent may raise anything for another agent's state
            raise ValueError(f"its agent does not continue ({error!r})") from error
        for name, weights in self._before.items():
            weights[:] = groups["before"][name]
        self._events[:] = arrays["events"]
        self._minutes[:] = arrays["minutes"]
        self.step = notes["step"]
        if not self.finished:
            self.batch.enter(self.leg.phase.world)
