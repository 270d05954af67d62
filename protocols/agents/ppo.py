"""Policies trained by PPO before a life, and the robots that these policies drive.

`musebot benchmark ppo` trains policies. Robots drive without Stable-Baselines3: weights are stored
as safetensors, and this module evaluates the small network.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import numpy as np
import torch

from ...controller.senses import Senses
from ...tasks.suite import TASKS
from ..errors import DamagedFileError, InputError, check_name
from ..examples import POLICIES
from ..storage import Shapes, digest, load_arrays
from .base import Agent
from .signals import senses_of

WIDTHS = 64, 64  # tanh neurons of the hidden layers; the output is the mean action

# Tasks on which the policies of `ppo` are trained; each drives robots with its task's signals.
TRAINED_ON = "wall_avoidance_unit", "spot_finding_unit", "spot_finding_walls"
FOLDER = Path("policies")
POLICIES_FILE = "policies.safetensors"


class Policies:
    """B policies for one task, each before and after training.

    Attributes:
      task: Name of the task on which the policies were trained.
      arrays: Weights and biases by name: "before" or "after" training, then the layer (0, 1, 2).
        With S signals and H neurons, "before.0.weights" has shape (B, H, S), "before.0.biases"
        (B, H).
    """

    def __init__(self, task: str, arrays: Mapping[str, np.ndarray]) -> None:
        self.task = task
        self.arrays = dict(arrays)
        self._limit = TASKS[task].limit
        self._tensors = {name: torch.from_numpy(array) for name, array in self.arrays.items()}

    @classmethod
    def load(cls, path: Path, task: str) -> Self:
        """Reads the policies for a task from a file that `musebot benchmark ppo` wrote.

        Raises:
          InputError: there is no such file, or it holds no policies for this task.
        """
        try:
            arrays, notes = load_arrays(path, _check_shapes)
        except FileNotFoundError as error:
            raise InputError(str(error)) from error
        trained_on = notes.get("task")
        if not isinstance(trained_on, str) or trained_on not in TASKS:
            raise DamagedFileError(f"{path} holds no policies")
        if trained_on != task:
            raise InputError(f"{path} holds policies for {trained_on}, not for {task}")
        signals, own = arrays["after.0.weights"].shape[2], len(senses_of(task).state)
        if signals != own:
            raise DamagedFileError(f"{path}: {task} has {own} signals, its policies {signals}")
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise DamagedFileError(f"{path}: {name} must be finite")
        return cls(task, arrays)

    @property
    def robots(self) -> int:
        """Number of policies, B."""
        return len(self.arrays["after.0.weights"])

    def some(self, robots: slice) -> Policies:
        """Returns the policies in a slice of the B policies."""
        return Policies(self.task, {name: array[robots] for name, array in self.arrays.items()})

    def one(self, robot: int) -> Policies:
        """Returns a single policy, as a batch of one.

        Raises:
          InputError: there is no policy with this number.
        """
        if not 0 <= robot < self.robots:
            raise InputError(f"the policies are 0 to {self.robots - 1}, got {robot}")
        return self.some(slice(robot, robot + 1))

    @torch.inference_mode()
    def act(self, state: np.ndarray, trained: bool = True) -> np.ndarray:
        """Returns the mean action of each robot's policy.

        Args:
          state: The S observed signals of each robot, float32, shape (B, S).
          trained: True for the policies after training, False for those before training.

        Returns:
          Left and right motor value in [-0.5, 0.5], shape (B, 2).
        """
        when = "after" if trained else "before"
        signal = torch.from_numpy(state)[..., None]
        for layer in range(len(WIDTHS) + 1):
            weights, biases = (self._tensors[f"{when}.{layer}.{x}"] for x in ("weights", "biases"))
            signal = torch.baddbmm(biases[..., None], weights, signal)
            if layer < len(WIDTHS):
                signal = signal.tanh_()
        limit = self._limit
        return (signal[..., 0].clamp_(-limit, limit) * (0.5 / limit)).numpy()


class PolicyAgent(Agent):
    """Robots with one policy each, trained before their lives.

    The untrained policies drive until the training phase of a life begins; from then on, the
    trained ones drive.
    """

    def __init__(self, policies: Policies) -> None:
        self._policies = policies
        self._digest = np.frombuffer(bytes.fromhex(digest(policies.arrays)), dtype=np.uint8)
        self._trained = np.zeros(1, dtype=np.uint8)

    def reset(self) -> None:
        """Does nothing: the policies have no memory."""

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        if learning:
            self._trained[:] = 1
        return self._policies.act(state, bool(self._trained[0]))

    def learn(self, reward: np.ndarray) -> None:
        """Learns nothing."""

    def state(self) -> dict[str, np.ndarray]:
        return {"trained": self._trained, "policies": self._digest}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        if not np.array_equal(arrays.get("policies", ()), self._digest):
            raise ValueError("the policies are not those with which the life began")
        if "trained" not in arrays or arrays["trained"].shape != (1,):
            raise ValueError("trained must have shape (1,)")
        self._trained[:] = arrays["trained"]

    def weights(self) -> dict[str, np.ndarray]:
        when = "after." if self._trained[0] else "before."
        arrays = self._policies.arrays
        return {k.removeprefix(when): v for k, v in arrays.items() if k.startswith(when)}

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        # The same weights before and after training.
        both = {f"{when}.{k}": v for when in ("before", "after") for k, v in arrays.items()}
        own, given = ({k: v.shape for k, v in one.items()} for one in (self._policies.arrays, both))
        for name in sorted({*own, *given}):
            if own.get(name) != given.get(name):
                raise ValueError(f"{name} must have shape {own.get(name)}, got {given.get(name)}")
        self._policies = Policies(self._policies.task, both)


def ppo(robots: int, senses: Senses, seed: int) -> Agent:
    """Makes robots driven by PPO, one policy each, from `policies/TASK/policies.safetensors`.

    Every cohort has the first B policies, so that several cohorts are not independent. Robots take
    the mean action, which is not random: the seed is unused.

    Raises:
      InputError: there is no such file, it has too few policies, or none is for these signals.
    """
    del seed
    task = next((one for one in TRAINED_ON if senses_of(one).state == senses.state), None)
    if task is None:
        tasks = ", ".join(TRAINED_ON)
        raise InputError(f"ppo has no policies for these signals, only for those of {tasks}")
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
    check_name("task", task, TASKS)
    if not (path := POLICIES / f"{task}.safetensors").exists():
        raise InputError(
            f"musebot brings no policy for {task}: `musebot benchmark ppo` trains some"
        )
    return path


def policy_shapes(signals: int, policies: int) -> Shapes:
    """Returns dtype and shape of each array of `policies` policies, named as in `Policies`."""
    shapes = {}
    layers = [*itertools.pairwise((signals, *WIDTHS, 2))]
    for when, (layer, sizes) in itertools.product(("before", "after"), enumerate(layers)):
        shapes[f"{when}.{layer}.weights"] = "F32", (policies, *sizes[::-1])
        shapes[f"{when}.{layer}.biases"] = "F32", (policies, sizes[1])
    return shapes


def _check_shapes(found: Shapes) -> None:
    """Raises ValueError unless the arrays are the layers of one or more policies."""
    _, shape = found.get("after.0.weights", ("", ()))
    if len(shape) != 3 or not shape[0] or found != policy_shapes(shape[2], shape[0]):
        raise ValueError("it holds no policies")
