"""Makes agents by their name: a proposer of the neurocontroller, or an agent's factory.

A factory, named `package.module:factory`, receives the number of robots, the number of sensor
signals and a seed, and returns an `Agent`.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from ...controller.neurocontroller import Neurocontroller
from ...controller.proposers import PROPOSERS
from ..errors import InputError
from ..experiment.conditions import Condition, check_proposer
from ..experiment.experiment import Experiment
from ..experiment.networks import senses_of
from .base import Agent
from .neurocontroller import NeurocontrollerAgent

# Short names of our own agents, and the names that runs record: a cohort's random streams depend
# on the recorded name, which must not change when the code is moved.
RECORDED_NAMES = {
    "q_learner": "musebot.protocols.baselines:q_learner",
    "hand_coded": "musebot.protocols.baselines:hand_coded",
    "ppo": "musebot.protocols.ppo:ppo",
}
_MOVED = {
    "musebot.protocols.baselines:q_learner": "musebot.protocols.agents.q_learning:q_learner",
    "musebot.protocols.baselines:hand_coded": "musebot.protocols.agents.hand_coded:hand_coded",
    "musebot.protocols.ppo:ppo": "musebot.protocols.agents.ppo:ppo",
}


def recorded_name(name: str) -> str:
    """Returns the name under which a run records an agent: from `RECORDED_NAMES`, or as given."""
    for recorded, moved in _MOVED.items():
        if name == moved:
            return recorded
    return RECORDED_NAMES.get(name, name)


def make_agent(experiment: Experiment, condition: Condition, robots: int, seed: int) -> Agent:
    """Makes the untrained agent of B robots.

    Args:
      experiment: Experiment that decides the brain's parameters.
      condition: Task, and proposer or agent's factory.
      robots: Number of robots, B.
      seed: Seed of the agent's random stream.

    Raises:
      InputError: the factory is not found, fails to import, or returns no agent.
    """
    senses = senses_of(experiment.arena_task(condition.task))
    proposer, sensors = condition.proposer, len(senses.state)
    if proposer in PROPOSERS:
        controller = Neurocontroller(experiment.brain, proposer, robots, sensors, seed, senses)
        return NeurocontrollerAgent(controller, experiment.learn_across_placement)
    check_proposer(proposer)
    module, _, name = _MOVED.get(proposer, proposer).partition(":")
    here = str(Path.cwd())
    if here not in sys.path:  # the working folder, as with `python -m`
        sys.path.insert(0, here)
    try:
        factory = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"there is no agent {proposer} ({error})") from error
    except Exception as error:  # any fault in a user's module
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{module} cannot be imported ({what})") from error
    if not callable(factory):
        raise InputError(f"{proposer} must be a factory of agents, got {type(factory).__name__}")
    agent = factory(robots, sensors, seed)
    if not isinstance(agent, Agent):
        raise InputError(f"{proposer} must return an Agent, got {type(agent).__name__}")
    return agent
