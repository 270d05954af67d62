"""Training that stops after some time at maximal smell."""

import dataclasses

import pytest
import torch
from helpers import same, snapshot

from musebot.controller import BRAINS, Neurocontroller, Parameters, Senses, Signal

ROBOTS = 3
SENSES = Senses((Signal(0.0, 1.0, 10.0), Signal(-1.0, 0.0)), Signal(0.0, 1.0, 10.0))
MAXIMAL = 10 / 11  # the signal at maximal smell


def sensed(steps, seed=0):
    """States of a nose and a contact sensor."""
    generator = torch.Generator().manual_seed(seed)
    nose = torch.rand(steps, ROBOTS, generator=generator) * MAXIMAL
    nose *= torch.rand(steps, ROBOTS, generator=generator) < 0.6
    contact = -(torch.rand(steps, ROBOTS, generator=generator) < 0.3).to(nose.dtype)
    return torch.stack([nose, contact], dim=-1)


def stopping(steps, brain="paper", seed=1, proposer="creative", **fields):
    parameters = dataclasses.replace(BRAINS[brain], stopping_steps=steps, **fields)
    return Neurocontroller(parameters, proposer, ROBOTS, 2, seed, SENSES)


def rewarded(brain, rewards, seed=0):
    """Runs a step for each row of rewards; returns the TD errors."""
    errors = []
    for state, reward in zip(sensed(len(rewards), seed=seed), rewards, strict=True):
        brain.act(state, explore=True)
        errors.append(brain.learn(torch.tensor(reward)))
    return torch.stack(errors)


# In the spot for three steps in a row, for two and two, and beside the spot.
REWARDS = [
    [MAXIMAL, MAXIMAL, 0.909],
    [MAXIMAL, MAXIMAL, 0.909],
    [MAXIMAL, 0.9, 0.909],
    *[[0.1, MAXIMAL, 0.909]] * 2,
]


@pytest.mark.parametrize("name", ["paper", "steady"])
def test_training_stops_after_enough_steps_in_a_row_at_maximal_smell(name):
    brain, other = stopping(3, name), stopping(0, name)
    rewarded(brain, REWARDS), rewarded(other, REWARDS)
    before = snapshot(brain.networks())
    errors = rewarded(brain, [[0.3, 0.3, 0.3]] * 5, seed=1)
    assert torch.equal(errors[:, 0], torch.zeros(5))
    assert errors[:, 1:].abs().min() > 0
    for owner, tensor in brain.networks().items():
        assert torch.equal(tensor[0], before[owner][0])
        assert not torch.equal(tensor[1:], before[owner][1:])
    rewarded(other, [[0.3, 0.3, 0.3]] * 5, seed=1)
    kept = other.networks()["evaluation.output_weights"][0]
    assert not torch.equal(kept, before["evaluation.output_weights"][0])


@pytest.mark.parametrize("exploration_steps", [0, 30])
def test_a_stopped_robot_does_not_explore(exploration_steps):
    brain = stopping(3, proposer="fixed", epsilon=1.0, exploration_steps=exploration_steps)
    rewarded(brain, REWARDS)
    for state in sensed(20, seed=2):
        values = brain.values(state, ideas := brain.propose(state))
        best = ideas[torch.arange(ROBOTS), values.argmax(dim=1)]
        selected = brain.act(state, explore=True)
        assert torch.equal(selected[0], best[0])
        assert not torch.equal(selected[1:], best[1:])


@pytest.mark.parametrize("stopping_steps", [0, 3])
def test_until_training_stops_a_brain_equals_the_papers_bit_exactly(stopping_steps):
    paper = Neurocontroller(Parameters(), "creative", ROBOTS, 2, 1)
    brain = stopping(stopping_steps)
    rewards = [[MAXIMAL, MAXIMAL, 0.3], [0.2, MAXIMAL, MAXIMAL], [0.2, 0.1, MAXIMAL]] * 7
    errors = [rewarded(one, rewards) for one in (paper, brain)]
    assert torch.equal(*errors)
    assert same(paper.networks(), brain.networks())


def test_training_never_stops_if_the_reward_does_not_saturate():
    walls = Senses((Signal(0.0, 1.0), Signal(-1.0, 0.0)), Signal(-1.0, 0.0))
    paper = Neurocontroller(Parameters(), "creative", ROBOTS, 2, 1)
    brain = Neurocontroller(Parameters(stopping_steps=1), "creative", ROBOTS, 2, 1, walls)
    errors = [rewarded(one, [[0.0, -1.0, MAXIMAL]] * 20) for one in (paper, brain)]
    assert torch.equal(*errors)
    assert same(paper.networks(), brain.networks())


def test_a_robot_stays_stopped_when_it_continues_from_a_state():
    first, second = stopping(3), stopping(3, seed=999)
    rewarded(first, REWARDS[:2])
    kept = snapshot(first.state())
    assert kept["exploration.steps_at_maximum"].tolist() == [2, 2, 0]
    second.load_state(kept)
    for brain in (first, second):
        rewarded(brain, REWARDS[2:])
    assert same(first.state(), second.state())
    second.load_state(snapshot(first.state()))
    assert torch.equal(*(rewarded(one, REWARDS)[:, 0] for one in (first, second)))
    assert rewarded(second, REWARDS)[:, 0].abs().max() == 0


def test_a_brain_that_can_stop_needs_senses():
    with pytest.raises(ValueError, match="senses must give the range of all 2 signals, got none"):
        Neurocontroller(BRAINS["paper-stopping"], "creative", ROBOTS, 2, 1)
