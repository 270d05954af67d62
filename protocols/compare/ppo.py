"""The study that trains policies by PPO as a reference for the robots (docs/agents.md)."""

from __future__ import annotations

import dataclasses
import importlib.util
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
import tyro

from ...tasks import CONTROL_TIMESTEP
from ...tasks.suite import TASKS
from ..agents.ppo import POLICIES_FILE, policy_arrays, read_policies
from ..errors import DamagedFileError, InputError
from ..lives.experiment import Experiment
from ..lives.jobs import Job, Report, Stop
from ..storage import save_arrays
from .jobs import FileJob, StoppedError
from .study import Page, Study, check_positive

# What differs from Stable-Baselines3's defaults: many short rollouts, since there are few steps.
# A discount of 0.95 does not reach from the search to the spot: two seeds of spot_finding_unit
# earned 0.32 and 0.67 a step with it, 0.83 and 0.76 with this one.
SETTINGS = {"n_steps": 256, "batch_size": 512, "learning_rate": 1e-3, "gamma": 0.98}
ROBOTS = 16  # in lockstep for one policy
_MOST_POLICIES, _MOST_STEPS = 10_000, 10**9

_ROLLOUT = SETTINGS["n_steps"] * ROBOTS  # control steps


@dataclasses.dataclass
class PPOTraining(Study):
    """Train policies by PPO on any task, one random seed each.

    Writes OUT/policies.safetensors. Its policies can drive robots, in films and in the viewer.
    Needs Stable-Baselines3.
    """

    name: ClassVar[str] = "ppo"

    task: Annotated[str, tyro.conf.arg(metavar="TASK")]
    """any task of docs/tasks.md, preferably one with actions in [-1, 1]"""
    policies: int = 60
    """number of policies; more can be added later"""
    steps: int = 144_000
    """control steps of each policy's 16 robots together, rounded up to a multiple of 4,096"""
    seed: int = 0
    """seed of the first policy; each further policy has the next one"""

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`: there are none."""
        check_positive(_MOST_POLICIES, policies=self.policies)
        check_positive(_MOST_STEPS, steps=self.steps)
        most = 2**32 - self.policies
        if not 0 <= self.seed <= most:
            raise InputError(f"the seed must lie in [0, {most}], got {self.seed}")
        if self.task not in TASKS:
            raise InputError(f"the task must be one of {', '.join(TASKS)}, got {self.task!r}")
        if importlib.util.find_spec("stable_baselines3") is None:
            raise InputError("training needs Stable-Baselines3: pip install 'musebot[baselines]'")
        return {}

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`; the number of policies may be increased later."""
        return {"task": self.task, **self._notes()}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / "policies"]

    def check(self, out: Path) -> None:
        """See `Study.check`."""
        held = len([*(out / "policies").glob("*.safetensors")])
        if held > self.policies:
            raise InputError(f"{out} holds {held} policies, more than {self.policies}")
        for job in self._jobs(out):
            if job.done():
                job.policy()

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`; joins the policies in one file when all are trained."""
        yield self._jobs(out)
        policies = [job.policy() for job in self._jobs(out)]
        arrays = {
            name: np.concatenate([policy[name] for policy in policies]) for name in policy_arrays()
        }
        save_arrays(out / POLICIES_FILE, arrays, task=self.task, **self._notes())

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        read_policies(out / POLICIES_FILE)
        last = self.seed + self.policies - 1
        return Page(
            f"`{POLICIES_FILE}` holds {self.policies} policies for the task `{self.task}`, trained "
            f"by PPO with the seeds {self.seed} to {last}, each for {rounded(self.steps):,} "
            f"control steps of {ROBOTS} robots together.\n"
        )

    def _jobs(self, out: Path) -> list[TrainingJob]:
        return [
            TrainingJob(
                out / "policies" / f"{number:04d}.safetensors",
                self.task,
                self.steps,
                self.seed + number,
            )
            for number in range(self.policies)
        ]

    def _notes(self) -> dict[str, Any]:
        return {"steps": self.steps, "seed": self.seed, "settings": SETTINGS, "robots": ROBOTS}


@dataclasses.dataclass(frozen=True)
class TrainingJob(FileJob):
    """Trains one policy.

    Attributes:
      path: File to which the trained policy is written.
      task: Name of any task.
      steps: Number of control steps, summed over all robots and rounded up to whole rollouts.
      seed: Seed of the policy, its exploration and its episodes.
    """

    path: Path
    task: str
    steps: int
    seed: int

    def __str__(self) -> str:
        return f"policy {self.path.stem}"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return rounded(self.steps) * CONTROL_TIMESTEP

    @property
    def identity(self) -> dict[str, Any]:
        """See `FileJob.identity`."""
        return {"task": self.task, "steps": self.steps, "seed": self.seed}

    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """See `FileJob.work`."""
        policy = train(self.task, self.steps, self.seed, stop, report)
        report(self.cost, "")
        return policy

    def policy(self) -> dict[str, np.ndarray]:
        """Reads the trained policy.

        Raises:
          InputError: there is no such file, it is damaged, or it is another job's.
        """
        task, arrays, notes = read_policies(self.path)
        held = {"task": task, **notes}
        if held != self.identity or len(arrays["after.0.weights"]) != 1:
            raise DamagedFileError(f"{self.path} is of {held}, not of {self.identity}")
        return arrays


def rounded(steps: int) -> int:
    """Returns a number of control steps, rounded up to whole rollouts."""
    return -(-steps // _ROLLOUT) * _ROLLOUT


def train(
    task: str,
    steps: int,
    seed: int,
    stop: Stop = lambda: False,
    report: Report = lambda cost, message: None,
) -> dict[str, np.ndarray]:
    """Trains one policy on one core.

    Args:
      task: Name of any task.
      steps: Number of control steps, summed over all robots and rounded up to whole rollouts.
      seed: Seed of the policy, its exploration and its episodes.
      stop: Function that returns whether to stop; called once per rollout.
      report: Function called once per rollout with the simulated robot-seconds so far and a
        message.

    Returns:
      Weights in the form of `agents.ppo.Policies` with B = 1.

    Raises:
      StoppedError: `stop` returned True.
    """
    from stable_baselines3 import PPO

    from ...tasks.stable_baselines import ArenaVecEnv

    torch.set_num_threads(1)
    model = PPO("MlpPolicy", ArenaVecEnv(task, ROBOTS), seed=seed, device="cpu", **SETTINGS)
    before = _weights(model.policy, "before")
    stopped = False

    def goes_on(*_: Any) -> bool:
        nonlocal stopped
        if model.num_timesteps % _ROLLOUT == ROBOTS:  # the first step of a rollout
            stopped = stop()
            report((model.num_timesteps - ROBOTS) * CONTROL_TIMESTEP, "")
        return not stopped

    model.learn(steps, callback=goes_on)
    if stopped:
        raise StoppedError
    return before | _weights(model.policy, "after")


def _weights(policy: Any, when: str) -> dict[str, np.ndarray]:
    """Copies the weights of the layers from the state to the mean action, with a leading axis."""
    modules = itertools.chain(policy.mlp_extractor.policy_net, [policy.action_net])
    layers = [module for module in modules if isinstance(module, torch.nn.Linear)]
    weights = {}
    for number, layer in enumerate(layers):
        weights[f"{when}.{number}.weights"] = layer.weight.detach().numpy()[None].copy()
        weights[f"{when}.{number}.biases"] = layer.bias.detach().numpy()[None].copy()
    return weights
