"""Every number of the brain, in one frozen dataclass that names its place in the paper."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, get_args

from .networks import ActivationName
from .optimizers import OptimizerName

Proposer = Literal["fixed", "random", "creative"]
PROPOSERS: tuple[Proposer, ...] = ("fixed", "random", "creative")

_CHOICES = {
    "activation": get_args(ActivationName),
    "optimizer": get_args(OptimizerName),
    "reward": ("signal", "change"),
    "next_value": ("selected", "best"),
    "memory_goal": ("selected", "best"),
}


@dataclasses.dataclass(frozen=True)
class Parameters:
    """The brain's parameters; the defaults are the paper's.

    The second part are choices beyond the paper, each of which can be made alone. "Young" is
    what a robot is when it begins to learn: from a young value to the grown-up one it goes as
    exp(-age / youth), age and youth in control steps of learning.

    Attributes:
      evaluation_hidden: hidden neurons of the evaluation network (section 3).
      learn_rate: eta of Eq. 1 (section 3).
      discount: gamma of Eq. 1 (section 3).
      epsilon: probability of a random action while learning (section 3).
      test_epsilon: the same in the test phases (not stated: docs/paper.md).
      fixed_motors: the motor values whose pairs are the fixed actions (section 3).
      ideas: actions that the random and the creative proposer offer a step (section 3).
      memory_hidden: hidden neurons of the creative memory (section 3).
      noise: sigma, added to or subtracted from each noisy connection (section 3).
      noisy_share: share of the connections that are noisy in an idea, "a quarter" (section
        3); their number is rounded to the nearest.
      noise_on_biases: whether biases count as connections (not stated).
      keep_main_idea: whether the first idea is the memory's own, without noise (not stated).
      initial_range: weights and biases are drawn from [-initial_range, initial_range]
        (section 3.1).
      activation: of the hidden neurons, "logistic" (section 3) or "tanh".
      centred: whether all inputs, the motors too, are stretched to [-1, 1].
      raw_signals: whether a signal that saturates is also read raw, as a second input.
      raw_reward: whether a reward that saturates is taken raw, a full load as 1.
      reward: what is rewarded, the reward's "signal" (section 2) or its "change".
      lingering: a reward above 0 falls, in a step, to no less than this share of itself, so that
        what is lost is taken away little by little; one below 0 is felt in full. Meanwhile it
        has not fallen to nothing, and next_value_capped does not act.
      next_value: V at t + 1 of Eq. 1, of the "selected" action or of the "best" proposed.
      next_value_capped: whether V at t + 1 is at most the reward at t, or nothing, where the
        reward has just fallen to nothing or below.
      action_gap: share of what an action is judged worse than the best one, by which it is
        rewarded less.
      error_limit: the largest size of a TD error: one farther from 0 is learnt from as if it
        were there, with its sign (the gradient of Huber's loss). None for no limit.
      optimizer: how weights follow the gradient, "plain" (Eq. 1) or "adam".
      memory_goal: what the memory is trained towards: the "selected" action, at the TD error
        (section 3), or the "best" proposed, at the learn rate.
      random_share: share of the creative proposer's ideas that are uniformly random; their
        number is rounded to the nearest, and one idea at least is the memory's own.
      held_steps: a random action is one of those proposed, for one step (0; section 3), or
        any motor pair, held for 1 to so many steps.
      young_epsilon: the young epsilon; None for no other.
      epsilon_youth: how long it takes.
      young_learn_rate: the young learn rate; None for no other.
      learn_rate_youth: how long it takes.
      content_steps: a robot that was rewarded with a full load for so many steps of learning in a
        row learns and explores no more, "if training would be abandoned" (section 4); 0 for
        never.
    """

    evaluation_hidden: int = 7
    learn_rate: float = 0.01
    discount: float = 0.9
    epsilon: float = 0.01
    test_epsilon: float = 0.0
    fixed_motors: tuple[float, ...] = (-0.5, -0.25, 0.0, 0.25, 0.5)
    ideas: int = 25
    memory_hidden: int = 5
    noise: float = 0.76
    noisy_share: float = 0.25
    noise_on_biases: bool = False
    keep_main_idea: bool = False
    initial_range: float = 1.0

    activation: ActivationName = "logistic"
    centred: bool = False
    raw_signals: bool = False
    raw_reward: bool = False
    reward: Literal["signal", "change"] = "signal"
    lingering: float = 0.0
    next_value: Literal["selected", "best"] = "selected"
    next_value_capped: bool = False
    action_gap: float = 0.0
    error_limit: float | None = None
    optimizer: OptimizerName = "plain"
    memory_goal: Literal["selected", "best"] = "selected"
    random_share: float = 0.0
    held_steps: int = 0
    young_epsilon: float | None = None
    epsilon_youth: float = 24000.0
    young_learn_rate: float | None = None
    learn_rate_youth: float = 62400.0
    content_steps: int = 0

    def __post_init__(self) -> None:
        """Raises ValueError, naming the field, where a number makes no sense."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(field.default, bool) and not isinstance(value, bool):
                raise ValueError(f"{field.name} must be true or false, got {value!r}")
            if type(field.default) is int and type(value) is not int:
                raise ValueError(f"{field.name} must be a whole number, got {value!r}")
            if isinstance(field.default, float) and type(value) not in (int, float):
                raise ValueError(f"{field.name} must be a number, got {value!r}")
        for name in ("evaluation_hidden", "ideas", "memory_hidden"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("discount", "epsilon", "test_epsilon", "noisy_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        steps = "held_steps", "content_steps"
        for name in ("learn_rate", "noise", "initial_range", "action_gap", *steps):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        for name in ("error_limit", "young_epsilon", "young_learn_rate"):
            if type(getattr(self, name)) not in (int, float, type(None)):
                raise ValueError(f"{name} must be a number or none, got {getattr(self, name)!r}")
        if self.error_limit is not None and not 0 < self.error_limit < math.inf:
            raise ValueError(f"error_limit must be positive, got {self.error_limit}")
        if self.young_epsilon is not None and not 0 <= self.young_epsilon <= 1:
            raise ValueError(f"young_epsilon must lie in [0, 1], got {self.young_epsilon}")
        if self.young_learn_rate is not None and not 0 <= self.young_learn_rate < math.inf:
            raise ValueError(f"young_learn_rate must not be negative, got {self.young_learn_rate}")
        for name in ("epsilon_youth", "learn_rate_youth"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("lingering", "random_share"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name} must lie in [0, 1), got {getattr(self, name)}")
        if not isinstance(self.fixed_motors, tuple):
            raise ValueError(f"fixed_motors must be several numbers, got {self.fixed_motors}")
        if not self.fixed_motors or not all(abs(m) <= 0.5 for m in self.fixed_motors):
            raise ValueError(f"fixed_motors must lie in [-0.5, 0.5], got {self.fixed_motors}")
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                words = " or ".join(map(repr, choices))
                raise ValueError(f"{name} must be {words}, got {getattr(self, name)!r}")

    @property
    def random_ideas(self) -> int:
        """Of the creative proposer's ideas, those that are uniformly random."""
        return min(round(self.random_share * self.ideas), self.ideas - 1)

    @property
    def ages(self) -> bool:
        """Whether a brain changes with its age."""
        return self.young_epsilon is not None or self.young_learn_rate is not None

    @property
    def knows_full_load(self) -> bool:
        """Whether a brain must be told what a full load is."""
        return self.raw_signals or self.raw_reward or self.content_steps > 0

    @property
    def remembers_reward(self) -> bool:
        """Whether a brain must know a step's reward in the next step."""
        return self.next_value_capped or self.reward == "change" or self.lingering > 0

    @property
    def remembers_best(self) -> bool:
        """Whether a brain must know the best action, beside the selected one."""
        return self.action_gap > 0 or "best" in (self.next_value, self.memory_goal)

    def epsilon_at(self, age: int) -> float:
        """Epsilon at such an age."""
        return _aged(self.young_epsilon, self.epsilon, age, self.epsilon_youth)

    def learn_rate_at(self, age: int) -> float:
        """The learn rate at such an age."""
        return _aged(self.young_learn_rate, self.learn_rate, age, self.learn_rate_youth)


def _aged(young: float | None, grown: float, age: int, youth: float) -> float:
    if young is None:
        return grown
    return grown + (young - grown) * math.exp(-age / youth)


# Ours: what it takes for both tasks to be learnt and not forgotten, each with its reason.
STEADY = Parameters(
    # The paper's networks cannot hold what no, weak and full smell ask for at once.
    evaluation_hidden=16,
    memory_hidden=10,
    activation="tanh",
    # Inputs around zero, so that no signal moves all neurons one way.
    centred=True,
    # s / (1 + s) tells 0.90 at the rim from 0.91 inside: raw, arriving is worth the way.
    raw_signals=True,
    raw_reward=True,
    # Coming nearer pays, being near does not: a robot that stays has nothing to unlearn.
    reward="change",
    # What a stray leads to is no fault of the action before; with a gap it would feed itself.
    next_value="best",
    # "No smell" is one state for just lost and never had: it must not promise more than was lost.
    # That a wall can be left again must not make up for touching it.
    next_value_capped=True,
    # In 0.1 s driving and standing differ by less than the network's error: widen the gap.
    action_gap=0.8,
    # Rewards differ by a hundred times between the tasks and over a life: Adam levels the steps.
    optimizer="adam",
    # A long stay rewrites little: after four hours a fifth of the young one is left.
    learn_rate=0.0002,
    young_learn_rate=0.002,
    learn_rate_youth=62400,
    # The memory keeps what is best, not what happened; it need not unlearn.
    memory_goal="best",
    # A memory that has settled proposes one action in many copies: some ideas are from outside.
    random_share=0.32,
    # Single random steps go nowhere: stray walks meet the spot.
    held_steps=15,
    epsilon=0.04,
    young_epsilon=0.3,
    epsilon_youth=24000,
)

# Its ingredients, to be taken away one at a time: the fields that then are the paper's again.
INGREDIENTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "neurons": ("evaluation_hidden", "memory_hidden", "activation"),
        "centred": ("centred",),
        "raw_signals": ("raw_signals",),
        "raw_reward": ("raw_reward",),
        "change": ("reward",),
        "best": ("next_value",),
        "cap": ("next_value_capped",),
        "gap": ("action_gap",),
        "adam": ("optimizer", "learn_rate", "young_learn_rate"),
        "goal": ("memory_goal",),
        "random": ("random_share",),
        "held": ("held_steps",),
        "epsilon": ("epsilon", "young_epsilon"),
    }
)


def _without(ingredient: str) -> Parameters:
    paper = {name: getattr(Parameters(), name) for name in INGREDIENTS[ingredient]}
    return dataclasses.replace(STEADY, **paper)


BRAINS: Mapping[str, Parameters] = MappingProxyType(
    {
        "paper": Parameters(),
        "steady": STEADY,
        **{f"steady-{ingredient}": _without(ingredient) for ingredient in INGREDIENTS},
        # The paper's own remark, that robots would do better if training ended in time: after a
        # minute in the spot.
        "paper-content": Parameters(content_steps=600),
    }
)
