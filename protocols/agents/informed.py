"""Hand-coded policies that know their world: upper bounds of what robots reach in a life."""

from __future__ import annotations

import math

import numpy as np

from ...controller.senses import Senses
from ...tasks.world import World, sensor_names
from .base import Wrapper
from .hand_coded import HandCoded


class Informed(Wrapper):
    """The hand-coded policy, adapted to one known world; it learns nothing.

    In its world, it is about as good as the hand-coded policy in the default world, if the wiring
    can be inverted and the nose is at the front or the back. In other worlds, it acts the same way.
    """

    def __init__(self, world: World, shapes: dict[str, int], senses: Senses) -> None:
        """Adapts the policy to a world.

        Args:
          world: World to which the policy is adapted.
          shapes: Number of signals in each observation, by name, in the order of `senses`.
          senses: Ranges of the signals and of the reward.

        Raises:
          InputError: there is no hand-coded policy for these signals.
        """
        wrong = {name: (offset, gain) for name, offset, gain in world.sensors}
        names = [name for kind, length in shapes.items() for name in sensor_names(kind, length)]
        pairs = np.array([wrong.get(name, (0.0, 1.0)) for name in names], dtype=np.float32)
        self._offset, self._gain = pairs.T
        # Where driving is rewarded, the robot drives about like one without a nose.
        self._first = shapes.get("nose", 0) if world.rewarded == "driving" else 0
        behind = math.cos(math.radians(world.nose)) < 0
        backwards = -1 if behind and world.rewarded == "task" else 1
        self._wheels = backwards * np.linalg.pinv(np.reshape(world.wheels, (2, 2)))
        super().__init__(HandCoded(Senses(senses.state[self._first :], senses.reward)))

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        lost = self._gain == 0  # a dead sensor: read as no smell or no wall
        signals = np.where(lost, 0, (state - self._offset) / np.where(lost, 1, self._gain))
        motors = super().act(signals[:, self._first :].astype(np.float32), learning)
        wheels = motors @ self._wheels.T
        # No motor value may exceed 0.5: the robot drives the same path more slowly.
        return wheels / np.maximum(np.abs(wheels).max(axis=1, keepdims=True) / 0.5, 1)
