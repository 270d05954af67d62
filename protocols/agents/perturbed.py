"""The paper's neurocontroller with perturbed sensors."""

from __future__ import annotations

import numpy as np

from ...tasks.rules import RANGEFINDERS
from ...tasks.sensors import distance_signal
from ..experiment.networks import senses_of
from .neurocontroller import NeurocontrollerAgent


class PerturbedBrain(NeurocontrollerAgent):
    """Brains that receive noisy signals, or lack a distance sensor."""

    def __init__(
        self,
        agent: NeurocontrollerAgent,
        task: str,
        random: np.random.Generator,
        noise: float = 0.0,
        dead: str | None = None,
    ) -> None:
        """Takes the brains.

        Args:
          agent: Agent with the brains of the robots.
          task: Task of the domain "arena" in which the robots are.
          random: Random stream of the noise.
          noise: Standard deviation of a normally distributed factor with mean 1, drawn anew for
            every signal, robot and control step; the results are clipped to the signal's range.
          dead: Name of the distance sensor that is switched off; None for none. Only wall avoidance
            has distance sensors; they are the first of its signals.
        """
        super().__init__(agent.controller)
        self._noise, self._random = noise, random
        signals = senses_of(task).state
        self._low, self._high = np.array([(signal.low, signal.high) for signal in signals]).T
        self._dead = None if dead is None else RANGEFINDERS.index(dead)

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`."""
        return super().act(self.perturbed(state), learning)

    def perturbed(self, state: np.ndarray) -> np.ndarray:
        """Returns perturbed signals, float32, shape (B, S)."""
        state = state.copy()
        if self._noise:
            factor = 1 + self._noise * self._random.standard_normal(state.shape)
            state[:] = np.clip(state * factor, self._low, self._high)
        if self._dead is not None:
            # Eq. 2 of a ray that meets nothing, as of a wall at an infinite distance: 0.
            state[:, self._dead] = distance_signal(np.array(-1.0))
        return state
