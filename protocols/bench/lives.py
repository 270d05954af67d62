"""Times cohorts in training, paired with bare physics: `mujoco.rollout` alone.

A worker process imports no more than a process of `musebot run`, so that its memory is comparable.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from statistics import median

import mujoco
import numpy as np
from mujoco import rollout

from ...controller import BRAINS
from ...tasks import Batch
from ..agents.base import Agent
from ..errors import RunError
from ..lives.cohort import Cohort
from ..lives.conditions import CohortKey, Condition
from ..lives.experiment import Experiment
from ..lives.placement import legs

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value


@dataclasses.dataclass(frozen=True)
class Setting:
    """Cohort to measure, and length of a block.

    Attributes:
      task: "wall_avoidance" or "spot_finding".
      proposer: "fixed", "random" or "creative".
      robots: Number of robots in the cohort.
      steps: Number of control steps in a block.
      brain: Name of the robots' brain.
    """

    task: str
    proposer: str
    robots: int
    steps: int
    brain: str = "paper"

    @property
    def robot_steps(self) -> int:
        """Number of robot-steps in a block: robots times control steps."""
        return self.robots * self.steps

    @property
    def experiment(self) -> Experiment:
        """Experiment that the cohort belongs to."""
        return Experiment(brain=BRAINS[self.brain], cohort_size=self.robots)


def new_cohort(setting: Setting) -> Cohort:
    """Returns a cohort before its first control step."""
    return Cohort(setting.experiment, CohortKey(Condition(setting.task, setting.proposer), 0))


def begin_training(cohort: Cohort, task: str) -> None:
    """Skips the tests before training, and simulates the first step, which places the robots."""
    schedule = Experiment().schedule(task)
    cohort.step = next(leg.start for leg in legs(schedule) if leg.phase.learning)
    cohort.advance(1)


class RecordingBatch(Batch):
    """A batch that times its physics and records its motor commands.

    Attributes:
      motors: Motor commands of every control step, each of shape (B, 2).
      physics_seconds: Time in [s] spent in MuJoCo.
    """

    def __init__(self, batch: Batch) -> None:
        """Creates robots with the model and rules of `batch`, all at the origin."""
        self.motors: list[np.ndarray] = []
        self.physics_seconds = 0.0
        super().__init__(batch.model, batch.rules, batch.robots)

    def step(self, motors: np.ndarray) -> None:
        """See `Robots.step`."""
        self.motors.append(motors.copy())
        super().step(motors)

    def simulate(self) -> np.ndarray:
        """See `Batch.simulate`."""
        began = time.perf_counter()
        measured = super().simulate()
        self.physics_seconds += time.perf_counter() - began
        return measured


class TimedAgent(Agent):
    """An agent that forwards every call to another agent, and times acting and learning.

    Attributes:
      seconds: Time in [s] spent in `act` and `learn`.
    """

    def __init__(self, agent: Agent) -> None:
        """Wraps `agent`."""
        self._agent = agent
        self.seconds = 0.0

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`."""
        began = time.perf_counter()
        motors = self._agent.act(state, learning)
        self.seconds += time.perf_counter() - began
        return motors

    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`."""
        began = time.perf_counter()
        self._agent.learn(reward)
        self.seconds += time.perf_counter() - began

    def reset(self) -> None:
        """See `Agent.reset`."""
        self._agent.reset()

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`."""
        return self._agent.state()

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""
        self._agent.load_state(arrays)

    def weights(self) -> dict[str, np.ndarray]:
        """See `Agent.weights`."""
        return self._agent.weights()


class BareRollout:
    """`mujoco.rollout` and nothing else: one call per control step, with all sensors.

    Any program that chooses new motor commands in every control step must do at least this.
    Argument checks are off. Inputs and outputs are allocated before the clock starts.

    Attributes:
      state: MuJoCo's physics state of every robot, n numbers each, shape (B, n).
    """

    def __init__(self, model: mujoco.MjModel, robots: int, substeps: int, threads: int = 0) -> None:
        """Creates robots.

        Args:
          model: Compiled arena.
          robots: Number of robots, B.
          substeps: Number of physics steps in a control step.
          threads: Number of threads; 0 uses the calling thread.
        """
        self._substeps = substeps
        self._models = [model] * robots
        self._scratch = [mujoco.MjData(model) for _ in range(max(threads, 1))]
        self._engine = rollout.Rollout(nthread=threads)
        self.state = np.zeros((robots, mujoco.mj_stateSize(model, _STATE)))
        self._states = np.zeros((robots, substeps, self.state.shape[1]))
        self._sensors = np.zeros((robots, substeps, model.nsensordata))

    def drive(self, start: np.ndarray, motors: np.ndarray) -> float:
        """Simulates the robots with the given motor commands.

        Args:
          start: Initial states, shape (B, n).
          motors: Motor commands of T control steps, shape (T, B, 2).

        Returns:
          Duration of the simulation in [s].
        """
        controls = np.repeat(motors[:, :, None], self._substeps, axis=2)
        self.state[:] = start
        began = time.perf_counter()
        for control in controls:
            self._engine.rollout(
                self._models,
                self._scratch,
                self.state,
                control,
                nstep=self._substeps,
                state=self._states,
                sensordata=self._sensors,
                skip_checks=True,
            )
            self.state[:] = self._states[:, -1]
        return time.perf_counter() - began


class TimedCohort:
    """A cohort in training, and `mujoco.rollout` alone, which repeats the last block's physics.

    Training is measured because it is the most expensive part of a life: robots also learn.

    Attributes:
      setting: Cohort to measure, and length of a block.
      agent: Agent that drives the robots; it also records the time of acting and learning.
      batch: Robots of the cohort; it also records their motor commands, and the time in MuJoCo.
      bare: Robots with which `mujoco.rollout` alone repeats the last block.
    """

    def __init__(self, setting: Setting) -> None:
        """Creates the cohort and places its robots at the start of training."""
        self.setting = setting
        self._cohort = new_cohort(setting)
        assert isinstance(self._cohort.batch, Batch)  # MuJoCo, not the kinematic simulator
        # Timing and recording cost a few microseconds a control step of the whole cohort. They
        # count as time of the cohort.
        self.batch = self._cohort.batch = RecordingBatch(self._cohort.batch)
        self.agent = self._cohort.agent = TimedAgent(self._cohort.agent)
        begin_training(self._cohort, setting.task)
        self._start = self.state.copy()
        self.bare = BareRollout(self.batch.model, setting.robots, self.batch.substeps)

    @property
    def state(self) -> np.ndarray:
        """State of every robot, shape (B, n)."""
        return self.batch.arrays()["state"]

    @property
    def brain_seconds(self) -> float:
        """Time in [s] that the last block spent in acting and learning."""
        return self.agent.seconds

    @property
    def physics_seconds(self) -> float:
        """Time in [s] that the last block spent in MuJoCo."""
        return self.batch.physics_seconds

    def simulate(self) -> float:
        """Simulates a block; returns its duration in [s]."""
        self.batch.motors.clear()
        self._start[:] = self.state
        self.agent.seconds = self.batch.physics_seconds = 0.0
        began = time.perf_counter()
        self._cohort.advance(self.setting.steps)
        return time.perf_counter() - began

    def replay(self) -> float:
        """Repeats the last block by `mujoco.rollout` alone; returns the duration in [s].

        Raises:
          RunError: The final states differ from the cohort's, so the work was not equal.
        """
        seconds = self.bare.drive(self._start, np.array(self.batch.motors, dtype=float))
        if not np.array_equal(self.bare.state, self.state):
            raise RunError(
                f"the bare replay of {self.setting} did not end in the states of the cohort; "
                "a robot was unstable or was placed again"
            )
        return seconds


@dataclasses.dataclass(frozen=True)
class PairedTiming:
    """Durations of a cohort's blocks, and of their physics repeated by `mujoco.rollout` alone.

    Blocks and repetitions alternate in one process.

    Attributes:
      setting: Cohort to measure, and length of a block.
      life: Duration of each simulated block in [s].
      brain: Time in [s] that each block spent in acting and learning.
      physics: Time in [s] that each block spent in MuJoCo. A cohort evaluates the sensors in the
        last substep of a control step only; `mujoco.rollout` evaluates them in all substeps.
      bare: Duration in [s] of each block's physics when repeated by `mujoco.rollout` alone.
    """

    setting: Setting
    life: tuple[float, ...]
    brain: tuple[float, ...]
    physics: tuple[float, ...]
    bare: tuple[float, ...]

    @property
    def ratios(self) -> list[float]:
        """Ratio of the cohort's throughput to that of bare physics, for each block."""
        return [bare / life for life, bare in zip(self.life, self.bare, strict=True)]

    @property
    def ratio(self) -> float:
        """Median of the blocks' ratios."""
        return median(self.ratios)

    @property
    def microseconds(self) -> dict[str, float]:
        """Median time of a robot-step in [us]: total, physics, brain, rest and bare."""
        per_step = 1e6 / self.setting.robot_steps
        rest = [a - b - c for a, b, c in zip(self.life, self.brain, self.physics, strict=True)]
        return {
            "total": median(self.life) * per_step,
            "physics": median(self.physics) * per_step,
            "brain": median(self.brain) * per_step,
            "rest": median(rest) * per_step,
            "bare": median(self.bare) * per_step,
        }


