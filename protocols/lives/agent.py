"""The agents of an experiment, and the shapes of their networks."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from ...controller.neurocontroller import Neurocontroller
from ...controller.proposers import PROPOSERS
from ..agents.base import Agent
from ..agents.checked_agent import CheckedAgent
from ..agents.factory import factory_of
from ..agents.names import OWN_BOUNDS, OWN_ENCODING, is_own, short_name
from ..agents.neurocontroller import NeurocontrollerAgent
from ..agents.senses import RawSignals, raw_senses, senses_of
from ..agents.settings import checked_settings, settings_from
from ..errors import InputError

if TYPE_CHECKING:
    from .conditions import Condition
    from .experiment import Experiment


@functools.lru_cache(maxsize=64)
def network_shapes(
    experiment: Experiment, condition: Condition
) -> Mapping[str, tuple[int, ...]] | None:
    """Returns the shape of each array of one robot's networks; None for an agent of a user's."""
    if not condition.has_brain:
        return None
    senses = senses_of(experiment.arena_task(condition.task))
    controller = Neurocontroller(
        experiment.brain, condition.proposer, 1, len(senses.state), 0, senses
    )
    shapes = {name: tuple(tensor.shape[1:]) for name, tensor in controller.networks().items()}
    return MappingProxyType(shapes)


def make_agent(experiment: Experiment, condition: Condition, robots: int, seed: int) -> Agent:
    """Makes the untrained agent of B robots.

    Args:
      experiment: Experiment that decides the brain's parameters.
      condition: Task of the robots, and the name of their proposer or of their agent's factory.
      robots: Number of robots, B.
      seed: Seed of the agent's random stream.

    Raises:
      InputError: the factory is not trusted, is not found, fails to import, has not these settings,
        or returns no agent.
      RunError: the factory's module or the factory exits.
    """
    senses = senses_of(experiment.arena_task(condition.task))
    proposer = condition.proposer
    if proposer in PROPOSERS:
        controller = Neurocontroller(
            experiment.brain, proposer, robots, len(senses.state), seed, senses
        )
        return NeurocontrollerAgent(controller, experiment.learn_across_placement)
    if experiment.nose == "printed" and proposer in OWN_BOUNDS:
        if any(signal.maximal for signal in senses.state):
            name = short_name(proposer)
            raise InputError(f"{name} uses the maximal smell: it needs the nose 'inverse'")
    factory = factory_of(proposer)
    words = settings_from(experiment.settings, several=True)
    settings = checked_settings(short_name(proposer), factory, words, robots) if words else {}
    raw = experiment.signals == "raw" and proposer not in OWN_ENCODING
    sensed = raw_senses(senses) if raw else senses
    make = functools.partial(factory, robots, sensed, seed, **settings)
    agent = make() if is_own(proposer) else CheckedAgent(proposer, make, robots)
    return RawSignals(senses, agent) if raw else agent
