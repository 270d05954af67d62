"""The parameters of a brain: the paper's by default, and their ranges."""

import dataclasses

import numpy as np
import pytest

from musebot.controller import Parameters


def test_the_defaults_are_the_papers_parameters():
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
        "noise_steps": 1,
        "novelty": "connections",
        "memory_learns": True,
        "noise_adaptation": 0.0,
        "context_neurons": 0,
        "separate_smell": False,
        "noise_on_biases": False,
        "keep_main_idea": False,
        "initial_range": 1.0,  # "from the interval [-1.0, 1.0]"
        "activation": "logistic",  # "neurons with logistic activation function"
        "centred_inputs": False,
        "raw_signals": False,
        "raw_reward": False,
        "reward_form": "signal",  # "reward is identical to specific sensor signals"
        "reward_decay": 0.0,
        "bootstrap": "on_policy",  # SARSA
        "clipped_bootstrap": False,
        "advantage_scale": 0.0,
        "td_error_limit": None,
        "optimizer": "sgd",
        "memory_target": "selected",  # "trained with the state-action pair selected"
        "random_share": 0.0,
        "exploration_steps": 0,
        "initial_epsilon": None,
        "epsilon_decay_steps": 24000.0,
        "initial_learn_rate": None,
        "learn_rate_decay_steps": 62400.0,
        "stopping_steps": 0,
    }


NAN, INFINITY = float("nan"), float("inf")
BAD = {
    "evaluation_hidden": (0, -1, 1001, 10**9, True),
    "noise_steps": (-1, 1.5, True, 10**7),
    "ideas": (0, -25, 2.5, "many", 10_001, 10**9),
    "centred_inputs": (1, "yes"),
    "memory_hidden": (0, -5, 1001),
    "discount": (-0.1, 1.1, NAN, INFINITY),
    "epsilon": (-0.1, 1.1, NAN),
    "test_epsilon": (-0.1, 1.1, NAN),
    "noisy_share": (-0.1, 1.1, NAN),
    "learn_rate": (-0.01, NAN, INFINITY, 1001, 1e30, 10**400),
    "noise": (-0.76, NAN, INFINITY, 1001),
    "initial_range": (-1.0, NAN, INFINITY, 1e39),
    "advantage_scale": (-0.1, NAN, INFINITY, 1001),
    "td_error_limit": (0.0, -0.1, NAN, INFINITY, 1001),
    "exploration_steps": (-1, 10**6 + 1, 10**30),
    "stopping_steps": (-1, INFINITY, 10**6 + 1),
    "initial_epsilon": (-0.1, 1.1, NAN),
    "initial_learn_rate": (-0.1, NAN, INFINITY, 1001),
    "epsilon_decay_steps": (0.0, -1.0, NAN, INFINITY, 1e10),
    "learn_rate_decay_steps": (0.0, -1.0, NAN, INFINITY, 1e10),
    "reward_decay": (-0.1, 1.0, NAN),
    "random_share": (-0.1, 1.0, NAN),
    "activation": ("relu", ""),
    "optimizer": ("plain", None),
    "reward_form": ("none",),
    "bootstrap": ("worst",),
    "memory_target": ("worst",),
    "fixed_motors": (
        (),
        (0.0, 0.6),
        (-0.51,),
        (0.0, NAN),
        (INFINITY,),
        [0.0],
        0.0,
        ("a",),
        (0,) * 101,
    ),
}


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in BAD.items() for value in values]
)
def test_a_value_out_of_range_is_refused_by_name(name, value):
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
def test_closed_ranges_include_their_ends(fields):
    assert dataclasses.asdict(Parameters(**fields)).items() >= fields.items()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("epsilon", 2, "epsilon must lie in [0, 1], got 2"),
        ("reward_decay", 1.0, "reward_decay must lie in [0, 1), got 1.0"),
        ("noise", -1, "noise must lie in [0, 1000], got -1"),
        ("td_error_limit", 0, "td_error_limit must lie in (0, 1000] or be none, got 0"),
        ("ideas", 2.5, "ideas must be a whole number from 1 to 10000, got 2.5"),
        ("raw_reward", 1, "raw_reward must be true or false, got 1"),
        ("ideas", 10**400, f"ideas must be a whole number from 1 to 10000, got 1{'0' * 56}..."),
        pytest.param(
            "ideas",
            10**5000,
            "ideas must be a whole number from 1 to 10000, got a number of too many digits",
            id="digits",
        ),
        ("optimizer", "plain", "optimizer must be 'sgd' or 'adam', got 'plain'"),
        (
            "fixed_motors",
            (0.6,),
            "fixed_motors must be 1 to 100 numbers, all of which lie in [-0.5, 0.5], got (0.6,)",
        ),
    ],
)
def test_an_error_names_the_field_its_range_and_the_value(name, value, message):
    with pytest.raises(ValueError) as error:
        Parameters(**{name: value})
    assert str(error.value) == message


@pytest.mark.parametrize(("count", "random"), [(25, 8), (9, 3), (5, 2), (3, 1), (1, 0)])
def test_the_random_ideas_are_rounded_and_leave_one_idea_to_the_memory(count, random):
    assert Parameters(ideas=count, random_share=0.32).random_ideas == random
    assert Parameters(ideas=count, random_share=0.99).random_ideas == count - 1


def test_numbers_of_numpy_become_pythons():
    own = Parameters(epsilon=np.float64(0.5), ideas=np.int64(3), raw_signals=np.bool_(True))
    assert own == Parameters(epsilon=0.5, ideas=3, raw_signals=True)
    assert [type(x) for x in (own.epsilon, own.ideas, own.raw_signals)] == [float, int, bool]


def test_parameters_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Parameters().epsilon = 0.5
