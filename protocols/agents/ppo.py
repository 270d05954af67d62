"""Policies trained by PPO before a life, and robots that they drive.

`musebot benchmark ppo` trains policies; driving robots needs no Stable-Baselines3: the weights are
stored as safetensors, and the small network is evaluated here.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch

from ...controller.senses import Senses
from ...tasks.suite import TASKS
from ..errors import DamagedFileError, InputError
from ..examples import POLICIES
from ..storage import Shapes, digest, load_arrays
from .base import Agent

LAYERS = 3  # two hidden layers of 64 tanh neurons, and the mean action

# Tasks on which the policies of `ppo` are trained, by the number of sensor signals.
TRAINED_ON = {5: "wall_avoidance_unit", 1: "spot_finding_unit", 6: "spot_finding_walls"}
FOLDER = Path("policies")
POLICIES_FILE = "policies.safetensors"


class Policies:
    """B policies for one task, each before and after training.

    Attributes:
      task: Name of the task on which the policies were trained.
      arrays: Weights and biases by name: "before" or "after" training, then the layer (0, 1, 2).
        In layer 0 with H neurons, "before.0.weights" has shape (B, H, S), "before.0.biases" (B, H).
    """

    def __init__(self, task: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Takes weights as `read_policies` returns them."""
        self.task = task
        self.arrays = dict(arrays)
        self._limit = TASKS[task].limit
        self._tensors = {name: torch.from_numpy(array) for name, array in self.arrays.items()}

    @classmethod
    def load(cls, path: Path, task: str) -> Self:
        """Reads the policies that `musebot benchmark ppo` wrote.

        Raises:
          InputError: there is no such file, it holds no policies, or policies for another task.
        """
        trained_on, arrays, _ = read_policies(path)
        if trained_on != task:
            raise InputError(f"{path} holds policies for {trained_on}, not for {task}")
        return cls(task, arrays)

    @property
    def robots(self) -> int:
        """Number of policies, B."""
        return len(self.arrays["after.0.weights"])

    @property
    def digest(self) -> np.ndarray:
        """16 bytes that identify these policies."""
        return np.frombuffer(bytes.fromhex(digest(self.arrays)), dtype=np.uint8)

    def some(self, robots: slice) -> Policies:
        """Returns the policies of some robots."""
        return Policies(self.task, {name: array[robots] for name, array in self.arrays.items()})

    def one(self, robot: int) -> Policies:
        """Returns a single policy, as a batch of one.

        Raises:
          InputError: there is no policy of that number.
        """
        if not 0 <= robot < self.robots:
            raise InputError(f"the policies are 0 to {self.robots - 1}, got {robot}")
        return self.some(slice(robot, robot + 1))

    @torch.inference_mode()
    def act(self, state: np.ndarray, trained: bool = True) -> np.ndarray:
        """Returns the mean action of each robot's policy.

        Args:
          state: Observations, float32, shape (B, S).
          trained: Whether to use the policies after training; otherwise those before training.

        Returns:
          Left and right motor value in [-0.5, 0.5], shape (B, 2).
        """
        when = "after" if trained else "before"
        signal = torch.from_numpy(state)[..., None]
        for layer in range(LAYERS):
            weights, biases = (
                self._tensors[f"{when}.{layer}.{what}"] for what in ("weights", "biases")
            )
            signal = torch.baddbmm(biases[..., None], weights, signal)
            if layer < LAYERS - 1:
                signal = signal.tanh_()
        limit = self._limit
        return (signal[..., 0].clamp_(-limit, limit) * (0.5 / limit)).numpy()


