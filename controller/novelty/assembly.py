"""The memory and the proposer of a brain, from its parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch
from torch import Tensor

from ..creative_memory import CreativeMemory, Memory
from ..networks import Networks
from ..optimizers import Optimizer
from ..parameters import Parameters
from ..proposers import ActionProposer, CreativeActions, RandomActions
from .action_noise import ActionNoise
from .cross_entropy import CrossEntropy
from .joined import Joined
from .main_idea import MainIdeaCopies
from .proposal_distribution import ProposalDistribution
from .sobol import SobolActions


def make_memory(
    parameters: Parameters,
    robots: int,
    inputs: int,
    generator: torch.Generator,
    optimizer: Callable[[Networks], Optimizer],
) -> Memory | None:
    """Returns the memory of B brains; None if no proposed action comes from one.

    Args:
      parameters: Parameters of the brains.
      robots: Number B of robots.
      inputs: Number I of network inputs.
      generator: Random stream of the brains.
      optimizer: Class of the optimizer.
    """
    if not parameters.needs_memory:
        return None
    if parameters.novelty == "learned":
        return ProposalDistribution(parameters, robots, inputs, generator, optimizer)
    if parameters.novelty == "action":  # the samples of the covariance all have noise
        parameters = dataclasses.replace(parameters, keep_main_idea=False)
    return CreativeMemory(parameters, robots, inputs, generator, optimizer)


def make_creative(
    parameters: Parameters,
    memory: Memory | None,
    values: Callable[[Tensor, Tensor], Tensor],
    generator: torch.Generator,
) -> ActionProposer:
    """Returns the creative proposer, whose number of actions is `Parameters.ideas`.

    Args:
      parameters: Parameters of the brains.
      memory: Memory of the brains; None if they have none.
      values: Function of network inputs and motor values that returns the values of actions.
      generator: Random stream of the brains.
    """
    p = parameters
    count = p.own_ideas
    if p.novelty == "connections" or p.novelty == "none":
        assert memory is not None
        kind = CreativeActions if p.novelty == "connections" else MainIdeaCopies
        own = kind(memory, count)
    else:
        others = count - p.keep_main_idea
        own = _others(p.novelty, others, memory, values, generator)
        if p.keep_main_idea:
            assert memory is not None
            own = Joined(MainIdeaCopies(memory, 1), own)
    if p.random_ideas:
        return Joined(own, RandomActions(p.random_ideas, generator))
    return own


def _others(
    novelty: str,
    count: int,
    memory: Memory | None,
    values: Callable[[Tensor, Tensor], Tensor],
    generator: torch.Generator,
) -> ActionProposer:
    """Returns the proposer of the actions that are neither the main idea nor outside ideas."""
    if novelty == "action":
        assert isinstance(memory, CreativeMemory)
        return ActionNoise(memory, count, generator)
    if novelty == "learned":
        assert memory is not None
        return CreativeActions(memory, count)
    if novelty == "cross_entropy":
        return CrossEntropy(values, count, generator)
    kind = SobolActions if novelty == "sobol" else RandomActions
    return kind(count, generator)
