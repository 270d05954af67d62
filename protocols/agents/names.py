"""Names of agents: short ones, those that runs record, and where the code is today."""

from __future__ import annotations

from ...controller.proposers import PROPOSERS

# Short names of our own agents, and the names that runs record: a cohort's random streams depend
# on the recorded name, which must not change when the code is moved.
RECORDED_NAMES = {
    "q_learner": "musebot.protocols.baselines:q_learner",
    "hand_coded": "musebot.protocols.baselines:hand_coded",
    "ppo": "musebot.protocols.ppo:ppo",
}
MOVED = {
    "musebot.protocols.baselines:q_learner": "musebot.protocols.agents.q_learning:q_learner",
    "musebot.protocols.baselines:hand_coded": "musebot.protocols.agents.hand_coded:hand_coded",
    "musebot.protocols.ppo:ppo": "musebot.protocols.agents.ppo:ppo",
}


def is_own(name: str) -> bool:
    """Returns whether a name is a proposer's, or that of one of our own agents."""
    return name in PROPOSERS or name in MOVED


def recorded_name(name: str) -> str:
    """Returns the name under which a run records an agent: from `RECORDED_NAMES`, or as given."""
    for recorded, moved in MOVED.items():
        if name == moved:
            return recorded
    return RECORDED_NAMES.get(name, name)
