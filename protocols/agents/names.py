"""Names of agents: short names, names that runs record, and the modules of the code."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.metadata import entry_points

from ...controller.parameters import PROPOSERS
from ..errors import InputError, nearest

GROUP = "musebot.agents"  # entry points by which other packages register agents

# Our own agents: the name that runs record, and the module of the code in this folder. A cohort's
# random streams depend on the recorded name, which must not change when the code is moved.
OWN: Mapping[str, tuple[str, str]] = {
    "q_learner": ("musebot.protocols.baselines:q_learner", "learners.q_learning"),
    "sarsa_lambda": ("musebot:sarsa_lambda", "learners.sarsa"),
    "stream_q": ("musebot:stream_q", "learners.stream_q"),
    "stream_ac": ("musebot:stream_ac", "learners.stream_ac"),
    "avg": ("musebot:avg", "learners.avg"),
    "amortised_q": ("musebot:amortised_q", "learners.amortised_q"),
    "dqn": ("musebot:dqn", "learners.dqn"),
    "dqn_no_replay": ("musebot:dqn_no_replay", "learners.dqn"),
    "dqn_l2": ("musebot:dqn_l2", "learners.plasticity"),
    "dqn_shrink_perturb": ("musebot:dqn_shrink_perturb", "learners.plasticity"),
    "dqn_continual": ("musebot:dqn_continual", "learners.plasticity"),
    "dqn_centred": ("musebot:dqn_centred", "learners.plasticity"),
    "hand_coded": ("musebot.protocols.baselines:hand_coded", "hand_coded"),
    "newborn": ("musebot:newborn", "neurocontroller"),
}
RECORDED_NAMES = {name: recorded for name, (recorded, _) in OWN.items()}
FACTORIES = {recorded: f"{__package__}.{module}:{n}" for n, (recorded, module) in OWN.items()}
LOWER, UPPER = "newborn", "hand_coded"  # bounds of what a robot can learn
OWN_BOUNDS = {RECORDED_NAMES[name] for name in (LOWER, UPPER)}


def is_own(name: str) -> bool:
    """Returns whether a recorded name is that of a proposer or of one of our own agents."""
    return name in PROPOSERS or name in FACTORIES


@functools.cache
def registered_names() -> Mapping[str, str]:
    """Returns the factories that other packages register, by name; none is imported.

    A package registers `package.module:factory` by the entry point "musebot.agents". Names of our
    own agents and proposers are left out.
    """
    found = {point.name: point.value for point in entry_points(group=GROUP)}
    return {name: found[name] for name in sorted({*found} - {*OWN, *PROPOSERS})}


def recorded_name(name: str) -> str:
    """Returns the name under which a run records an agent, or a proposer's name as given.

    Args:
      name: Proposer, short name of our own agent, registered name of another package's agent, or
        "package.module:factory".

    Raises:
      InputError: no agent has this name.
    """
    if name in PROPOSERS or ":" in name:
        return {code: recorded for recorded, code in FACTORIES.items()}.get(name, name)
    known = {**RECORDED_NAMES, **registered_names()}
    if name not in known:
        raise InputError(
            f"there is no agent {name!r:.60}, and a factory of yours is named as "
            f"package.module:factory; {nearest(name, known)}"
        )
    return known[name]


def short_name(name: str) -> str:
    """Returns the short or registered name for a recorded name; without one, the name itself."""
    known = {**registered_names(), **RECORDED_NAMES}
    return next((short for short, recorded in known.items() if recorded == name), name)
