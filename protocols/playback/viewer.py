"""A window on a task: dm_control's viewer; chance, a brain, a policy or the arrow keys drive."""

from __future__ import annotations

import dataclasses
import os
import sys
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import dm_env
import numpy as np

from ... import tasks
from ...tasks.sensors import NoseForm
from ...tasks.suite import TASKS
from ..errors import InputError
from .episode import Act, policy_act
from .stored_brains import Candidate

if TYPE_CHECKING:
    from ..agents.ppo import Policies

# GLFW's codes, as dm_control's viewer tells keys; importing them would look for a display.
UP, DOWN, LEFT, RIGHT = 265, 264, 263, 262
RELEASE = 0


@dataclasses.dataclass(frozen=True)
class Driver:
    """Who drives the robot in the window.

    Attributes:
      name: in words.
      policy: motors in [-0.5, 0.5], left and right, shape (2,), for a time step of the task.
      nose: the form of Eq. 3 that it smells with.
      task: that it has learnt, of the domain "arena"; None: it drives in any.
    """

    name: str
    policy: Callable[[dm_env.TimeStep], np.ndarray]
    nose: NoseForm = "inverse"
    task: str | None = None

    @classmethod
    def of_candidate(cls, candidate: Candidate) -> Driver:
        """A robot of a run; its noise is the same in every episode.

        Raises:
          InputError: there is no such robot, or its body is not the window's.
        """
        experiment = candidate.experiment
        if experiment.body != "mujoco" or experiment.motor_speed:
            raise InputError("the window has MuJoCo's robot at its own speed, and this run another")
        name = f"{candidate.proposer}, robot {candidate.robot}, {candidate.phase}-training"
        task = experiment.arena_task(candidate.task)
        return cls(name, Sensing(candidate.act), experiment.nose, task)

    @classmethod
    def of_policy(cls, policies: Policies, robot: int, phase: str) -> Driver:
        """A policy of PPO's.

        Raises:
          InputError: there is no such policy.
        """
        act = policy_act(policies, robot, phase)
        return cls(f"PPO, policy {robot}, {phase}-training", Sensing(lambda: act))


def explore(task: str, driver: Driver | None = None) -> None:
    """Opens a window on a task; robot and spot are placed at random, anew at each Backspace.

    Args:
      task: of the table of all tasks.
      driver: who drives; None for random motors.

    Raises:
      InputError: there is no such task, or no display.
    """
    if task not in TASKS:
        raise InputError(f"the task must be one of {', '.join(TASKS)}, got {task!r}")
    driver = driver or Driver("random motors", RandomMotors(seed=0))
    task = driver.task or task
    check_display()
    # As in the run: what a nose smells there, it smells here.
    kwargs = {"nose": driver.nose} if "nose" in TASKS[task].keywords else {}
    from dm_control.viewer import application

    print("Space starts and pauses, Backspace starts anew, F1 lists the other keys.")
    window = application.Application(title=f"Musebot: {task}, {driver.name}")
    if isinstance(driver.policy, ArrowKeys):
        print("The arrow keys drive, as long as they are held.")
        window._window.keyboard.on_key += driver.policy.on_key
    scale = TASKS[task].limit / 0.5  # actions of the task for a motor value
    window.launch(
        lambda: tasks.load("arena", task, task_kwargs=kwargs, visualize_reward=True),
        policy=lambda timestep: scale * driver.policy(timestep),
    )


def check_display() -> None:
    """Raises InputError where no window can be opened."""
    remedy = "`musebot film` needs no display"
    if sys.platform == "linux" and not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        raise InputError(f"there is no display to open a window on; {remedy}")
    backend = os.environ.get("MUJOCO_GL", "glfw")
    if backend.lower() in ("egl", "osmesa", "off", "disable", "disabled", "false", "0"):
        raise InputError(f"a window needs GLFW, but MUJOCO_GL is {backend!r}: unset it; {remedy}")
    try:
        import glfw

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # why it cannot is told below, in a sentence
            ready = glfw.init()
    except Exception as error:  # no library, or what it makes of a display that does not answer
        raise InputError(f"GLFW cannot open a window here ({error}); {remedy}") from error
    if not ready:
        raise InputError(f"GLFW cannot open a window on this display; {remedy}")


class RandomMotors:
    """A policy of motor values drawn uniformly, held for a second or so each."""

    def __init__(self, seed: int, steps: int = 10) -> None:
        """Prepares to draw motors from a seed, and to hold each for so many control steps."""
        self._random = np.random.default_rng(seed)
        self._steps = steps
        self._step = 0
        self._motors = np.zeros(2)

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Motors, left and right, shape (2,)."""
        if timestep.first() or self._step % self._steps == 0:
            self._step = 0
            self._motors = self._random.uniform(-0.5, 0.5, 2)
        self._step += 1
        return self._motors


class ArrowKeys:
    """A policy of the arrow keys: up and down drive, left and right turn, as long as held.

    Right is also the viewer's key for a single step, which it goes on to take when it is
    pressed: while the window is paused, one press is one step with the robot turning.
    """

    def __init__(self) -> None:
        """No key is held."""
        self._held: set[int] = set()

    def on_key(self, key: int, activity: int, modifiers: int) -> None:
        """Takes note of a key, as dm_control's viewer announces it, pressed or released."""
        del modifiers
        if activity == RELEASE:
            self._held.discard(key)
        else:
            self._held.add(key)

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Motors, left and right, shape (2,)."""
        del timestep
        up, down, left, right = (key in self._held for key in (UP, DOWN, LEFT, RIGHT))
        ahead, turn = 0.5 * (up - down), 0.25 * (right - left)
        return np.clip([ahead + turn, ahead - turn], -0.5, 0.5)


class Sensing:
    """A policy of what the robot senses."""

    def __init__(self, make: Callable[[], Act]) -> None:
        """Takes what makes the one who answers; it is made anew for each episode."""
        self._make = make
        self._act = make()

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Motors, left and right, shape (2,), for a task's observation."""
        if timestep.first():
            self._act = self._make()
        state = np.concatenate(list(timestep.observation.values())).astype(np.float32)
        return self._act(state[None])[0]