class PolicyAgent(Agent):
    """Robots with one policy each, trained before their lives.

    The untrained policies drive until the training phase of a life begins; from then on, the
    trained ones drive.
    """

    def __init__(self, policies: Policies) -> None:
        """Takes one policy for each robot."""
        self._policies = policies
        self._trained = np.zeros(1, dtype=np.uint8)

    def reset(self) -> None:
        """See `Agent.reset`; a policy has no memory."""

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`; never explores."""
        if learning:
            self._trained[:] = 1
        return self._policies.act(state, bool(self._trained[0]))

    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`; learns nothing."""

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`."""
        return {"trained": self._trained, "policies": self._policies.digest}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""
        if not np.array_equal(arrays.get("policies", ()), self._policies.digest):
            raise ValueError("the policies are not those with which the life began")
        if "trained" not in arrays or arrays["trained"].shape != (1,):
            raise ValueError("trained must have shape (1,)")
        self._trained[:] = arrays["trained"]

    def weights(self) -> dict[str, np.ndarray]:
        """See `Agent.weights`."""
        when = "after." if self._trained[0] else "before."
        arrays = self._policies.arrays
        return {k.removeprefix(when): v for k, v in arrays.items() if k.startswith(when)}

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_weights`; a policy that is untrained and trained alike."""
        both = {f"{when}.{k}": v for when in ("before", "after") for k, v in arrays.items()}
        if both.keys() != self._policies.arrays.keys():
            raise ValueError(f"the weights must be those of a policy, got {sorted(arrays)}")
        for name, own in self._policies.arrays.items():
            if both[name].shape != own.shape:
                raise ValueError(f"{name} must have shape {own.shape}, got {both[name].shape}")
        self._policies = Policies(self._policies.task, both)


def ppo(robots: int, senses: Senses, seed: int) -> Agent:
    """Makes robots driven by PPO, one policy each, from `policies/TASK/policies.safetensors`.

    Every cohort has the first B policies, so that several cohorts are not independent.

    Args:
      robots: Number of robots, B.
      senses: What the robots sense: 5, 1 or 6 signals.
      seed: Seed; unused, since the mean action is not random.

    Raises:
      InputError: there is no such file, or it has too few policies.
    """
    del seed
    sensors = len(senses.state)
    if sensors not in TRAINED_ON:
        raise InputError(f"PPO was trained for {sorted(TRAINED_ON)} signals, got {sensors}")
    task = TRAINED_ON[sensors]
    path = FOLDER / task / POLICIES_FILE
    if not path.exists():
        raise InputError(
            f"there is no file {path}: `musebot benchmark ppo {path.parent} --task {task} "
            f"--policies {robots}` trains the policies"
        )
    policies = Policies.load(path, task)
    if policies.robots < robots:
        raise InputError(f"{path} has {policies.robots} policies, too few for {robots} robots")
    return PolicyAgent(policies.some(slice(robots)))


def policy_file(task: str) -> Path:
    """Returns the file of the policy that comes with musebot for a task.

    Raises:
      InputError: there is no such task, or no policy for it.
    """
    if task not in TASKS:
        raise InputError(f"the task must be one of {', '.join(TASKS)}, got {task!r}")
    if not (path := POLICIES / f"{task}.safetensors").exists():
        raise InputError(
            f"musebot brings no policy for {task}: `musebot benchmark ppo` trains some"
        )
    return path


def policy_arrays() -> list[str]:
    """Returns the names of a policy's arrays, such as "before.0.weights"."""
    layers = itertools.product(("before", "after"), range(LAYERS), ("weights", "biases"))
    return [f"{when}.{layer}.{what}" for when, layer, what in layers]


def policy_shapes(task: str, policies: int, widths: Sequence[int] = (64, 64)) -> Shapes:
    """Returns the dtype and shape of each array of some policies for a task.

    Args:
      task: Name of the task.
      policies: Number of policies.
      widths: Numbers of neurons of the hidden layers.
    """
    signals = sum(length for length, _, _ in TASKS[task].rules.shapes.values())
    sizes = (signals, *widths, 2)
    shapes = {}
    for name in policy_arrays():
        _, layer, what = name.split(".")
        inputs, neurons = sizes[int(layer) :][:2]
        shape = (neurons, inputs) if what == "weights" else (neurons,)
        shapes[name] = ("F32", (policies, *shape))
    return shapes


def read_policies(path: Path) -> tuple[str, dict[str, np.ndarray], dict[str, Any]]:
    """Reads a file of policies.

    Returns:
      The task, the weights, named as in `policy_arrays`, and the notes on how they were trained.

    Raises:
      InputError: there is no such file, or it holds no policies.
    """
    try:
        arrays, notes = load_arrays(path, _check_names)
    except FileNotFoundError as error:
        raise InputError(str(error)) from error
    task = notes.pop("task", None)
    if not isinstance(task, str) or task not in TASKS:
        raise DamagedFileError(f"{path} holds no policies")
    policies, *_ = arrays["after.0.biases"].shape
    widths = [arrays[f"after.{layer}.biases"].shape[1] for layer in range(LAYERS - 1)]
    for name, (_, shape) in policy_shapes(task, policies, widths).items():
        if arrays[name].shape != shape:
            got = arrays[name].shape
            raise DamagedFileError(f"{path}: {name} must have shape {shape} for {task}, got {got}")
        if not np.isfinite(arrays[name]).all():
            raise DamagedFileError(f"{path}: {name} must be finite")
    return task, arrays, notes


def _check_names(shapes: Shapes) -> None:
    """Raises ValueError where arrays cannot be the layers of at least one policy."""
    if sorted(shapes) != sorted(policy_arrays()) or {kind for kind, _ in shapes.values()} != {
        "F32"
    }:
        raise ValueError("it holds no policies")
    biases = [shape for name, (_, shape) in shapes.items() if name.endswith("biases")]
    if any(len(shape) != 2 for shape in biases) or 0 in shapes["after.0.biases"][1]:
        raise ValueError("it holds no policies")
