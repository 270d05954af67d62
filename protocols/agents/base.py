"""Who drives the robots: the paper's neurocontroller, or any agent of a user's.

An agent is named as `package.module:factory`; the factory is called with the number of
robots, the numbers in a state and a seed, and returns an `Agent`. docs/agents.md has an
example.
"""

from __future__ import annotations

import abc
import importlib
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from ...controller import PROPOSERS, Neurocontroller, Senses, Signal
from ...tasks.suite import task_definition
from ..errors import InputError
from ..experiment.experiment import Experiment, check_agent

# Modules that kept runs name otherwise: a run's random streams depend on the recorded name.
_MOVED = {
    "musebot.protocols.baselines": "musebot.protocols.agents.q_learning",
    "musebot.protocols.ppo": "musebot.protocols.agents.ppo",
}


class Agent(abc.ABC):
    """What drives B robots through their lives, one life each, all in lockstep.

    In every control step the experiment calls `act` with what the robots sense and then,
    while they learn, `learn` with the reward that came along with it: the reward for the
    action before. Before the first step, and whenever all robots are placed anew, it calls
    `reset`.
    """

    @abc.abstractmethod
    def reset(self) -> None:
        """Takes note that the robots were placed anew: no action led to what comes next."""

    @abc.abstractmethod
    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """Chooses the robots' motors.

        Args:
          state: what they sense, float32, shape (B, S).
          learning: False in the tests, where nobody explores.

        Returns:
          Left and right in [-0.5, 0.5], shape (B, 2).
        """

    @abc.abstractmethod
    def learn(self, reward: np.ndarray) -> None:
        """Learns from a step; called in training only.

        Args:
          reward: sensed along with the state last given to `act`, so the reward of the action
            before (after a `reset`: of none), float32, shape (B,).
        """

    @abc.abstractmethod
    def state(self) -> dict[str, np.ndarray]:
        """Everything that its next steps depend on, random streams too, for a checkpoint.

        Arrays of numbers, which may be the agent's own: they are written before the next step.
        """

    @abc.abstractmethod
    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Goes on from a `state`, to the bit.

        Raises:
          ValueError: an array is missing, or its shape is another.
        """

    def weights(self) -> dict[str, np.ndarray]:
        """What it has learnt, for brains.safetensors: arrays of shape (B, ...), one row a robot.

        A robot with a weight that is not finite is stopped, and its life counted as invalid.
        """
        return {}


class Brain(Agent):
    """The neurocontroller as an agent.

    Attributes:
      controller: the brains.
    """

    def __init__(self, controller: Neurocontroller, learn_across_placement: bool = False) -> None:
        """Wraps a controller of B robots.

        Args:
          controller: the brains.
          learn_across_placement: whether a step across a `reset` is learnt from.
        """
        self.controller = controller
        self._across = learn_across_placement

    def reset(self) -> None:
        """See `Agent.reset`."""
        if not self._across:
            self.controller.forget_step()

    @torch.inference_mode()
    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`."""
        return self.controller.act(torch.from_numpy(state), explore=learning).numpy()

    @torch.inference_mode()
    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`."""
        self.controller.learn(torch.from_numpy(reward))

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`."""
        return {name: tensor.numpy() for name, tensor in self.controller.state().items()}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""
        self.controller.load_state({k: torch.from_numpy(v) for k, v in arrays.items()})

    def weights(self) -> dict[str, np.ndarray]:
        """See `Agent.weights`."""
        return {name: tensor.numpy() for name, tensor in self.controller.networks().items()}


def senses_of(task: str) -> Senses:
    """What a brain is told of the signals of a task's robots.

    Raises:
      ValueError: there is no such task.
    """
    rules = task_definition(task).rules
    signals = [
        Signal(low, high, rules.maximal.get(name))
        for name, (length, low, high) in rules.shapes.items()
        for _ in range(length)
    ]
    return Senses(tuple(signals), Signal(*rules.rewards, rules.maximal.get("reward")))


def make_agent(experiment: Experiment, task: str, proposer: str, robots: int, seed: int) -> Agent:
    """Gives birth to what drives B robots.

    Args:
      experiment: whose brain's numbers to take.
      task: what the robots are to learn.
      proposer: the neurocontroller's, or an agent's factory.
      robots: B.
      seed: of its random stream.

    Raises:
      InputError: the factory cannot be found, or what it makes is no agent.
    """
    senses = senses_of(experiment.arena_task(task))
    sensors = len(senses.state)
    if proposer in PROPOSERS:
        controller = Neurocontroller(experiment.brain, proposer, robots, sensors, seed, senses)
        return Brain(controller, experiment.learn_across_placement)
    check_agent(proposer)
    module, _, name = proposer.partition(":")
    module = _MOVED.get(module, module)
    here = str(Path.cwd())
    if here not in sys.path:  # a script's own folder, as with `python -m`
        sys.path.insert(0, here)
    try:
        factory = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"there is no agent {proposer} ({error})") from error
    except Exception as error:  # whatever goes wrong in a user's module
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{module} cannot be imported ({what})") from error
    if not callable(factory):
        raise InputError(f"{proposer} is no factory of agents, but a {type(factory).__name__}")
    agent = factory(robots, sensors, seed)
    if not isinstance(agent, Agent):
        raise InputError(f"{proposer} must return an Agent, got {type(agent).__name__}")
    return agent
