"""Policies that PPO trained, without Stable-Baselines3: they drive robots in films and windows.

`musebot benchmark ppo` trains a policy. Its weights are stored as safetensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Self

import numpy as np

from ...tasks.suite import TASKS
from ..errors import DamagedFileError, InputError, check_name
from ..examples import POLICIES
from ..storage import load_arrays
from .signals import senses_of

WIDTHS = 64, 64  # tanh neurons of the hidden layers; the output is the mean action


class Policy:
    """A policy for one task, before and after training.

    Attributes:
      task: Name of the task on which the policy was trained.
      arrays: Weights and biases by name: "before" or "after" training, then the layer (0, 1, 2).
        With S signals and H neurons, "before.0.weights" has shape (H, S), "before.0.biases" (H,).
    """

    def __init__(self, task: str, arrays: Mapping[str, np.ndarray]) -> None:
        self.task = task
        self.arrays = dict(arrays)

    @classmethod
    def load(cls, path: Path, task: str) -> Self:
        """Reads the policy for a task from a file that `musebot benchmark ppo` wrote.

        Raises:
          InputError: there is no such file, or it holds no policy for this task.
        """
        try:
            arrays, notes = load_arrays(path)
        except FileNotFoundError as error:
            raise InputError(str(error)) from error
        trained_on = notes.get("task")
        if not isinstance(trained_on, str) or trained_on not in TASKS:
            raise DamagedFileError(f"{path} holds no policy")
        if trained_on != task:
            raise InputError(f"{path} holds a policy for {trained_on}, not for {task}")
        shapes = {name: array.shape for name, array in arrays.items()}
        if shapes != policy_shapes(len(senses_of(task).state)):
            raise DamagedFileError(f"{path} holds no policy for the signals of {task}")
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise DamagedFileError(f"{path}: {name} must be finite")
        return cls(task, arrays)

    def act(self, state: np.ndarray, trained: bool = True) -> np.ndarray:
        """Returns the policy's mean action for each robot.

        Args:
          state: The S observed signals of each robot, float32, shape (B, S).
          trained: True for the policy after training, False for that before training.

        Returns:
          Left and right motor value in [-0.5, 0.5], shape (B, 2).
        """
        when = "after" if trained else "before"
        signal = state
        for layer in range(len(WIDTHS) + 1):
            weights, biases = (self.arrays[f"{when}.{layer}.{x}"] for x in ("weights", "biases"))
            signal = signal @ weights.T + biases
            if layer < len(WIDTHS):
                signal = np.tanh(signal)
        limit = TASKS[self.task].limit
        return signal.clip(-limit, limit) * (0.5 / limit)


def policy_file(task: str) -> Path:
    """Returns the file of the policy that comes with musebot for a task.

    Raises:
      InputError: there is no such task, or no policy for it.
    """
    check_name("task", task, TASKS)
    if not (path := POLICIES / f"{task}.safetensors").exists():
        raise InputError(f"musebot brings no policy for {task}: `musebot benchmark ppo` trains one")
    return path


def policy_shapes(signals: int) -> dict[str, tuple[int, ...]]:
    """Returns the shape of each array of a policy, named as in `Policy`."""
    widths = signals, *WIDTHS, 2
    shapes: dict[str, tuple[int, ...]] = {}
    for when in ("before", "after"):
        for layer in range(len(widths) - 1):
            shapes[f"{when}.{layer}.weights"] = widths[layer + 1], widths[layer]
            shapes[f"{when}.{layer}.biases"] = (widths[layer + 1],)
    return shapes
