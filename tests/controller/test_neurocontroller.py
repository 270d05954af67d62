"""What every brain promises: checkpoints and loading; test_presets has that robots learn apart."""

import pytest
import torch
from helpers import same, snapshot

from musebot.controller import (
    BRAINS,
    PROPOSERS,
    Neurocontroller,
    Parameters,
    Senses,
    Signal,
)
from musebot.controller.creative_memory import NoisePatterns

SENSES = Senses((Signal(0.0, 1.0, 10.0), *[Signal(-1.0, 1.0)] * 4), Signal(0.0, 1.0, 10.0))
READINGS = {
    "noise-held": Parameters(noise_steps=3, ideas=3),
    "noise-for-life": Parameters(noise_steps=0, test_epsilon=0.3),
    "noise-fixed": Parameters(noisy_connections="fixed"),
    "noise-on-biases": Parameters(noise_on_biases=True, keep_main_idea=True),
}
ALL_BRAINS = BRAINS | READINGS
LIVES = [(name, "creative") for name in ALL_BRAINS]
LIVES += [(name, other) for name in ("paper", "steady") for other in ("fixed", "random")]


def states(steps, robots, sensors, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(steps, robots, sensors, generator=generator) * 2 - 1


@pytest.mark.parametrize("name", ["paper", "steady", "recurrent"])
def test_changing_what_was_given_or_returned_does_not_affect_learning(name):
    careful, careless = (
        Neurocontroller(BRAINS[name], "creative", 2, SENSES, seed=3) for _ in range(2)
    )
    for state in states(5, 2, 5):
        careful.act(state.clone(), explore=False)
        sensed, reward = state.clone(), state[:, 0].clone()
        careless.act(sensed, explore=False).fill_(9)
        sensed.fill_(9)
        careful.learn(state[:, 0])
        careless.learn(reward)
        reward.fill_(9)
    assert same(careful.networks(), careless.networks())


# Initial brains, and checkpoints


def test_only_creative_robots_have_a_memory():
    for proposer in PROPOSERS:
        networks = Neurocontroller(Parameters(), proposer, 3, SENSES, seed=1).networks()
        shapes = {name: (*t.shape,) for name, t in networks.items() if "weights" in name}
        memory = {"memory.hidden_weights": (3, 5, 5), "memory.output_weights": (3, 2, 5)}
        assert shapes == {
            "evaluation.hidden_weights": (3, 7, 7),
            "evaluation.output_weights": (3, 1, 7),
            **(memory if proposer == "creative" else {}),
        }


def test_an_unknown_proposer_is_refused_by_name():
    with pytest.raises(ValueError, match="got 'oracle'"):
        Neurocontroller(Parameters(), "oracle", 1, SENSES, seed=1)


def run(brain, sensed, start=0):
    """Lets brains act in tests and in training, and places some of them elsewhere in between."""
    actions = []
    for index, state in enumerate(sensed, start):
        if index % 7 == 3:
            brain.forget_step(torch.tensor([index % 3]))
        actions.append(brain.act(state, explore=index % 2 == 0))
        if index % 5:
            brain.learn(state[:, 0])
    return actions


@pytest.mark.parametrize(("name", "proposer"), LIVES)
def test_a_seed_and_a_checkpoint_determine_the_rest_of_a_life(name, proposer, monkeypatch):
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 6)  # so that the pool is redrawn
    monkeypatch.setattr(NoisePatterns, "POOL", 64)
    sensed = states(26, 3, 5)  # the last step is not learned from
    first, twin, other = (
        Neurocontroller(ALL_BRAINS[name], proposer, 3, SENSES, seed) for seed in (10, 10, 999)
    )
    assert not same(first.networks(), other.networks())
    whole = run(twin, sensed)
    run(other, sensed[:3])
    for start, end in ((0, 1), (1, 6), (6, 17), (17, 25)):
        assert all(map(torch.equal, run(first, sensed[start:end], start), whole[start:end]))
        kept = snapshot(first.state())
        other.load_state(kept)
        assert same(other.state(), kept)
        assert all(map(torch.equal, run(other, sensed[end:], end), whole[end:]))
        assert same(other.state(), twin.state())


def test_a_state_with_a_missing_or_misshapen_tensor_is_refused_and_changes_nothing():
    brain, other = (Neurocontroller(Parameters(), "creative", 3, SENSES, seed) for seed in (10, 11))
    run(brain, states(4, 3, 5))
    before, kept = snapshot(brain.state()), snapshot(other.state())
    for name in kept:
        with pytest.raises(ValueError, match=f"{name} is missing"):
            brain.load_state({k: t for k, t in kept.items() if k != name})
        with pytest.raises(ValueError, match=f"{name} must have shape"):
            brain.load_state(kept | {name: torch.stack([kept[name], kept[name]])})
        assert same(brain.state(), before)


def test_networks_of_another_brain_can_be_loaded():
    brain, other = (Neurocontroller(Parameters(), "creative", 3, SENSES, seed) for seed in (1, 2))
    brain.load_networks(snapshot(other.networks()))
    assert same(brain.networks(), other.networks())
    with pytest.raises(ValueError, match=r"memory\.\w+ is missing"):
        fixed = Neurocontroller(Parameters(), "fixed", 3, SENSES, seed=3)
        brain.load_networks(fixed.networks())
    with pytest.raises(ValueError, match=r"evaluation\.hidden_weights must have shape \(3, 7, 7\)"):
        one = Senses(SENSES.state[:1], SENSES.reward)
        brain.load_networks(Neurocontroller(Parameters(), "creative", 3, one, seed=3).networks())


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_networks_are_loaded_with_their_fixed_noisy_connections(steps):
    parameters = Parameters(noisy_connections="fixed", noise_steps=steps)
    brain, other = (Neurocontroller(parameters, "creative", 3, SENSES, seed) for seed in (1, 2))
    brain.load_networks(snapshot(other.networks()))
    noisy = []
    for patterns in (brain.memory.patterns, other.memory.patterns):
        patterns.renew()
        noisy.append((patterns.draw(75) != 0).view(3, 25, -1).any(dim=1))
    assert noisy[0].sum() == 27 and torch.equal(*noisy)
