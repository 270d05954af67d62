"""The named brains: `paper`, `steady`, `constant`, `recurrent`, `steady` minus an ingredient."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from .parameters import Parameters

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
    # "No smell" is one state, whether the smell was just lost or never there: its value must not
    # make up for the loss. Nor must leaving a wall make up for touching it.
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

# In a life that changes, learning and exploration must not end. The learn rate is the best of three
# in the life `senses` (docs/studies/adaptation.md).
_CONSTANT = dataclasses.replace(
    STEADY, learn_rate=0.0006, initial_learn_rate=None, initial_epsilon=None
)

# The ingredients of STEADY, and the fields that are reset to the paper's values to remove each.
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
        "constant": _CONSTANT,
        **{f"steady-{ingredient}": _without(ingredient) for ingredient in INGREDIENTS},
        "recurrent": dataclasses.replace(STEADY, context_neurons=10),
    }
)
