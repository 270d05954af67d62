"""The paper's neurocontroller as an agent; an untrained one is a lower bound of what is learned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from ...controller.neurocontroller import Neurocontroller
from ...controller.presets import BRAINS
from ...controller.senses import Senses
from .base import Agent


class NeurocontrollerAgent(Agent):
    """Robots driven by the neurocontroller.

    Its state and its weights are NumPy arrays, even if the brains are on a GPU.

    Attributes:
      controller: Brains of the B robots.
    """

    def __init__(self, controller: Neurocontroller, learn_across_placement: bool = False) -> None:
        """Wraps brains; `learn_across_placement`: they also learn from steps across a `reset`."""
        self.controller = controller
        self._across = learn_across_placement

    def reset(self) -> None:
        if not self._across:
            self.controller.forget_step()

    @torch.inference_mode()
    def act(self, state: Any, learning: bool) -> Any:
        """See `Agent.act`; returns a tensor if `state` is one."""
        motors = self.controller.act(torch.as_tensor(state), explore=learning)
        return motors if isinstance(state, torch.Tensor) else motors.numpy()

    @torch.inference_mode()
    def learn(self, reward: Any) -> None:
        """See `Agent.learn`; takes tensors, too."""
        self.controller.learn(torch.as_tensor(reward))

    def state(self) -> dict[str, np.ndarray]:
        return {name: tensor.cpu().numpy() for name, tensor in self.controller.state().items()}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.controller.load_state({k: torch.from_numpy(v) for k, v in arrays.items()})

    def weights(self) -> dict[str, np.ndarray]:
        return {name: tensor.cpu().numpy() for name, tensor in self.controller.networks().items()}

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.controller.load_networks({k: torch.from_numpy(v) for k, v in arrays.items()})


class Newborn(NeurocontrollerAgent):
    """An untrained brain that learns nothing and does not explore."""

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        return super().act(state, False)

    def learn(self, reward: np.ndarray) -> None:
        """Learns nothing."""


def newborn(robots: int, senses: Senses, seed: int) -> Agent:
    """Makes untrained creative robots with the brain `steady`, a lower bound of what is learned."""
    return Newborn(Neurocontroller(BRAINS["steady"], "creative", robots, senses, seed))
