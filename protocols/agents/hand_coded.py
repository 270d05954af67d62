"""A hand-coded policy of spot finding: an upper bound for what the robots can learn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from .base import Agent
from .factory import senses_of


class HandCoded(Agent):
    """Turns until the nose smells the spot, drives there, and stands still in it.

    It learns nothing and acts in training as in the tests.
    """

    # It drives in a slight curve, in the direction of the turn: a robot that smells the spot
    # beside a wall would push straight against the wall for ever.
    TURN, DRIVE, STAND = (0.5, -0.5), (0.5, 0.45), (0.0, 0.0)

    def __init__(self) -> None:
        """Looks up the nose's signal inside the spot (Eq. 3)."""
        self._maximal = np.float32(senses_of("spot_finding").reward.saturated)

    def reset(self) -> None:
        """See `Agent.reset`."""

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`."""
        outside = np.where(state > 0, self.DRIVE, self.TURN)
        return np.where(state >= self._maximal, self.STAND, outside)

    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`."""

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`."""
        return {}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""


def hand_coded(robots: int, sensors: int, seed: int) -> Agent:
    """Makes hand-coded robots that observe the nose's signal only.

    Args:
      robots: Number of robots; unused, since hand-coded robots have no state.
      sensors: Number of sensor signals; must be 1.
      seed: Seed; unused, since nothing is random.

    Raises:
      InputError: there are other signals.
    """
    del robots, seed
    if sensors != 1:
        raise InputError(f"hand_coded needs one signal, that of spot_finding, got {sensors}")
    return HandCoded()
