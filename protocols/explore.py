"""A window on a task: dm_control's viewer, driven by chance or by a robot's stored brain."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable

import dm_env
import numpy as np

from .. import tasks
from ..controller import PROPOSERS
from .agents import Brain
from .errors import InputError
from .experiment import check_condition
from .replay import Candidate


def explore(task: str, candidate: Candidate | None = None) -> None:
    """Opens a window on a task; robot and spot are placed at random, anew at each Backspace.

    Args:
      task: "wall_avoidance" or "spot_finding".
      candidate: a robot that learnt this task, whose brain drives; None for random motors.

    Raises:
      InputError: there is no such task, no such robot, or no display.
    """
    check_condition(task, candidate.proposer if candidate else PROPOSERS[0])
    if candidate is None:
        title = f"Musebot: {task}, random motors"
        policy = RandomMotors(seed=0)
    else:
        who = f"{candidate.proposer}, robot {candidate.robot}, {candidate.phase}-training"
        title = f"Musebot: {task}, {who}"
        policy = StoredBrain(candidate.brain)
        if candidate.experiment.body != "mujoco" or candidate.experiment.motor_speed:
            raise InputError("the window has MuJoCo's robot at its own speed, and this run another")
    check_display()
    # As in the run: what a nose smells there, it smells here.
    kwargs = {}
    if candidate and task == "spot_finding":
        kwargs["nose"] = candidate.experiment.nose
    from dm_control import viewer

    print("Space starts and pauses, Backspace starts anew, F1 lists the other keys.")
    viewer.launch(
        lambda: tasks.load("arena", task, task_kwargs=kwargs, visualize_reward=True),
        policy=policy,
        title=title,
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


class StoredBrain:
    """A policy that is a robot's brain, neither learning nor exploring."""

    def __init__(self, make: Callable[[], Brain]) -> None:
        """Takes what makes the brain, a batch of one; it is made anew for each episode."""
        self._make = make
        self._brain = make()

    def __call__(self, timestep: dm_env.TimeStep) -> np.ndarray:
        """Motors, left and right, shape (2,), for a task's observation."""
        if timestep.first():
            self._brain = self._make()
        state = np.concatenate(list(timestep.observation.values())).astype(np.float32)
        return self._brain.act(state[None], learning=False)[0]
