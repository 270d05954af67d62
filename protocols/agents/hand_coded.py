"""A hand-coded policy, an upper bound of what robots can learn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...controller.senses import Senses
from ..errors import InputError
from .base import Agent

_SIGNALS = 5  # of a robot that senses walls: front, back, left, right, contact


class HandCoded(Agent):
    """Finds the spot and stands in it, or drives about without touching a wall.

    With a nose, a robot turns until it smells the spot, drives there, and stands still in it.
    Without one, it drives ahead, turns in place in front of a wall, and away from a wall beside it.
    The policy learns nothing and acts in training as in the tests.
    """

    # DRIVE curves slightly in the direction of TURN: driving straight, a robot beside a wall that
    # smells the spot would push against the wall for ever.
    TURN, DRIVE, STAND = (0.5, -0.5), (0.5, 0.45), (0.0, 0.0)
    AHEAD, FROM_LEFT, FROM_RIGHT = (0.5, 0.5), (0.5, 0.2), (0.2, 0.5)
    NEAR, BESIDE = 0.3, 0.6  # distance signals (Eq. 2) at 0.13 m and 0.05 m

    def __init__(self, senses: Senses) -> None:
        """Prepares the policy for a robot's signals; looks up the smell inside the spot (Eq. 3).

        Raises:
          InputError: the robot has neither a nose nor distance sensors.
        """
        noses = [n for n, signal in enumerate(senses.state) if signal.maximal]
        if not noses and len(senses.state) != _SIGNALS:
            raise InputError(
                "hand_coded needs the signal of a nose, or the five signals of wall_avoidance, "
                f"got {len(senses.state)}"
            )
        self._nose = noses[0] if noses else None
        if noses and (maximal := senses.state[noses[0]].maximal):
            # `Informed` undoes errors of the nose, up to rounding.
            self._inside = maximal / (1 + maximal) - 1e-6

    def reset(self) -> None:
        """Does nothing: the policy has no memory."""

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        if self._nose is None:
            front, left, right = state[:, :1], state[:, 2:3], state[:, 3:4]
            motors = np.where(right > self.BESIDE, self.FROM_RIGHT, self.AHEAD)
            motors = np.where(left > self.BESIDE, self.FROM_LEFT, motors)
            return np.where(front > self.NEAR, self.TURN, motors)
        smell = state[:, self._nose, None]
        outside = np.where(smell > 0, self.DRIVE, self.TURN)
        return np.where(smell >= self._inside, self.STAND, outside)

    def learn(self, reward: np.ndarray) -> None:
        """Learns nothing."""

    def state(self) -> dict[str, np.ndarray]:
        return {}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Does nothing: the policy has no state."""

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Does nothing: the policy has no weights."""


def hand_coded(robots: int, senses: Senses, seed: int) -> Agent:
    """Makes robots with the hand-coded policy, an upper bound of what can be learned.

    Raises:
      InputError: there is no hand-coded policy for these signals.
    """
    del robots, seed  # it has no state, and nothing is random
    return HandCoded(senses)
