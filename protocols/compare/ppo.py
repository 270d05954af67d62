"""Trains a policy by PPO on any task, as a reference for robots that learn during a life."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch

from ...fields import whole
from ...tasks import CONTROL_TIMESTEP
from ...tasks.suite import TASKS
from ..errors import InputError, check_name
from .jobs import ArrayJob, Arrays, Progress
from .study import Page, RunJobs, Study

# What differs from Stable-Baselines3's defaults: many short rollouts, since there are few steps.
# A discount of 0.95 is too small for the long search for the spot: two seeds of spot_finding_unit
# earned 0.32 and 0.67 a step with it, 0.83 and 0.76 with 0.98.
SETTINGS = {"n_steps": 256, "batch_size": 512, "learning_rate": 1e-3, "gamma": 0.98}
ROBOTS = 16  # in lockstep
POLICY_FILE = "policy.safetensors"

_ROLLOUT = SETTINGS["n_steps"] * ROBOTS  # control steps


@dataclasses.dataclass
class PPOTraining(Study):
    """Trains a policy by PPO; its fields are options of `musebot benchmark ppo`."""

    name: ClassVar[str] = "ppo"

    task: str
    steps: int = whole(327_680, 1, 10**9)
    seed: int = whole(0, 0, 2**32 - 1)

    def identity(self) -> Mapping[str, Any]:
        """Returns all options, and the settings of the training."""
        check_name("task", self.task, TASKS)
        if importlib.util.find_spec("stable_baselines3") is None:
            raise InputError("training needs Stable-Baselines3: pip install 'musebot[baselines]'")
        return dataclasses.asdict(self) | {"settings": SETTINGS, "robots": ROBOTS}

    def work(self, out: Path, run_jobs: RunJobs) -> None:
        run_jobs([self._job(out)])

    def page(self, out: Path) -> Page:
        self._job(out).read()
        return Page(
            f"`{POLICY_FILE}` holds a policy for the task `{self.task}`, trained by PPO with the "
            f"seed {self.seed} for {rounded(self.steps):,} control steps of {ROBOTS} robots "
            "together.\n"
        )

    def _job(self, out: Path) -> ArrayJob:
        return ArrayJob(
            out / POLICY_FILE,
            functools.partial(train, self.task, self.steps, self.seed),
            rounded(self.steps) * CONTROL_TIMESTEP,
            self.identity(),
        )


def rounded(steps: int) -> int:
    """Returns a number of control steps, rounded up to whole rollouts."""
    return -(-steps // _ROLLOUT) * _ROLLOUT


def train(task: str, steps: int, seed: int, progress: Progress) -> Arrays:
    """Trains a policy on one core; its control steps are rounded up to whole rollouts.

    The seed is that of the policy, its exploration and its episodes.

    Returns:
      Weights in the form of `agents.policy.Policy`.

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
    """Copies the layers that give the mean action; `when` begins their names."""
    modules = itertools.chain(policy.mlp_extractor.policy_net, [policy.action_net])
    layers = [module for module in modules if isinstance(module, torch.nn.Linear)]
    weights = {}
    for number, layer in enumerate(layers):
        weights[f"{when}.{number}.weights"] = layer.weight.detach().numpy().copy()
        weights[f"{when}.{number}.biases"] = layer.bias.detach().numpy().copy()
    return weights
