"""Names of agents: short ones, those that runs record, and where the code is."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Mapping
from importlib.metadata import entry_points

from ...controller.proposers import PROPOSERS
from ..errors import InputError

GROUP = "musebot.agents"  # entry points by which other packages register agents

# Short names of our own agents, and the names that runs record: a cohort's random streams depend
# on the recorded name, which must not change when the code is moved.
RECORDED_NAMES = {
    "q_learner": "musebot.protocols.baselines:q_learner",
    "sarsa_lambda": "musebot:sarsa_lambda",
    "stream_q": "musebot:stream_q",
    "stream_ac": "musebot:stream_ac",
    "avg": "musebot:avg",
    "amortised_q": "musebot:amortised_q",
    "dqn": "musebot:dqn",
    "ppo": "musebot.protocols.ppo:ppo",
    "hand_coded": "musebot.protocols.baselines:hand_coded",
    "newborn": "musebot:newborn",
}
OWN_ENCODING = {RECORDED_NAMES["newborn"]}  # a brain that reads raw signals by itself
_MODULES = {
    "q_learner": "learners.q_learning",
    "sarsa_lambda": "learners.sarsa",
    "stream_q": "learners.stream_q",
    "stream_ac": "learners.stream_ac",
    "avg": "learners.avg",
    "amortised_q": "learners.amortised_q",
    "dqn": "learners.dqn",
    "ppo": "ppo",
    "hand_coded": "bounds",
    "newborn": "bounds",
}
MOVED = {
    recorded: f"musebot.protocols.agents.{_MODULES[name]}:{recorded.partition(':')[2]}"
    for name, recorded in RECORDED_NAMES.items()
}


def is_own(name: str) -> bool:
    """Returns whether a name is a proposer's, or that of one of our own agents."""
    return name in PROPOSERS or name in MOVED


@functools.cache
def registered_names() -> Mapping[str, str]:
    """Returns the factories that other packages register, by name; none is imported.

    A package registers `package.module:factory` by the entry point "musebot.agents". Names of our
    own agents and proposers stay ours.
    """
    found = {point.name: point.value for point in entry_points(group=GROUP)}
    return {
        name: value
        for name, value in sorted(found.items())
        if name not in RECORDED_NAMES and name not in PROPOSERS
    }


def recorded_name(name: str) -> str:
    """Returns the name under which a run records an agent, or a proposer's name as given.

    Args:
      name: Proposer, short or registered name of an agent, or "package.module:factory".

    Raises:
      InputError: no agent has this name.
    """
    for recorded, moved in MOVED.items():
        if name == moved:
            return recorded
    if name in PROPOSERS or ":" in name:
        return name
    known = {**RECORDED_NAMES, **registered_names()}
    if name not in known:
        near = difflib.get_close_matches(name, known, 3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(known)}"
        raise InputError(
            f"there is no agent {name!r:.60}: {hint}; a factory of yours is named as "
            "package.module:factory"
        )
    return known[name]


def short_name(name: str) -> str:
    """Returns the short or registered name of an agent that a run records, or the name itself."""
    known = {**registered_names(), **RECORDED_NAMES}
    return next((short for short, recorded in known.items() if recorded == name), name)
