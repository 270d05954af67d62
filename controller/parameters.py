"""The parameters of a brain, with their ranges; the defaults are the paper's."""

from __future__ import annotations

import dataclasses
from typing import Literal

from ..fields import Checked, choice, flag, number, numbers, whole

ActivationName = Literal["logistic", "tanh"]
RewardForm = Literal["signal", "difference"]
Bootstrap = Literal["on_policy", "max"]
OptimizerName = Literal["sgd", "adam"]
MemoryTarget = Literal["selected", "best"]
NoisyConnections = Literal["anew", "fixed"]
PROPOSERS = ("fixed", "random", "creative")

# Far beyond useful values: a larger number is a typing error, and would hang or overflow.
_MOST_IDEAS, _MOST_NEURONS, _MOST_STEPS = 10_000, 1000, 10**6
_LARGEST, _LONGEST = 1000, 10**9
# Numba can compile the paper's brain with other values of these fields.
_COMPILED = ("evaluation_hidden", "learn_rate", "discount", "epsilon", "fixed_motors", "ideas")
_COMPILED += ("memory_hidden", "noise", "noisy_share", "noisy_connections", "initial_range")


@dataclasses.dataclass(frozen=True)
class Parameters(Checked):
    """The parameters of a brain.

    The fields up to `initial_range` are the paper's. The fields from `activation` on go beyond the
    paper; each can be changed alone. Steps are control steps.

    Attributes:
      evaluation_hidden: Number of hidden neurons of the evaluation network (section 3).
      learn_rate: Learn rate eta of the evaluation network (Eq. 1, section 3).
      discount: Discount factor gamma of V(t + 1) in Eq. 1 (section 3).
      epsilon: Probability that a robot which is not exploring begins an exploratory action in a
        step of training (section 3).
      test_epsilon: The same probability in the tests before and after training
        (not stated in the paper).
      fixed_motors: Motor values whose pairs (left, right) are the fixed proposer's actions
        (section 3).
      ideas: Number of actions proposed per step by the random and the creative proposer
        (section 3).
      memory_hidden: Number of hidden neurons of the creative memory (section 3).
      noise: Constant sigma that is added to or subtracted from a noisy connection (section 3).
      noisy_share: Share of the memory's connections that are noisy in an idea; "a quarter" in the
        paper (section 3). The number of noisy connections is rounded to the nearest whole number.
        It is at least 1 if the share is above 0.
      noisy_connections: Which connections are noisy. "anew": drawn for each idea. "fixed": drawn
        once for each robot; each idea then draws only the signs of the noise (docs/paper.md).
      noise_steps: Number of steps for which the ideas keep their noise (not stated in the paper):
        1 for new noise in every step, 0 for the same noise for life. Stored networks do not contain
        the noise; a brain that loads them draws its own.
      noise_on_biases: Whether biases, too, can be noisy (not stated in the paper).
      keep_main_idea: Whether the first idea is the memory's output without noise (not stated in
        the paper).
      initial_range: Half-width of the interval from which weights and biases are drawn,
        [-initial_range, initial_range] (section 3.1).
      activation: Activation function of the hidden neurons, "logistic" (section 3) or "tanh".
      centred_inputs: Whether all network inputs, motor values included, are scaled to [-1, 1].
      raw_signals: Whether the networks also receive the raw value x of each saturating signal
        x / (1 + x), such as smell. As an input, x is scaled to 1 at maximal smell.
      raw_reward: Whether a saturating reward is replaced by its raw value, scaled to 1 at maximal
        smell.
      reward_form: Reward from which the brain learns: the "signal" itself (section 2), or its
        "difference" from the previous step.
      bootstrap: Action whose value is V at t + 1 in Eq. 1: the selected one ("on_policy") or the
        best of the proposed ones ("max").
      clipped_bootstrap: Whether V at t + 1 is clipped to max(r(t), 0) in a step in which the
        reward fell to 0 or below.
      advantage_scale: Factor alpha of advantage learning, r <- r - alpha (V_best - V_selected),
        with the values of the best and the selected action; 0 for none.
      optimizer: Optimizer of the networks, "sgd" (Eq. 1) or "adam"; the memory uses "adam" only
        with `memory_target` "best".
      memory_target: Action that the memory learns: the "selected" one, with the TD error as learn
        rate (section 3), or the "best" of the proposed ones, with `learn_rate`.
      random_share: Share of the creative proposer's ideas that are drawn uniformly at random; their
        number is rounded to the nearest whole number; at least one idea is from the memory.
      exploration_steps: Longest duration in steps of an exploratory action. Above 0: a random
        motor pair, held for 1 to `exploration_steps` steps. At 0: one of the proposed actions, for
        one step (section 2).
      initial_epsilon: Epsilon when training starts, from which it decays to `epsilon`; None for
        no decay.
      epsilon_decay_steps: Time constant of the decay of epsilon, in steps of training.
      initial_learn_rate: Learn rate when training starts, from which it decays to `learn_rate`;
        None for no decay.
      learn_rate_decay_steps: Time constant of the decay of the learn rate, in steps of training.
      context_neurons: Number of units of the recurrent context, an echo state network; 0 for no
        context. The values of the units are further inputs of both networks.
    """

    evaluation_hidden: int = whole(7, 1, _MOST_NEURONS)
    learn_rate: float = number(0.01, 0, _LARGEST)
    discount: float = number(0.9, 0, 1)
    epsilon: float = number(0.01, 0, 1)
    test_epsilon: float = number(0.0, 0, 1)
    fixed_motors: tuple[float, ...] = numbers((-0.5, -0.25, 0.0, 0.25, 0.5), -0.5, 0.5, 100)
    ideas: int = whole(25, 1, _MOST_IDEAS)
    memory_hidden: int = whole(5, 1, _MOST_NEURONS)
    noise: float = number(0.76, 0, _LARGEST)
    noisy_share: float = number(0.25, 0, 1)
    noisy_connections: NoisyConnections = choice("anew", NoisyConnections)
    noise_steps: int = whole(1, 0, _MOST_STEPS, unit="steps")
    noise_on_biases: bool = flag(False)
    keep_main_idea: bool = flag(False)
    initial_range: float = number(1.0, 0, _LARGEST)

    activation: ActivationName = choice("logistic", ActivationName)
    centred_inputs: bool = flag(False)
    raw_signals: bool = flag(False)
    raw_reward: bool = flag(False)
    reward_form: RewardForm = choice("signal", RewardForm)
    bootstrap: Bootstrap = choice("on_policy", Bootstrap)
    clipped_bootstrap: bool = flag(False)
    advantage_scale: float = number(0.0, 0, _LARGEST)
    optimizer: OptimizerName = choice("sgd", OptimizerName)
    memory_target: MemoryTarget = choice("selected", MemoryTarget)
    random_share: float = number(0.0, 0, 1, "[)")
    exploration_steps: int = whole(0, 0, _MOST_STEPS, unit="steps")
    initial_epsilon: float | None = number(None, 0, 1)
    epsilon_decay_steps: float = number(24000.0, 0, _LONGEST, "(]", unit="steps")
    initial_learn_rate: float | None = number(None, 0, _LARGEST)
    learn_rate_decay_steps: float = number(62400.0, 0, _LONGEST, "(]", unit="steps")
    context_neurons: int = whole(0, 0, 100)

    @property
    def random_ideas(self) -> int:
        """Number of the creative proposer's ideas that are uniformly random."""
        return min(round(self.random_share * self.ideas), self.ideas - 1)

    @property
    def own_ideas(self) -> int:
        """Number of the creative proposer's ideas that are not uniformly random, at least 1."""
        return self.ideas - self.random_ideas

    @property
    def repeats_itself(self) -> bool:
        """Whether the memory would learn its own output, because no noise changes its ideas.

        The memory then does not learn: Adam would turn rounding errors into full steps.
        """
        noisy = self.noise > 0 and self.noisy_share > 0
        alone = not noisy or self.keep_main_idea and self.own_ideas == 1
        return self.memory_target == "best" and alone and not self.random_ideas

    @property
    def compilable(self) -> bool:
        """Whether Numba computes this brain: only fields in `_COMPILED` differ from the paper's."""
        own = {name: getattr(self, name) for name in _COMPILED}
        return dataclasses.replace(Parameters(), **own) == self

    @property
    def compares_rewards(self) -> bool:
        """Whether Eq. 1's target needs the reward of the previous step."""
        return self.clipped_bootstrap or self.reward_form == "difference"

    @property
    def needs_best(self) -> bool:
        """Whether the brain learns from the best proposed action, not only the selected one."""
        return self.bootstrap == "max" or self.memory_target == "best" or self.advantage_scale > 0
