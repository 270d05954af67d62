"""Policies that Stable-Baselines3's PPO learns on any task, and robots driven by them.

    python -m musebot.protocols.ppo POLICIES.safetensors --task spot_finding_unit --policies 60

Training needs the extra `baselines`, everything else does not: the weights are kept as
safetensors, and so small a network is quickly evaluated.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import itertools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
import torch
import tyro

from ...tasks.suite import TASKS
from ..errors import DamagedFileError, InputError, exit_status
from ..options import cores
from ..simulation import pool
from ..storage import check_place, digest, load_arrays, save_arrays
from ..terminal import bar
from .base import Agent

# What differs from Stable-Baselines3's defaults: many short rollouts, for there are few steps.
# A discount of 0.95 does not reach from the search to the spot: two seeds of spot_finding_unit
# earned 0.32 and 0.67 a step with it, 0.83 and 0.76 with this one.
SETTINGS = {"n_steps": 256, "batch_size": 512, "learning_rate": 1e-3, "gamma": 0.98}
ROBOTS = 16  # that live episodes in lockstep for one policy
LAYERS = 3  # two hidden ones of 64 tanh neurons, and the mean action

# The tasks in whose units the policies of `ppo` are trained, by the signals that they sense.
TRAINED_ON = {5: "wall_avoidance_unit", 1: "spot_finding_unit"}
FOLDER = Path("policies")


class Policies:
    """B policies for one task, each as it was born and as it was when trained.

    Attributes:
      task: on which they were trained, of the table of all tasks.
      arrays: "before.*" and "after.*": `0.weights` (B, H, S), `0.biases` (B, H), and likewise
        of the layers 1 and 2.
    """

    def __init__(self, task: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Takes weights as `load` reads them."""
        self.task = task
        self.arrays = dict(arrays)
        self._limit = TASKS[task].limit
        self._tensors = {name: torch.from_numpy(array) for name, array in self.arrays.items()}

    @classmethod
    def load(cls, path: Path, task: str) -> Self:
        """Reads what this module's command wrote.

        Raises:
          InputError: there is no such file, or it holds no policies, or none for this task.
        """
        trained_on, arrays, _ = _read(path)
        if trained_on != task:
            raise InputError(f"{path} holds policies for {trained_on}, not for {task}")
        return cls(task, arrays)

    @property
    def robots(self) -> int:
        """How many policies there are, B."""
        return len(self.arrays["after.0.weights"])

    @property
    def digest(self) -> np.ndarray:
        """Tells these policies from others, 16 bytes."""
        return np.frombuffer(bytes.fromhex(digest(self.arrays)), dtype=np.uint8)

    def some(self, robots: slice) -> Policies:
        """Some of the policies."""
        return Policies(self.task, {name: array[robots] for name, array in self.arrays.items()})

    def one(self, robot: int) -> Policies:
        """A single policy, as a batch of one.

        Raises:
          InputError: there is no such policy.
        """
        if not 0 <= robot < self.robots:
            raise InputError(f"the policies are 0 to {self.robots - 1}, got {robot}")
        return self.some(slice(robot, robot + 1))

    @torch.inference_mode()
    def act(self, state: np.ndarray, trained: bool = True) -> np.ndarray:
        """The mean action of each robot's policy.

        Args:
          state: what the robots sense, float32, shape (B, S).
          trained: whether the policies act as trained, or as they were born.

        Returns:
          Motor values in [-0.5, 0.5], left and right, shape (B, 2).
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


class Trained(Agent):
    """Robots with a policy each that was trained before their life, not in it.

    Until their training begins they act as the policies were born; from then on as trained.
    """

    def __init__(self, policies: Policies) -> None:
        """Gives the robots their policies."""
        self._policies = policies
        self._trained = np.zeros(1, dtype=np.uint8)

    def reset(self) -> None:
        """See `Agent.reset`: there is nothing to forget."""

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`: nobody explores."""
        if learning:
            self._trained[:] = 1
        return self._policies.act(state, bool(self._trained[0]))

    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`: all is learnt."""

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`."""
        return {"trained": self._trained, "policies": self._policies.digest}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""
        if not np.array_equal(arrays.get("policies", ()), self._policies.digest):
            raise ValueError("the policies are not those that the life began with")
        if "trained" not in arrays or arrays["trained"].shape != (1,):
            raise ValueError("trained must have shape (1,)")
        self._trained[:] = arrays["trained"]

    def weights(self) -> dict[str, np.ndarray]:
        """See `Agent.weights`."""
        when = "after." if self._trained[0] else "before."
        arrays = self._policies.arrays
        return {k.removeprefix(when): v for k, v in arrays.items() if k.startswith(when)}


def ppo(robots: int, sensors: int, seed: int) -> Agent:
    """Robots driven by PPO, a policy each, from `policies/TASK.safetensors` in this folder.

    Every cohort has the first B policies, so that only one cohort makes independent lives.

    Raises:
      InputError: there is no such file, or it has too few policies.
    """
    del seed  # a mean action is not left to chance
    if sensors not in TRAINED_ON:
        raise InputError(f"PPO was trained for {sorted(TRAINED_ON)} signals, got {sensors}")
    task = TRAINED_ON[sensors]
    path = FOLDER / f"{task}.safetensors"
    if not path.exists():
        raise InputError(
            f"there is no file {path}: `python -m {__name__} {path} --task {task} --policies "
            f"{robots} --steps N` trains them"
        )
    policies = Policies.load(path, task)
    if policies.robots < robots:
        raise InputError(f"{path} has {policies.robots} policies, too few for {robots} robots")
    return Trained(policies.some(slice(robots)))


@dataclasses.dataclass
class Train:
    """Train policies by PPO, a random seed each; a file that has some goes on."""

    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """the policies, a .safetensors"""
    task: str
    """of all tasks, see docs/tasks.md; best those with actions in [-1, 1]"""
    policies: int = 60
    """how many, with seeds of their own"""
    steps: int = 144_000
    """for each policy, of its 16 robots together, rounded up to 4,096 (default: as many as spot
    finding's training has)"""
    seed: int = 0
    """of the first policy; the next has one more"""
    processes: int = cores()
    """policies in training at a time, one core each"""

    def __call__(self) -> None:
        """Trains, and keeps each policy as soon as it is known.

        Raises:
          InputError: something makes no sense, or the file holds something else.
          ImportError: Stable-Baselines3 is not installed.
          Interrupted, RunError: some policies are not trained yet.
        """
        for name in ("policies", "steps", "processes"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        most = 2**32 - self.policies
        if not 0 <= self.seed <= most:
            raise InputError(f"the seed must lie in [0, {most}], got {self.seed}")
        if self.task not in TASKS:
            raise InputError(f"the task must be one of {', '.join(TASKS)}, got {self.task!r}")
        if self.path.parent.exists():
            check_place(self.path)
        if importlib.util.find_spec("stable_baselines3") is None:
            raise ImportError("training needs Stable-Baselines3: pip install 'musebot[baselines]'")
        notes = {"steps": self.steps, "seed": self.seed, "settings": SETTINGS, "robots": ROBOTS}
        arrays: dict[str, np.ndarray] = {}
        if self.path.exists():
            task, arrays, older = _read(self.path)
            if (task, older) != (self.task, notes):
                raise InputError(f"{self.path} holds policies that were trained otherwise")
        known = len(arrays["after.0.weights"]) if arrays else 0
        seeds = range(self.seed + known, self.seed + self.policies)
        jobs = [(self.task, self.steps, seed) for seed in seeds]
        pooled = pool.results(train, jobs, self.processes)
        with bar() as progress, contextlib.closing(pooled) as trained:
            done = progress.add_task(self.path.name, total=self.policies, completed=known)
            for policy in trained:
                arrays = {
                    name: np.concatenate([arrays.get(name, array[:0]), array])
                    for name, array in policy.items()
                }
                save_arrays(self.path, arrays, task=self.task, **notes)
                progress.advance(done)
        print(self.path)


def train(task: str, steps: int, seed: int) -> dict[str, np.ndarray]:
    """Trains one policy, on one core.

    Args:
      task: of the table of all tasks.
      steps: of a robot, all robots together; rounded up to whole rollouts.
      seed: of everything.

    Returns:
      What `Policies` holds, B = 1.
    """
    from stable_baselines3 import PPO

    from ...tasks.stable_baselines import ArenaVecEnv

    torch.set_num_threads(1)
    model = PPO("MlpPolicy", ArenaVecEnv(task, ROBOTS), seed=seed, device="cpu", **SETTINGS)
    before = _weights(model.policy, "before")
    model.learn(steps)
    return before | _weights(model.policy, "after")


def _weights(policy: Any, when: str) -> dict[str, np.ndarray]:
    """The weights on the way from a state to the mean action, copied, with a leading axis."""
    modules = itertools.chain(policy.mlp_extractor.policy_net, [policy.action_net])
    layers = [module for module in modules if isinstance(module, torch.nn.Linear)]
    weights = {}
    for number, layer in enumerate(layers):
        weights[f"{when}.{number}.weights"] = layer.weight.detach().numpy()[None].copy()
        weights[f"{when}.{number}.biases"] = layer.bias.detach().numpy()[None].copy()
    return weights


def _read(path: Path) -> tuple[str, dict[str, np.ndarray], dict[str, Any]]:
    """The task, the weights, and how they were trained."""
    try:
        arrays, notes = load_arrays(path)
    except FileNotFoundError as error:
        raise InputError(str(error)) from error
    expected = [
        f"{when}.{layer}.{what}"
        for when in ("before", "after")
        for layer in range(LAYERS)
        for what in ("weights", "biases")
    ]
    task = notes.pop("task", None)
    if task not in TASKS or sorted(arrays) != sorted(expected):
        raise DamagedFileError(f"{path} holds no policies")
    return task, arrays, notes


if __name__ == "__main__":
    program = "python -m musebot.protocols.ppo"
    sys.exit(exit_status(tyro.cli(Train, prog=program, description=Train.__doc__)))
