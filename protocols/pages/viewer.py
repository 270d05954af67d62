"""Shows a task in dm_control's viewer, driven by random motors, a brain, a policy or arrow keys."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import dm_env
import numpy as np

from ... import tasks
from ...models.rendering import DRAWS_NOTHING, no_window
from ...tasks.sensors import NoseForm
from ...tasks.suite import TASKS
from ..agents.names import short_name
from ..errors import InputError
from .episode import Act, policy_act
from .stored_brains import StoredRobot

if TYPE_CHECKING:
    from ..agents.ppo import Policies

# GLFW's codes of keys; importing dm_control's own names would look for a display.
UP, DOWN, LEFT, RIGHT = 265, 264, 263, 262
RELEASE = 0


@dataclasses.dataclass(frozen=True)
class Driver:
    """Driver of the robot in the window.

    Attributes:
      name: Description of the driver.
      policy: Function that maps a time step of the task to motor values in [-0.5, 0.5], left motor
        first, shape (2,).
      nose: Form of Eq. 3 by which the robot's nose computes the smell.
      task: Task of the domain "arena" that the driver has learned; None if it can drive in any.
    """

    name: str
    policy: Callable[[dm_env.TimeStep], np.ndarray]
    nose: NoseForm = "inverse"
    task: str | None = None

    @classmethod
    def of_robot(cls, robot: StoredRobot) -> Driver:
        """Returns a robot of a run as a driver; its noise is the same in every episode.

        Raises:
          InputError: there is no such robot, or its body or arena is not that in the window.
        """
        experiment, condition = robot.run.experiment, robot.condition
        if experiment.body != "mujoco":
            raise InputError(f"the window shows the body mujoco, got a run of {experiment.body}")
        if experiment.motor_speed:
            speed = experiment.motor_speed
            raise InputError(f"the window shows the robot's own motor speed, got {speed:g} m/s")
        if experiment.arena_scale != 1:
            scale = experiment.arena_scale
            raise InputError(
                f"the window shows the ordinary arena, got one {scale:g} times as large"
            )
        if experiment.nose_place != "front":
            raise InputError(
                f"the window shows the nose at the front, got one at the {experiment.nose_place}"
            )
        name = f"{short_name(condition.proposer)}, robot {robot.robot}, {robot.phase}-training"
        task = experiment.arena_task(condition.task)
        return cls(name, Sensing(robot.act), experiment.nose, task)

    @classmethod
    def of_policy(cls, policies: Policies, robot: int, phase: str) -> Driver:
        """Returns a policy trained by PPO as a driver.

        Raises:
          InputError: there is no such policy.
        """
        act = policy_act(policies, robot, phase)
        return cls(f"PPO, policy {robot}, {phase}-training", Sensing(lambda: act))


def explore(task: str, driver: Driver | None = None) -> None:
    """Opens a window on a task; Backspace starts again with random places of robot and spot.

    Args:
      task: Name of a task of the domain "arena".
      driver: Driver of the robot; None for random motors.

    Raises:
      InputError: there is no such task, or no display.
    """
    if task not in TASKS:
        raise InputError(f"the task must be one of {', '.join(TASKS)}, got {task!r}")
    driver = driver or Driver("random motors", RandomMotors(seed=0))
    task = driver.task or task
    check_display()
    # The nose must have the same form as in the run.
    kwargs = {"nose": driver.nose} if "nose" in TASKS[task].keywords else {}
    from dm_control.viewer import application

    print("Space starts and pauses, Backspace restarts, F1 lists the other keys.")
    window = application.Application(title=f"Musebot: {task}, {driver.name}")
    if isinstance(driver.policy, ArrowKeys):
        print("The arrow keys drive while they are held.")
        window._window.keyboard.on_key += driver.policy.on_key
    scale = TASKS[task].limit / 0.5  # the task's action per motor value
    window.launch(
        lambda: tasks.load("arena", task, task_kwargs=kwargs, visualize_reward=True),
        policy=lambda timestep: scale * driver.policy(timestep),
    )


def check_display() -> None:
    """Raises InputError if no window can be opened."""
    remedy = "`musebot film` needs no display"
    if reason := no_window():
        raise InputError(f"{reason}; {remedy}")
    backend = os.environ.get("MUJOCO_GL", "glfw")
    if backend.lower() in ("egl", "osmesa", *DRAWS_NOTHING):
        raise InputError(f"a window needs GLFW, but MUJOCO_GL is {backend!r}: unset it; {remedy}")


class RandomMotors:
    """A policy that draws uniform motor values and holds them for some control steps."""

    def __init__(self, seed: int, steps: int = 10) -> None:
        """Creates the random stream.

        Args:
          seed: Seed of the random stream.
          steps: Number of control steps for which each draw of motor values is held.
        """
        self._random = np.random.default_rng(seed)
        self._steps = steps
        self._step = 0
        self._motors = np.zeros(2)

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Returns left and right motor value, shape (2,)."""
        if timestep.first() or self._step % self._steps == 0:
            self._step = 0
            self._motors = self._random.uniform(-0.5, 0.5, 2)
        self._step += 1
        return self._motors


class ArrowKeys:
    """A policy by arrow keys: while they are held, up and down drive, left and right turn.

    The right arrow is also the viewer's key for a single step. In a paused window it therefore
    simulates one step, in which the robot turns.
    """

    def __init__(self) -> None:
        """Starts with no key held."""
        self._held: set[int] = set()

    def on_key(self, key: int, activity: int, modifiers: int) -> None:
        """Records that a key was pressed or released; dm_control's viewer calls it."""
        del modifiers
        if activity == RELEASE:
            self._held.discard(key)
        else:
            self._held.add(key)

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Returns left and right motor value, shape (2,)."""
        del timestep
        up, down, left, right = (key in self._held for key in (UP, DOWN, LEFT, RIGHT))
        ahead, turn = 0.5 * (up - down), 0.25 * (right - left)
        return np.clip([ahead + turn, ahead - turn], -0.5, 0.5)


class Sensing:
    """A policy that acts on the robot's sensor signals."""

    def __init__(self, make: Callable[[], Act]) -> None:
        """Stores `make`, which is called at the start of each episode and returns the driver."""
        self._make = make
        self._act = make()

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Returns left and right motor value, shape (2,), for a task's observation."""
        if timestep.first():
            self._act = self._make()
        state = np.concatenate(list(timestep.observation.values())).astype(np.float32)
        return self._act(state[None])[0]
