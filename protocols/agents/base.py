"""The interface of every agent that drives robots. docs/agents.md has an example."""

from __future__ import annotations

import abc
import json
from collections.abc import Mapping

import numpy as np


def sound(weights: Mapping[str, np.ndarray], robots: int) -> np.ndarray:
    """Returns for each of B robots, (B,), whether all its weights, arrays (B, ...), are finite."""
    found = np.ones(robots, dtype=bool)
    for array in weights.values():
        found &= np.isfinite(array).reshape(robots, -1).all(axis=1)
    return found


def random_state(random: np.random.Generator) -> np.ndarray:
    """Returns the state of a generator that `np.random.default_rng` made, for `Agent.state`.

    Returns:
      NumPy's own description of the state, as characters of JSON, uint8, shape (256,).

    Raises:
      ValueError: the generator is not a PCG64.
    """
    state = random.bit_generator.state
    if state["bit_generator"] != "PCG64":
        raise ValueError(f"the generator must be PCG64, got {state['bit_generator']}")
    return np.frombuffer(bytearray(json.dumps(state).ljust(256).encode()), np.uint8)


def load_random_state(random: np.random.Generator, state: np.ndarray) -> None:
    """Sets a generator to a state that `random_state` returned: the same numbers follow.

    Raises:
      ValueError: the generator is not a PCG64, or `state` is no state of one.
    """
    try:
        given = json.loads(bytes(state))
        random.bit_generator.state = given
        if random.bit_generator.state != given:
            raise ValueError("it was not taken over")
    except (KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise ValueError("this is no state of the generator") from error


class Agent(abc.ABC):
    """An agent that drives B robots in lockstep.

    In every control step, the simulation calls `act` with the robots' observations. In training, it
    then calls `learn` with the reward observed in the same step, that of the previous action. It
    calls `reset` before the first step and whenever all robots are placed anew.
    """

    @abc.abstractmethod
    def reset(self) -> None:
        """Forgets the last action: after a placement, the observation does not follow from it."""

    @abc.abstractmethod
    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """Chooses the robots' motor values.

        Args:
          state: The S observed signals of each robot, float32, shape (B, S).
          learning: Whether the robots are in training; in tests, the agent must not explore.

        Returns:
          Left and right motor value in [-0.5, 0.5], shape (B, 2).
        """

    @abc.abstractmethod
    def learn(self, reward: np.ndarray) -> None:
        """Learns from the reward of the previous action; called in training only, after `act`.

        Args:
          reward: Reward of the previous action, observed together with the state last given to
            `act`, float32, shape (B,). The first one after a `reset` belongs to no action.
        """

    @abc.abstractmethod
    def state(self) -> dict[str, np.ndarray]:
        """Returns everything that the next steps depend on, random streams included.

        The arrays need not be copies: the checkpoint is written before the next step.
        """

    @abc.abstractmethod
    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores what `state` returned: the next steps are then the same, bit-exactly.

        Raises:
          ValueError: an array is missing or has a wrong shape.
        """

    def weights(self) -> dict[str, np.ndarray]:
        """Returns all arrays that actions in a test depend on, by name, each of shape (B, ...).

        Arrays drawn from the seed are included. Names, dtypes and shapes stay the same during the
        agent's life. A run keeps all in results.safetensors.gz. A robot with a NaN or infinite
        weight is stopped and counted as invalid.
        """
        return {}

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Takes over what `weights` returned, so that the agent acts as in a test with them.

        `musebot film` and `musebot explore` need this method; the simulation of lives does not.

        Raises:
          NotImplementedError: the agent cannot take over weights.
          ValueError: an array is missing or has a wrong shape.
        """
        raise NotImplementedError(f"{type(self).__name__} has no load_weights")


class Wrapper(Agent):
    """An agent that passes every call on to another agent; a subclass changes some calls.

    Attributes:
      agent: Wrapped agent, to which all calls are passed on.
    """

    def __init__(self, agent: Agent) -> None:
        self.agent = agent

    def reset(self) -> None:
        self.agent.reset()

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        return self.agent.act(state, learning)

    def learn(self, reward: np.ndarray) -> None:
        self.agent.learn(reward)

    def state(self) -> dict[str, np.ndarray]:
        return self.agent.state()

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.agent.load_state(arrays)

    def weights(self) -> dict[str, np.ndarray]:
        return self.agent.weights()

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.agent.load_weights(arrays)
