"""The recurrent context: its equation, and what a brain with one keeps and learns from."""

import dataclasses

import numpy as np
import pytest
import torch

from musebot.controller import BRAINS, Neurocontroller, Parameters
from musebot.controller.extensions.context import EchoContext
from musebot.controller.senses import Senses, Signal

SENSES = Senses((Signal(0.0, 1.0, 10.0), Signal(-1.0, 1.0)), Signal(0.0, 1.0, 10.0))


def context(robots=3, inputs=2, units=4, seed=1):
    return EchoContext(robots, inputs, units, torch.Generator().manual_seed(seed))


def brain(robots=3, seed=1, **fields):
    parameters = dataclasses.replace(BRAINS["steady"], ideas=5, context_neurons=4, **fields)
    return Neurocontroller(parameters, "creative", robots, 2, seed, SENSES)


def units_of(one):
    assert one._context is not None
    return one._context


def main_idea(one, state):
    assert one.memory is not None
    return one.memory.recall(one._inputs(state))


def sensed(steps, robots=3):
    states = torch.rand(steps, robots, 2, generator=torch.Generator().manual_seed(7))
    states[..., 0] *= 10 / 11
    return states


def test_weights_of_the_inputs_are_drawn_evenly_from_both_signs():
    weights = context(robots=200, inputs=4).weights()["input_weights"] * 4**0.5
    assert weights.abs().max() <= 1 and weights.min() < -0.95 and weights.max() > 0.95
    assert abs(float(weights.mean())) < 0.05


def test_the_units_follow_their_equation_written_in_loops():
    own, random = context(), np.random.default_rng(2)
    weights = {name: tensor.numpy() for name, tensor in own.weights().items()}
    rates = np.geomspace(0.5, 0.005, 4)
    expected = np.zeros((3, 4))
    for _ in range(5):
        inputs = random.uniform(-1, 1, (3, 2)).astype(np.float32)
        before = expected.copy()
        for robot in range(3):
            for i in range(4):
                total = sum(
                    weights["recurrent_weights"][robot, i, j] * before[robot, j] for j in range(4)
                )
                total += sum(
                    weights["input_weights"][robot, i, k] * inputs[robot, k] for k in range(2)
                )
                expected[robot, i] += rates[i] * (np.tanh(total) - before[robot, i])
        own.advance(torch.from_numpy(inputs))
    np.testing.assert_allclose(own.values.numpy(), expected, atol=1e-6)
    joined = own.joined(torch.from_numpy(inputs))
    assert torch.equal(joined[:, :2], torch.from_numpy(inputs))
    assert torch.equal(joined[:, 2:], own.values)


@pytest.mark.parametrize("units", [1, 4, 30])
def test_every_robots_connections_have_the_spectral_radius(units):
    recurrent = context(units=units).weights()["recurrent_weights"].numpy()
    radii = np.abs(np.linalg.eigvals(recurrent)).max(axis=1)
    np.testing.assert_allclose(radii, 0.9, rtol=1e-4)


def test_what_was_sensed_fades():
    """Two robots that sensed different things become equal when they sense the same."""
    own = context(robots=2)
    for tensor in own.weights().values():
        tensor[1] = tensor[0]
    own.advance(torch.tensor([[1.0, -1.0], [-1.0, 1.0]]))
    apart = [(own.values[0] - own.values[1]).abs().max().item()]
    for _ in range(3000):
        own.advance(torch.zeros(2, 2))
        apart.append((own.values[0] - own.values[1]).abs().max().item())
    assert apart[0] > 0.1 and apart[-1] < 0.01 * apart[0]


def test_a_brain_without_context_is_as_before():
    assert dataclasses.replace(BRAINS["recurrent"], context_neurons=0) == BRAINS["steady"]
    names = Neurocontroller(BRAINS["steady"], "creative", 3, 2, 1, SENSES).state()
    assert not [name for name in names if name.startswith("context")]


def test_both_networks_receive_the_context():
    one = brain()
    state = sensed(1)[0]
    action = torch.full((3, 1, 2), 0.1)
    values, main = one.values(state, action), main_idea(one, state)
    units_of(one).values += 0.5
    assert not torch.equal(one.values(state, action), values)
    assert not torch.equal(main_idea(one, state), main)


def test_asking_for_values_and_ideas_does_not_advance_the_context():
    one = brain()
    state = sensed(1)[0]
    for _ in range(2):
        one.propose(state)
        one.values(state, torch.zeros(3, 1, 2))
    assert not units_of(one).values.any()
    one.act(state, explore=False)
    assert units_of(one).values.all()


def test_the_context_is_what_was_sensed_before_the_present_step():
    one, other = brain(), brain()
    states = sensed(4)
    for state in states[:3]:
        one.act(state, explore=False)
        other.act(state, explore=False)
    before = units_of(one).values.clone()
    one.act(states[3], explore=False)
    other.act(1 - states[3], explore=False)
    assert torch.equal(one._now.state[:, -4:], before)
    assert torch.equal(other._now.state[:, -4:], before)


def test_a_brain_with_context_continues_bit_exactly_from_its_state():
    def run(one, states):
        actions = []
        for state in states:
            actions.append(one.act(state, explore=True))
            one.learn(state[:, 0])
        return torch.stack(actions)

    first, second = brain(), brain(seed=9)
    run(first, sensed(20))
    run(second, sensed(3))
    second.load_state({name: tensor.clone() for name, tensor in first.state().items()})
    assert torch.equal(run(first, sensed(15)), run(second, sensed(15)))
    assert torch.equal(units_of(first).values, units_of(second).values)


def test_the_connections_are_stored_with_the_networks_and_never_learn():
    one, other = brain(), brain(seed=5)
    kept = {name: tensor.clone() for name, tensor in one.networks().items()}
    assert {"context.recurrent_weights", "context.input_weights"} < kept.keys()
    for state in sensed(30):
        one.act(state, explore=True)
        one.learn(state[:, 0])
    for name, tensor in one.networks().items():
        assert torch.equal(tensor, kept[name]) is name.startswith("context."), name
    other.load_networks(kept)
    assert torch.equal(units_of(other).weights()["recurrent_weights"],
                       kept["context.recurrent_weights"])  # fmt: skip


def test_robots_do_not_share_a_context():
    one, other = brain(), brain()
    for state in sensed(20):
        changed = state.clone()
        changed[1] = 0.9 - changed[1]
        one.act(state, explore=False)
        other.act(changed, explore=False)
    same = (units_of(one).values == units_of(other).values).all(dim=1)
    assert same.tolist() == [True, False, True]


@pytest.mark.parametrize("units", [-1, 101, 1.5])
def test_a_context_of_an_impossible_size_is_refused(units):
    with pytest.raises(ValueError, match="context_neurons must"):
        Parameters(context_neurons=units)
