"""Makes agents by their name: a proposer of the neurocontroller, or an agent's factory.

A factory, named `package.module:factory`, receives the number of robots, what they sense and a
seed; the run's settings follow as keywords. It returns an `Agent`.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from typing import Any, cast

from ...controller.neurocontroller import Neurocontroller
from ...controller.proposers import PROPOSERS
from ...controller.senses import Senses
from ..errors import InputError, similar
from ..experiment.conditions import Condition
from ..experiment.experiment import Experiment
from ..experiment.networks import senses_of
from .base import Agent
from .checked_agent import CheckedAgent, ending_in_a_sentence
from .names import MOVED, OWN_BOUNDS, OWN_ENCODING, RECORDED_NAMES, is_own, short_name
from .neurocontroller import NeurocontrollerAgent
from .raw_signals import RawSignals
from .settings import checked_settings, settings_from
from .trust import check_trusted


def factory_of(name: str) -> Callable[..., Agent]:
    """Returns the factory of an agent.

    Args:
      name: Name of the agent: one of `RECORDED_NAMES`, as a run records it, or
        "package.module:factory".

    Raises:
      InputError: the factory is not trusted, is not found, or fails to import.
      RunError: the factory's module exits.
    """
    name = RECORDED_NAMES.get(name, name)
    check_trusted(name, "the experiment")
    module, _, attribute = MOVED.get(name, name).partition(":")
    factory: Any
    with ending_in_a_sentence(f"{module} cannot be imported", InputError):
        try:
            found = importlib.import_module(module)
            factory = getattr(found, attribute, None)
        except ModuleNotFoundError as error:
            if not f"{module}.".startswith(f"{error.name}."):
                raise  # it exists, but what it imports does not
            raise InputError(
                f"there is no agent {name}: no module {error.name} in the working directory or "
                "among the installed packages"
            ) from error
    if factory is None:
        names = [name for name, one in vars(found).items() if callable(one) and name[0] != "_"]
        question = similar(attribute, names)
        more = f"; {question}" if question else ""
        raise InputError(f"there is no agent {name}: {module} has no {attribute}{more}")
    if not callable(factory):
        raise InputError(f"{name} must be a factory of agents, got {type(factory).__name__}")
    return cast(Callable[..., Agent], factory)


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

    def make(sensed: Senses) -> Agent:
        agent = functools.partial(factory, robots, sensed, seed, **settings)
        return agent() if is_own(proposer) else CheckedAgent(proposer, agent, robots)

    raw = experiment.signals == "raw" and proposer not in OWN_ENCODING
    return RawSignals(senses, make) if raw else make(senses)