def time_pairs(setting: Setting, blocks: int) -> PairedTiming:
    """Simulates and replays `blocks` blocks in alternation, after one block to warm up."""
    cohort = TimedCohort(setting)
    cohort.simulate()
    cohort.replay()
    rows = [
        (cohort.simulate(), cohort.brain_seconds, cohort.physics_seconds, cohort.replay())
        for _ in range(blocks)
    ]
    life, brain, physics, bare = zip(*rows, strict=True)
    return PairedTiming(setting, life, brain, physics, bare)


@dataclasses.dataclass(frozen=True)
class BrainCost:
    """Time that acting and learning take in the blocks of a cohort.

    Attributes:
      setting: Cohort to measure, and length of a block.
      life: Duration of each block in [s].
      brain: Time in [s] that each block spent in acting and learning.
    """

    setting: Setting
    life: tuple[float, ...]
    brain: tuple[float, ...]

    @property
    def microseconds(self) -> float:
        """Median time of acting and learning per robot-step in [us]."""
        return 1e6 * median(self.brain) / self.setting.robot_steps

    @property
    def share(self) -> float:
        """Median share of a block's duration spent in acting and learning."""
        return median(brain / life for brain, life in zip(self.brain, self.life, strict=True))

    def ratio(self, other: BrainCost) -> float:
        """Returns the median, over blocks, of this brain's time divided by the other brain's."""
        return median(a / b for a, b in zip(self.brain, other.brain, strict=True))


def brain_costs(cohorts: Sequence[TimedCohort], blocks: int) -> dict[str, BrainCost]:
    """Simulates blocks of several cohorts in alternation, after one block each to warm up.

    Args:
      cohorts: Cohorts with different brains.
      blocks: Number of timed blocks of each cohort.

    Returns:
      Costs by the name of the brain.
    """
    for cohort in cohorts:
        cohort.simulate()
    rows = [[(c.simulate(), c.brain_seconds) for c in cohorts] for _ in range(blocks)]
    return {
        cohort.setting.brain: BrainCost(cohort.setting, *zip(*own, strict=True))
        for cohort, own in zip(cohorts, zip(*rows, strict=True), strict=True)
    }
