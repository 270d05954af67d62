"""Makes agents by their name: a proposer of the neurocontroller, or an agent's factory.

A factory, named `package.module:factory`, receives the number of robots, the number of sensor
signals and a seed, and returns an `Agent`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

from ...controller.neurocontroller import Neurocontroller
from ...controller.proposers import PROPOSERS
from ..errors import InputError, RunError
from ..experiment.conditions import Condition, check_proposer
from ..experiment.experiment import Experiment
from ..experiment.networks import senses_of
from .base import Agent
from .checked_agent import CheckedAgent, ending_in_a_sentence, fault
from .names import MOVED, RECORDED_NAMES, is_own
from .neurocontroller import NeurocontrollerAgent
from .trust import check_trusted


def factory_of(name: str) -> Callable[[int, int, int], Agent]:
    """Returns the factory of one of our own agents.

    Args:
      name: Short name of the agent, a key of `RECORDED_NAMES`.
    """
    module, _, factory = MOVED[RECORDED_NAMES[name]].partition(":")
    return getattr(importlib.import_module(module), factory)


def make_agent(experiment: Experiment, condition: Condition, robots: int, seed: int) -> Agent:
    """Makes the untrained agent of B robots.

    Args:
      experiment: Experiment that decides the brain's parameters.
      condition: Task of the robots, and the name of their proposer or of their agent's factory.
      robots: Number of robots, B.
      seed: Seed of the agent's random stream.

    Raises:
      InputError: the factory is not trusted, is not found, fails to import, or returns no agent.
      RunError: the factory's module or the factory exits.
    """
    senses = senses_of(experiment.arena_task(condition.task))
    proposer, sensors = condition.proposer, len(senses.state)
    if proposer in PROPOSERS:
        controller = Neurocontroller(experiment.brain, proposer, robots, sensors, seed, senses)
        return NeurocontrollerAgent(controller, experiment.learn_across_placement)
    check_proposer(proposer)
    module, _, name = MOVED.get(proposer, proposer).partition(":")
    check_trusted(proposer, "the experiment")
    try:
        with ending_in_a_sentence(f"{module} cannot be imported", passed=(Exception,)):
            factory = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"there is no agent {proposer} ({error})") from error
    except (InputError, RunError):
        raise
    except Exception as error:  # any fault in a user's module
        raise InputError(f"{module} cannot be imported ({fault(error)})") from error
    if not callable(factory):
        raise InputError(f"{proposer} must be a factory of agents, got {type(factory).__name__}")
    if not is_own(proposer):
        return CheckedAgent(proposer, lambda: factory(robots, sensors, seed), robots)
    agent = factory(robots, sensors, seed)
    assert isinstance(agent, Agent)
    return agent
