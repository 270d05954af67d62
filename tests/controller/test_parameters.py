"""The brain's numbers: the paper's by default, and none that makes no sense."""

import dataclasses

import pytest

from musebot.controller import Parameters


def test_the_defaults_are_the_papers_numbers():
    assert dataclasses.asdict(Parameters()) == {
        "evaluation_hidden": 7,  # "seven hidden neurons in the evaluation net"
        "learn_rate": 0.01,  # eta
        "discount": 0.9,  # gamma
        "epsilon": 0.01,
        "test_epsilon": 0.0,
        "fixed_motors": (-0.5, -0.25, 0.0, 0.25, 0.5),
        "ideas": 25,  # "the same number of 25 potential actions"
        "memory_hidden": 5,  # "five in the memory net"
        "noise": 0.76,  # sigma
        "noisy_share": 0.25,  # "noise in a quarter of all connections"
        "noise_on_biases": False,
        "keep_main_idea": False,
        "initial_range": 1.0,  # "from the interval [-1.0, 1.0]"
        "activation": "logistic",  # "neurons with logistic activation function"
        "centred": False,
        "raw_signals": False,
        "raw_reward": False,
        "reward": "signal",  # "reward is identical to specific sensor signals"
        "lingering": 0.0,
        "next_value": "selected",  # SARSA
        "next_value_capped": False,
        "action_gap": 0.0,
        "error_limit": None,
        "optimizer": "plain",
        "memory_goal": "selected",  # "trained with the state-action pair selected"
        "random_share": 0.0,
        "held_steps": 0,
        "young_epsilon": None,
        "epsilon_youth": 24000.0,
        "young_learn_rate": None,
        "learn_rate_youth": 62400.0,
        "content_steps": 0,
    }


NAN, INFINITY = float("nan"), float("inf")
BAD = {
    "evaluation_hidden": (0, -1),
    "ideas": (0, -25, 2.5, "many"),
    "centred": (1, "yes"),
    "memory_hidden": (0, -5),
    "discount": (-0.1, 1.1, NAN, INFINITY),
    "epsilon": (-0.1, 1.1, NAN),
    "test_epsilon": (-0.1, 1.1, NAN),
    "noisy_share": (-0.1, 1.1, NAN),
    "learn_rate": (-0.01, NAN),
    "noise": (-0.76, NAN),
    "initial_range": (-1.0, NAN),
    "action_gap": (-0.1, NAN, INFINITY),
    "error_limit": (0.0, -0.1, NAN, INFINITY),
    "held_steps": (-1,),
    "content_steps": (-1, INFINITY),
    "young_epsilon": (-0.1, 1.1, NAN),
    "young_learn_rate": (-0.1, NAN, INFINITY),
    "epsilon_youth": (0.0, -1.0, NAN, INFINITY),
    "learn_rate_youth": (0.0, -1.0, NAN, INFINITY),
    "lingering": (-0.1, 1.0, NAN),
    "random_share": (-0.1, 1.0, NAN),
    "activation": ("relu", ""),
    "optimizer": ("sgd",),
    "reward": ("none",),
    "next_value": ("worst",),
    "memory_goal": ("worst",),
    "fixed_motors": ((), (0.0, 0.6), (-0.51,), (0.0, NAN), (INFINITY,)),
}


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in BAD.items() for value in values]
)
def test_a_number_that_makes_no_sense_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"^{name} must .*got "):
        Parameters(**{name: value})


@pytest.mark.parametrize(
    "fields",
    [
        {"evaluation_hidden": 1, "ideas": 1, "memory_hidden": 1},
        {"discount": 0.0, "epsilon": 0.0, "noisy_share": 0.0},
        {"discount": 1.0, "epsilon": 1.0, "noisy_share": 1.0},
        {"learn_rate": 0.0, "noise": 0.0, "initial_range": 0.0},
        {"fixed_motors": (-0.5, 0.5)},
    ],
)
def test_the_edges_of_every_range_belong_to_it(fields):
    assert dataclasses.asdict(Parameters(**fields)).items() >= fields.items()


def test_parameters_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Parameters().epsilon = 0.5
