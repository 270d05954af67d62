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
from ..errors import InputError, RunError
from ..experiment.conditions import Condition, check_proposer
from ..experiment.experiment import Experiment
from ..experiment.networks import senses_of
from .base import Agent
from .neurocontroller import NeurocontrollerAgent
from .stranger import StrangerAgent, ending_in_a_sentence, fault

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


# Factories of users whose code may run here: named by this command, never by a file alone.
_TRUSTED: set[str] = set()


def trust(*names: str) -> None:
    """Lets `make_agent` import the factories that the user's command names.

    Their modules are also looked for in the working directory, as with `python -m`.
    """
    strangers = [name for name in names if _is_stranger(name)]
    _TRUSTED.update(strangers)
    here = str(Path.cwd()) if strangers else ""
    if here and here not in sys.path:
        sys.path.insert(0, here)


def check_trusted(name: str, source: object) -> None:
    """Raises InputError where a proposer is a user's factory that the command has not named.

    Args:
      name: Name of a proposer or factory.
      source: What names it.
    """
    if _is_stranger(name) and name not in _TRUSTED:
        raise InputError(
            f"{source} names the agent {name}, whose code would be run: allow it by --agent "
            f"{name} or by --trust-agent"
        )


def _is_stranger(name: str) -> bool:
    return name not in PROPOSERS and name not in _MOVED


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
      InputError: the factory is not trusted, is not found, fails to import, or returns no agent.
      RunError: the factory's module or the factory exits.
    """
    senses = senses_of(experiment.arena_task(condition.task))
    proposer, sensors = condition.proposer, len(senses.state)
    if proposer in PROPOSERS:
        controller = Neurocontroller(experiment.brain, proposer, robots, sensors, seed, senses)
        return NeurocontrollerAgent(controller, experiment.learn_across_placement)
    check_proposer(proposer)
    module, _, name = _MOVED.get(proposer, proposer).partition(":")
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
    if _is_stranger(proposer):
        return StrangerAgent(proposer, lambda: factory(robots, sensors, seed), robots)
    agent = factory(robots, sensors, seed)
    assert isinstance(agent, Agent)
    return agent
