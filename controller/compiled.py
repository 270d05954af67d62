"""The paper's brain, compiled by Numba: equal to the brain in PyTorch, up to rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import compiled_equations as equations
from .creative_memory import NoisePatterns
from .exploration import EpsilonGreedy
from .neurocontroller import Neurocontroller


class CompiledNeurocontroller(Neurocontroller):
    """A `Neurocontroller` on the CPU, compiled by Numba, with the same random numbers and state.

    Its parameters must be `compilable`. Its results equal those of PyTorch up to rounding.

    Attributes:
      nets: Tuple of five: weights of the evaluation networks, weights of the memories, noise,
        discount factor, learn rate. The noise is a pair: the pool and `fixed` of `NoisePatterns`.
      neurons: Numbers of hidden neurons in the evaluation network and in the memory, in this order.
      actions: Number A of proposed actions.
    """

    def __init__(self, *arguments: Any) -> None:
        """Draws the initial brains; see `Neurocontroller`."""
        super().__init__(*arguments)
        p = self._parameters
        assert p.compilable
        memory = pool = np.zeros((0, 0), np.float32)
        fixed = np.zeros((0, 0), np.int64)
        self._patterns = None
        if self.memory is not None:
            memory = self.memory.networks.weights.numpy()
            assert isinstance(self.memory.patterns, NoisePatterns)
            self._patterns = self.memory.patterns
            pool, fixed = self._patterns.tensors()["pool"].numpy(), self._patterns.fixed.numpy()
        assert isinstance(self._exploration, EpsilonGreedy)
        self._greedy = self._exploration
        rates = np.float32(p.discount), np.float32(p.learn_rate)
        self.nets = self.evaluation.networks.weights.numpy(), memory, (pool, fixed), *rates
        self.neurons = p.evaluation_hidden, p.memory_hidden
        self.actions = p.ideas if self._fixed is None else len(self._fixed)
        self._steps = [_views(step) for step in (self._previous, self._current)]

    @property
    def now(self) -> tuple[np.ndarray, ...]:
        """State, action, value and `chained` of the present step: views of the brain's tensors."""
        return self._steps[not self._swapped]

    def begin_steps(self, steps: int, learning: bool) -> int:
        """Begins `steps` control steps; fewer if the noise patterns must be redrawn earlier.

        Unlike `begin`, it does not swap the remembered steps. Returns the number of begun steps.
        """
        if self._patterns is not None:
            steps = self._patterns.renew(steps)
        self._age += steps * learning
        return steps

    def draw(self, steps: int, explore: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draws the random numbers of K = `steps` steps, as `Neurocontroller.select` draws them.

        Returns:
          Three arrays. Pool rows of the ideas' patterns, shape (K, B, A); empty without a memory.
          Actions of a random proposer, shape (K, B, A, 2), or of a fixed one, shape (K, 1, A, 2);
          else empty. Index of each robot's exploratory action, -1 for a greedy robot, shape (K, B).
        """
        robots, count, host = len(self.nets[0]), self.actions, torch.device("cpu")
        rows, proposed, explores = [], [], []
        for _ in range(steps):
            if self._patterns is not None:
                rows.append(self._patterns.rows(robots * count))
            elif self._fixed is None:
                proposed.append(torch.rand(robots, count, 2, generator=self.generator))
            if explore:
                explores.append(self._greedy.numbers(robots, count, host))
        exploring = np.full((steps, robots), -1)
        if explore:
            drawn, uniform = (torch.stack(part).numpy() for part in zip(*explores, strict=True))
            exploring = np.where(uniform < self.epsilon.value, drawn, exploring)
        actions = np.zeros((steps, 0, 0, 2), np.float32)
        if proposed:
            actions = (torch.stack(proposed) - 0.5).numpy()
        elif self._fixed is not None:
            actions = np.tile(self._fixed.numpy(), (steps, 1, 1, 1))
        patterns = np.zeros((steps, 0, 0), np.int64)
        if rows:
            patterns = torch.stack(rows).view(steps, robots, count).numpy()
        return patterns, actions, exploring

    def select(self, state: Tensor, explore: bool) -> Tensor:
        equations.act_all(self.nets, self.neurons, state.numpy(), self.draw(1, explore), self.now)
        return self._current.action.clone()

    def update(self, reward: Tensor) -> Tensor:
        error = torch.empty_like(reward)
        both = self._steps[self._swapped], self.now
        equations.learn_all(self.nets, self.neurons, reward.numpy(), *both, error.numpy())
        return error


def _views(step: Any) -> tuple[np.ndarray, ...]:
    return tuple(part.numpy() for part in (step.state, step.action, step.value, step.chained))
