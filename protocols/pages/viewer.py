"""Shows a task in dm_control's viewer, driven by random motors, a brain, a policy or arrow keys."""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import dm_env
import numpy as np

from ... import tasks
from ...models.rendering import DRAWS_NOTHING, no_window
from ...tasks.sensors import NoseForm
from ...tasks.suite import TASKS
from ...tasks.world import World
from ..agents.names import short_name
from ..errors import InputError, check_name
from ..runs.experiment import Experiment
from .replay import Act, StoredRobot, policy_act

if TYPE_CHECKING:
    from ..agents.policy import Policy

# GLFW's codes of keys; importing dm_control's own names would look for a display.
UP, DOWN, LEFT, RIGHT = 265, 264, 263, 262
RELEASE = 0

DmPolicy = Callable[[dm_env.TimeStep], np.ndarray]
"""Returns left and right motor value in [-0.5, 0.5], shape (2,), for a time step of a task."""


@dataclasses.dataclass(frozen=True)
class Driver:
    """Driver of the robot in the window."""

    name: str
    policy: DmPolicy
    nose: NoseForm = "inverse"  # form of Eq. 3 by which the robot's nose computes the smell
    task: str | None = None  # task that the driver has learned; None for any task

    @classmethod
    def of_robot(cls, robot: StoredRobot) -> Driver:
        """Returns a robot of a run as a driver; its noise is the same in every episode.

        Raises:
          InputError: there is no such robot, or its body or arena is not that in the window.
        """
        experiment, condition = robot.run.experiment, robot.condition
        for name in ("body", "motor_speed", "nose_place"):
            if (value := getattr(experiment, name)) != getattr(Experiment(), name):
                raise InputError(
                    f"the window shows a robot with the default {name}, got a run with {value}"
                )
        if experiment.life_of(condition.life).worlds != (World(),):
            raise InputError(f"the window shows no world that changes, as in {condition.life}")
        name = f"{short_name(condition.proposer)}, robot {robot.robot}, {robot.phase}-training"
        return cls(
            name, sensing(robot.act), experiment.nose, experiment.life_of(condition.life).task
        )

    @classmethod
    def of_policy(cls, policy: Policy, phase: str) -> Driver:
        """Returns a policy trained by PPO as a driver; see `replay.policy_act`."""
        act = policy_act(policy, phase)
        return cls(f"PPO, {phase}-training", sensing(lambda: act))


def explore(task: str, driver: Driver | None = None) -> None:
    """Opens a window on a task of the domain "arena"; without a driver, motors are random.

    The key Backspace restarts the episode, with random places of robot and spot.

    Raises:
      InputError: there is no such task, or no display.
    """
    driver = driver or Driver("random motors", random_motors(seed=0))
    task = driver.task or task
    check_name("task", task, TASKS)
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


def random_motors(seed: int, steps: int = 10) -> DmPolicy:
    """Returns a policy that draws uniform motor values and holds each for `steps` control steps."""
    random = np.random.default_rng(seed)
    drawn = (random.uniform(-0.5, 0.5, 2) for _ in itertools.count())
    held = itertools.chain.from_iterable(itertools.repeat(motors, steps) for motors in drawn)
    return lambda timestep: next(held)


class ArrowKeys:
    """A policy by arrow keys: while they are held, up and down drive, left and right turn.

    In a paused window, the right arrow is the viewer's key for a single control step.
    """

    def __init__(self) -> None:
        self._held: set[int] = set()

    def on_key(self, key: int, activity: int, modifiers: int) -> None:
        """Records that a key was pressed or released; dm_control's viewer calls it."""
        if activity == RELEASE:
            self._held.discard(key)
        else:
            self._held.add(key)

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Returns left and right motor value, shape (2,)."""
        up, down, left, right = (key in self._held for key in (UP, DOWN, LEFT, RIGHT))
        ahead, turn = 0.5 * (up - down), 0.25 * (right - left)
        return np.clip([ahead + turn, ahead - turn], -0.5, 0.5)


def sensing(make: Callable[[], Act]) -> DmPolicy:
    """Returns a policy that acts by a function, which `make` makes anew for each episode."""
    act = make()  # raises InputError before a window opens

    def policy(timestep: dm_env.TimeStep) -> np.ndarray:
        nonlocal act
        act = make() if timestep.first() else act
        state = np.concatenate(list(timestep.observation.values())).astype(np.float32)
        return act(state[None])[0]

    return policy
