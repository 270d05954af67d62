"""Names of agents: short ones, those that runs record, and where the code is."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.metadata import entry_points

from ...controller.proposers import PROPOSERS
from ..errors import InputError, nearest

GROUP = "musebot.agents"  # entry points by which other packages register agents

# Our own agents by their short names: the module that runs record, and the one in which the code is
# now, in this folder. A cohort's random streams depend on the recorded name, which must not change
# when the code is moved.
_OWN = {
    "q_learner": ("musebot.protocols.baselines", "learners.q_learning"),
    "sarsa_lambda": ("musebot", "learners.sarsa"),
    "stream_q": ("musebot", "learners.stream_q"),
    "stream_ac": ("musebot", "learners.stream_ac"),
    "avg": ("musebot", "learners.avg"),
    "amortised_q": ("musebot", "learners.amortised_q"),
    "dqn": ("musebot", "learners.dqn"),
    "ppo": ("musebot.protocols.ppo", "ppo"),
    "hand_coded": ("musebot.protocols.baselines", "bounds"),
    "newborn": ("musebot", "bounds"),
}
RECORDED_NAMES = {name: f"{recorded}:{name}" for name, (recorded, _) in _OWN.items()}
MOVED = {
    RECORDED_NAMES[name]: f"{__package__}.{module}:{name}" for name, (_, module) in _OWN.items()
}
TRAINED_BEFORE = "ppo"  # our agent that learned before its life
OWN_BOUNDS = {RECORDED_NAMES[name] for name in ("newborn", "hand_coded")}
OWN_ENCODING = {RECORDED_NAMES["newborn"]}  # a brain that reads raw signals by itself


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
        raise InputError(
            f"there is no agent {name!r:.60}: {nearest(name, known)}; a factory of yours is named "
            "as package.module:factory"
        )
    return known[name]


def name_in_track(name: str, signals: str) -> str:
    """Returns the key under which the tuning of an agent with these signals is looked up.

    Raises:
      InputError: no agent has this name.
    """
    return f"{recorded_name(name)}, {signals}"


def short_name(name: str) -> str:
    """Returns the short or registered name of an agent that a run records, or the name itself."""
    known = {**registered_names(), **RECORDED_NAMES}
    return next((short for short, recorded in known.items() if recorded == name), name)
