"""`musebot list`: what the other commands take by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from ...controller.parameters import PROPOSERS
from ...controller.presets import INGREDIENTS
from ..agents.names import OWN, recorded_name, registered_names
from ..errors import InputError, nearest
from ..terminal import say
from .options import argument

# The names are repeated here, so that the list needs no heavy import; a test compares them.
_TASKS = {
    "wall_avoidance": "The paper's wall avoidance: reward -1 in contact, else 0; endless episodes.",
    "spot_finding": "The paper's spot finding: reward is the nose signal; endless episodes.",
    "wall_avoidance_unit": "Wall avoidance with a reward of 0 in contact, else 1.",
    "wall_avoidance_obstacles": (
        "Driving among three pillars: reward is the speed ahead, 0 in contact."
    ),
    "spot_finding_unit": "Spot finding with actions in [-1, 1] and episodes of 1,000 steps.",
    "spot_finding_two_noses": "Spot finding with two noses: reward is the mean of their signals.",
    "spot_finding_walls": (
        "Spot finding with wall sensing: reward is the nose signal, 0 in contact."
    ),
    "spot_finding_jumping": "Spot finding with a spot that jumps to a random place every 20 s.",
}
_BRAINS = {
    "paper": "The paper's brain.",
    "steady": "Two larger networks with other inputs and another learning rule.",
    "constant": "`steady` with a constant learn rate and epsilon, for lives that change.",
    **{f"steady-{one}": f"`steady` without its ingredient {one}." for one in INGREDIENTS},
    "recurrent": "`steady` with a recurrent context: units that remember what was sensed.",
}
_LIVES = {
    "wall_avoidance": "The paper's: two hours of wall avoidance between two tests.",
    "spot_finding": "The paper's: four hours of spot finding between two tests.",
    "spot_finding_walls": "Spot finding in which the robot also senses walls.",
    "body": "Spot finding; every hour a wheel is reversed, or the nose moves to the back.",
    "drift": "Spot finding; the wiring of the wheels turns once in twelve hours.",
    "tasks": "Every hour the reward alternates between the spot and driving.",
    "senses": "Spot finding; every hour the nose begins, or ceases, to read inverted.",
}
_AGENTS = {
    "fixed": "Proposer of a brain: always the same actions.",
    "random": "Proposer of a brain: new random actions in each step.",
    "creative": "Proposer of a brain: ideas of its creative memory.",
    "q_learner": "Online Q-learning with 16 hidden neurons, values of the 25 fixed actions.",
    "sarsa_lambda": "SARSA(lambda) with tile coding and the paper's 25 fixed actions.",
    "stream_q": "Stream Q(lambda): Q-learning with traces and bounded steps, no replay.",
    "stream_ac": "Stream AC(lambda): an actor-critic with traces and bounded steps.",
    "avg": "Action Value Gradient: an incremental soft actor-critic.",
    "amortised_q": "Amortised Q-learning: a learned distribution proposes actions.",
    "dqn": "DQN: Q-learning from a memory of the last 50,000 transitions.",
    "dqn_no_replay": "DQN that learns from the last transition only.",
    "dqn_l2": "dqn_no_replay with decoupled weight decay.",
    "dqn_shrink_perturb": "dqn_no_replay with weights that shrink and receive noise.",
    "dqn_continual": "dqn_no_replay with continual backpropagation.",
    "dqn_centred": "dqn_no_replay with reward centring.",
    "hand_coded": "A hand-coded policy, which learns nothing: a bound from above.",
    "newborn": "An untrained creative robot with the brain `steady`: a bound from below.",
}
NAMES: Mapping[str, Mapping[str, str]] = {
    "lives": _LIVES,
    "tasks": _TASKS,
    "brains": _BRAINS,
    "agents": _AGENTS,
}


@dataclasses.dataclass
class List:
    """List lives, tasks, brains and agents by name, or the settings of an agent, a line each."""

    kind: str = argument("lives, tasks, brains, agents, or an agent's name (all lists)", "KIND", "")

    def __call__(self) -> None:
        """Prints the lists.

        Raises:
          InputError: there is no such kind or agent, or the agent's code cannot be imported.
        """
        if self.kind and self.kind not in NAMES:
            for line in _settings(self.kind):
                say(line)
            return
        for kind in [self.kind] if self.kind else NAMES:
            lines = dict(NAMES[kind])
            if kind == "agents":
                lines |= {k: f"Another package's: {v}." for k, v in registered_names().items()}
            if not self.kind:
                say(f"{kind}:")
            width = max(map(len, lines))
            for name, line in lines.items():
                say(f"{'' if self.kind else '  '}{name:{width}}  {line}")


def _settings(agent: str) -> list[str]:
    """Returns a line for each setting of an agent: name, default, range and meaning."""
    if agent in PROPOSERS:
        raise InputError(f"{agent} is a proposer of the brain, which has no settings")
    known = [*OWN, *registered_names()]
    if agent not in known and ":" not in agent:
        raise InputError(f"there is no list {agent!r:.60}; {nearest(agent, [*NAMES, *known])}")
    from ..agents.factory import factory_of, trust
    from ..agents.settings import settings_of

    trust(recorded := recorded_name(agent))
    lines = []
    for name, setting in settings_of(factory_of(recorded)).items():
        limits = f"{setting.low:g} to {setting.high:g}"
        lines.append(f"{name:14}  {setting.default:<8g}  {limits:18}  {setting.says}".rstrip())
    return lines or [f"{agent} has no settings"]
