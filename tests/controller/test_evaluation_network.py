"""Values of the evaluation network, and who learns; test_brains has Eq. 1."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.controller import EvaluationNetwork, Parameters

quick = settings(max_examples=30)


@quick
@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 30), st.integers(0, 2**31))
def test_values_of_several_actions_equal_the_values_of_single_ones(robots, sensors, count, seed):
    generator = torch.Generator().manual_seed(seed)
    network = EvaluationNetwork(Parameters(), robots, sensors, generator)
    state = torch.rand(robots, sensors, generator=generator) * 2 - 1
    actions = torch.rand(robots, count, 2, generator=generator) - 0.5
    values = network.values(state, actions)
    assert values.shape == (robots, count)
    for index in range(count):
        _, one = network.networks.forward(torch.cat([state, actions[:, index]], dim=1))
        torch.testing.assert_close(values[:, index], one[:, 0], atol=1e-5, rtol=1e-5)


@quick
@given(
    st.sampled_from(["sgd", "adam"]),
    st.lists(st.sampled_from([0.0, 1.0]), min_size=1, max_size=4),
    st.integers(0, 2**31),
)
def test_a_robot_that_does_not_learn_keeps_its_weights_and_does_not_affect_others(name, mask, seed):
    networks = []
    for learning in (torch.tensor(mask), torch.ones(len(mask))):
        generator = torch.Generator().manual_seed(seed)
        network = EvaluationNetwork(Parameters(optimizer=name), len(mask), 3, generator)
        before = network.networks.weights.clone()
        state, target = torch.rand(len(mask), 3, generator=generator), torch.ones(len(mask))
        error = network.learn(state, state[:, :2] - 0.5, target, learning, 0.1)
        networks.append((network.networks.weights, error))
    (weights, error), (all_weights, all_errors) = networks
    for robot, learns in enumerate(mask):
        assert torch.equal(weights[robot], (all_weights if learns else before)[robot])
        assert error[robot] == (all_errors[robot] if learns else 0)
