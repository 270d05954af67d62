"""The study that trains policies by PPO as a reference for the robots (docs/agents.md)."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from ...fields import whole
from ...tasks import CONTROL_TIMESTEP
from ...tasks.suite import TASKS
from ..agents.ppo import POLICIES_FILE, policy_shapes
from ..agents.signals import senses_of
from ..errors import InputError, check_name
from ..storage import save_arrays
from .jobs import ArrayJob, Arrays, Progress
from .study import Page, RunJobs, Study

# What differs from Stable-Baselines3's defaults: many short rollouts, since there are few steps.
# A discount of 0.95 is too small for the long search for the spot: two seeds of spot_finding_unit
# earned 0.32 and 0.67 a step with it, 0.83 and 0.76 with 0.98.
SETTINGS = {"n_steps": 256, "batch_size": 512, "learning_rate": 1e-3, "gamma": 0.98}
ROBOTS = 16  # in lockstep for one policy
_MOST_POLICIES = 10_000

_ROLLOUT = SETTINGS["n_steps"] * ROBOTS  # control steps


@dataclasses.dataclass
class PPOTraining(Study):
    """Trains policies by PPO, one random seed each; its fields are options of `benchmark ppo`."""

    name: ClassVar[str] = "ppo"
    folders: ClassVar[tuple[str, ...]] = ("policies",)

    task: str
    policies: int = whole(60, 1, _MOST_POLICIES)
    steps: int = whole(144_000, 1, 10**9)
    seed: int = whole(0, 0, 2**32 - _MOST_POLICIES)

    def identity(self) -> Mapping[str, Any]:
        """Returns all options but the number of policies, which may be increased later."""
        check_name("task", self.task, TASKS)
        if importlib.util.find_spec("stable_baselines3") is None:
            raise InputError("training needs Stable-Baselines3: pip install 'musebot[baselines]'")
        own = {"task": self.task, "steps": self.steps, "seed": self.seed}
        return own | {"settings": SETTINGS, "robots": ROBOTS}

    def work(self, out: Path, run_jobs: RunJobs) -> None:
        """Trains the policies, and joins them in one file.

        Raises:
          InputError: OUT holds more policies than `policies`; nothing was done.
        """
        held = len(list((out / "policies").glob("*.safetensors")))
        if held > self.policies:
            raise InputError(f"{out} holds {held} policies, more than {self.policies}")
        run_jobs(self._jobs(out))
        policies = [job.read() for job in self._jobs(out)]
        arrays = {name: np.concatenate([one[name] for one in policies]) for name in policies[0]}
        save_arrays(out / POLICIES_FILE, arrays, **self.identity())

    def page(self, out: Path) -> Page:
        del out
        last = self.seed + self.policies - 1
        return Page(
            f"`{POLICIES_FILE}` holds {self.policies} policies for the task `{self.task}`, trained "
            f"by PPO with the seeds {self.seed} to {last}, each for {rounded(self.steps):,} "
            f"control steps of {ROBOTS} robots together.\n"
        )

    def _jobs(self, out: Path) -> list[ArrayJob]:
        return [
            ArrayJob(
                out / "policies" / f"{number:04d}.safetensors",
                functools.partial(train, self.task, self.steps, self.seed + number),
                rounded(self.steps) * CONTROL_TIMESTEP,
                policy_shapes(len(senses_of(self.task).state), 1),
                {"task": self.task, "steps": self.steps, "seed": self.seed + number},
            )
            for number in range(self.policies)
        ]


def rounded(steps: int) -> int:
    """Returns a number of control steps, rounded up to whole rollouts."""
    return -(-steps // _ROLLOUT) * _ROLLOUT


def train(task: str, steps: int, seed: int, progress: Progress) -> Arrays:
    """Trains one policy on one core; its control steps are rounded up to whole rollouts.

    The seed is that of the policy, its exploration and its episodes.

    Returns:
      Weights in the form of `agents.ppo.Policies` with B = 1.

    Raises:
      StoppedError: the job is asked to stop.
    """
    from stable_baselines3 import PPO

    from ...tasks.stable_baselines import ArenaVecEnv

    torch.set_num_threads(1)
    model = PPO("MlpPolicy", ArenaVecEnv(task, ROBOTS), seed=seed, device="cpu", **SETTINGS)
    before = _weights(model.policy, "before")

    def report(*_: Any) -> bool:
        if model.num_timesteps % _ROLLOUT == ROBOTS:  # the first step of a rollout
            progress((model.num_timesteps - ROBOTS) * CONTROL_TIMESTEP)
        return True  # else the training would end

    model.learn(steps, callback=report)
    return before | _weights(model.policy, "after")


def _weights(policy: Any, when: str) -> Arrays:
    """Copies the layers that give the mean action as arrays (1, ...); `when` begins their names."""
    modules = itertools.chain(policy.mlp_extractor.policy_net, [policy.action_net])
    layers = [module for module in modules if isinstance(module, torch.nn.Linear)]
    weights = {}
    for number, layer in enumerate(layers):
        weights[f"{when}.{number}.weights"] = layer.weight.detach().numpy()[None].copy()
        weights[f"{when}.{number}.biases"] = layer.bias.detach().numpy()[None].copy()
    return weights
