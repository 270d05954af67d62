"""The named brains, and the assembly of a brain's parts from its parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType

import torch
from torch import Tensor

from .creative_memory import Lesson, Memory, selected_action
from .evaluation_network import EvaluationNetwork, Target, TDTarget, on_policy, td_error
from .exploration import EpsilonGreedy, Exploration
from .extensions.adam import Adam
from .extensions.bootstraps import ClippedBootstrap, max_value
from .extensions.context import EchoContext
from .extensions.decay import Decay, Schedule
from .extensions.encoding import InputEncoding, RawReward, separated
from .extensions.exploration import PersistentExploration
from .extensions.memory_targets import best_action
from .extensions.rewards import AdvantageLearning, RememberedReward, RewardDifference
from .extensions.step import DetailedStep
from .extensions.stopping import StoppingExploration, StoppingRule, StoppingTarget
from .extensions.td_error import LimitedTDError
from .novelty.assembly import make_creative, make_memory
from .optimizers import SGD
from .parameters import Parameters
from .proposers import PROPOSERS, ActionProposer, FixedActions, RandomActions
from .senses import DirectEncoding, Encoding, Senses
from .step import Step

STEADY = Parameters(
    # The paper's networks are too small for the different actions at no, weak and full smell.
    evaluation_hidden=16,
    memory_hidden=10,
    activation="tanh",
    # Inputs centred at zero: no signal moves all neurons in one direction.
    centred_inputs=True,
    # x / (1 + x) hardly differs near and inside the spot (0.90 and 0.91); the raw x does.
    raw_signals=True,
    raw_reward=True,
    # Approaching is rewarded, staying is not: a robot in the spot has nothing to unlearn.
    reward_form="difference",
    # The outcome of an exploratory action must not lower the value of the action before it. With
    # advantage learning it would do so in every step.
    bootstrap="max",
    # "No smell" is one state whether the smell was just lost or never sensed: its value must not
    # exceed the loss. Leaving a wall must not compensate for touching it.
    clipped_bootstrap=True,
    # Over 0.1 s the values of driving and standing differ by less than the network's error.
    advantage_scale=0.8,
    # Rewards vary by a factor of 100 between tasks and over a life: Adam normalises the steps.
    optimizer="adam",
    # A long stay in the spot must change little: after four hours a fifth of the rate is left.
    learn_rate=0.0002,
    initial_learn_rate=0.002,
    learn_rate_decay_steps=62400,
    # The memory learns the best action, not the selected one, and need not unlearn.
    memory_target="best",
    # A converged memory proposes copies of one action: some ideas must be independent of it.
    random_share=0.32,
    # Single random steps lead nowhere: several in one direction reach the spot.
    exploration_steps=15,
    epsilon=0.04,
    initial_epsilon=0.3,
    epsilon_decay_steps=24000,
)

# The ingredients of STEADY: fields that are reset to the paper's to remove one of them.
INGREDIENTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "hidden_neurons": ("evaluation_hidden", "memory_hidden", "activation"),
        "centred_inputs": ("centred_inputs",),
        "raw_signals": ("raw_signals",),
        "raw_reward": ("raw_reward",),
        "reward_difference": ("reward_form",),
        "max_target": ("bootstrap",),
        "clipped_bootstrap": ("clipped_bootstrap",),
        "advantage": ("advantage_scale",),
        "adam": ("optimizer", "learn_rate", "initial_learn_rate"),
        "best_action_memory": ("memory_target",),
        "random_ideas": ("random_share",),
        "persistent_exploration": ("exploration_steps",),
        "epsilon_decay": ("epsilon", "initial_epsilon"),
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
        "recurrent": dataclasses.replace(STEADY, context_neurons=10),
        # Section 4: robots would do better if training ended in time, here after a minute.
        "paper-stopping": Parameters(stopping_steps=600),
    }
)


@dataclasses.dataclass(frozen=True)
class Parts:
    """The parts of B brains.

    Attributes:
      encoding: Encoding of signals and motor values as network inputs.
      context: Recurrent context that is appended to the network inputs; None if there is none.
      evaluation: Evaluation network.
      step: Class of the steps that a brain remembers until it has learned from them.
      target: Function that computes the target of the value in Eq. 1.
      memory: Creative memory; None if no proposed action comes from one.
      lesson: Function that returns the memory's target action and learn rates; None for a memory
        that does not learn.
      proposer: Action proposer.
      exploration: Source of the exploratory actions.
      epsilon: Probability of an exploratory action.
      learn_rate: Learn rate of the evaluation network.
    """

    encoding: Encoding
    context: EchoContext | None
    evaluation: EvaluationNetwork
    step: type[Step]
    target: Target
    memory: Memory | None
    lesson: Lesson | None
    proposer: ActionProposer
    exploration: Exploration
    epsilon: Schedule
    learn_rate: Schedule


def assemble(
    parameters: Parameters,
    proposer: str,
    robots: int,
    sensors: int,
    generator: torch.Generator,
    senses: Senses | None,
) -> Parts:
    """Assembles the parts of B brains.

    Args:
      parameters: Parameters of the brains.
      proposer: Action proposer, "fixed", "random" or "creative".
      robots: Number B of robots.
      sensors: Number S of sensor signals in a state.
      generator: Random stream of the brains.
      senses: Ranges of the signals; None if they are unknown.

    Raises:
      ValueError: The proposer is unknown, or the parameters need senses that are not given.
    """
    if proposer not in PROPOSERS:
        raise ValueError(f"proposer must be one of {', '.join(PROPOSERS)}, got {proposer!r}")
    p = parameters
    exploration: Exploration = EpsilonGreedy(generator)
    if p.exploration_steps:
        exploration = PersistentExploration(robots, p.exploration_steps, generator)
    encoding: Encoding = DirectEncoding(sensors)
    target = _target(p)
    if p.centred_inputs or p.needs_maximal_smell:
        if senses is None or len(senses.state) != sensors:
            given = "none" if senses is None else len(senses.state)
            raise ValueError(f"senses must give the range of all {sensors} signals, got {given}")
        encoding = InputEncoding(senses, p.centred_inputs, p.raw_signals)
        if p.raw_reward and senses.reward.maximal:
            target = RawReward(target, senses.reward.maximal)
        if p.stopping_steps:
            rule = StoppingRule(robots, p.stopping_steps, senses.reward.saturated)
            target = StoppingTarget(target, rule)
            exploration = StoppingExploration(exploration, rule)
    optimizer = {"sgd": SGD, "adam": Adam}[p.optimizer]
    limited = td_error if p.td_error_limit is None else LimitedTDError(p.td_error_limit)
    context = None
    if p.context_neurons:
        context = EchoContext(robots, encoding.inputs, p.context_neurons, generator)
    inputs = encoding.inputs + p.context_neurons
    evaluation = EvaluationNetwork(p, robots, inputs, generator, optimizer, limited)
    if p.separate_smell and isinstance(encoding, InputEncoding):  # it needs senses
        shape = p.evaluation_hidden, inputs, encoding.smell, inputs + 2
        if (connected := separated(*shape)) is not None:
            evaluation.networks.disconnect(connected)
    memory = None
    if proposer == "creative":
        # Adam normalises the step size and would discard the magnitude of the TD error.
        follower = optimizer if p.memory_target == "best" else SGD
        memory = make_memory(p, robots, inputs, generator, follower)

    def values(state: Tensor, actions: Tensor) -> Tensor:
        return evaluation.values(state, encoding.motors(actions))

    return Parts(
        encoding=encoding,
        context=context,
        evaluation=evaluation,
        step=DetailedStep if _learns_from_details(p) else Step,
        target=target,
        memory=memory,
        lesson=_lesson(p),
        proposer=_proposer(p, proposer, memory, values, generator),
        exploration=exploration,
        epsilon=_schedule(p.initial_epsilon, p.epsilon, p.epsilon_decay_steps),
        learn_rate=_schedule(p.initial_learn_rate, p.learn_rate, p.learn_rate_decay_steps),
    )


def _compares_rewards(p: Parameters) -> bool:
    return p.clipped_bootstrap or p.reward_form == "difference" or p.reward_decay > 0


def _learns_from_details(p: Parameters) -> bool:
    best = p.bootstrap == "max" or p.memory_target == "best" or p.advantage_scale > 0
    return best or _compares_rewards(p)


def _target(p: Parameters) -> Target:
    next_value = max_value if p.bootstrap == "max" else on_policy
    if p.clipped_bootstrap:
        next_value = ClippedBootstrap(next_value)
    target: Target = TDTarget(p.discount, next_value)
    if p.advantage_scale:
        target = AdvantageLearning(target, p.advantage_scale)
    if p.reward_form == "difference":
        target = RewardDifference(target)
    if _compares_rewards(p):
        target = RememberedReward(target, p.reward_decay)
    return target


def _lesson(p: Parameters) -> Lesson | None:
    best = p.memory_target == "best"
    # A memory whose main idea is the only candidate would learn from rounding errors, which Adam
    # turns into steps of full size.
    repeats_itself = best and p.has_one_idea and not p.random_ideas
    if repeats_itself or not p.memory_learns:
        return None
    return best_action if best else selected_action


def _proposer(
    p: Parameters,
    name: str,
    memory: Memory | None,
    values: Callable[[Tensor, Tensor], Tensor],
    generator: torch.Generator,
) -> ActionProposer:
    if name == "fixed":
        return FixedActions(p.fixed_motors)
    if name == "random":
        return RandomActions(p.ideas, generator)
    return make_creative(p, memory, values, generator)


def _schedule(initial: float | None, final: float, steps: float) -> Schedule:
    return Schedule(final) if initial is None else Decay(initial, final, steps)
