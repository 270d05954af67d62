"""Selection: epsilon-greedy, persistent exploration, and the decay of epsilon and learn rate."""

import math

import pytest
import torch
from helpers import unit_senses
from scipy import stats

from musebot.controller import Neurocontroller, Parameters
from musebot.controller.exploration import PersistentExploration, Schedule

# Epsilon-greedy

MOTORS = torch.tensor(Parameters().fixed_motors)
GRID = torch.cartesian_prod(MOTORS, MOTORS)


def exploratory(steps, robots=2000, explore=True, **fields):
    """Which selected fixed actions are not the best, shape (T, B), and which action was selected.

    Robots sense new random signals in every step.
    """
    brain = Neurocontroller(Parameters(**fields), "fixed", robots, unit_senses(5), seed=6)
    generator = torch.Generator().manual_seed(0)
    found, chosen = [], []
    for _ in range(steps):
        state = torch.rand(robots, 5, generator=generator) * 2 - 1
        best = brain.values(state, GRID.expand(robots, -1, -1)).argmax(dim=1)
        selected = (brain.act(state, explore)[:, None] == GRID).all(-1).long().argmax(dim=1)
        found.append(selected != best)
        chosen.append(selected)
    return torch.stack(found), torch.stack(chosen)


def test_without_exploration_or_epsilon_the_best_action_is_selected():
    assert not exploratory(5, explore=False, epsilon=1.0)[0].any()
    assert not exploratory(5, epsilon=0.0)[0].any()


@pytest.mark.parametrize(
    ("fields", "share"),
    [
        ({"epsilon": 0.01}, 0.01),
        ({"epsilon": 0.3}, 0.3),
        ({"test_epsilon": 0.3, "explore": False}, 0.3),
    ],
)
def test_a_share_of_epsilon_of_the_actions_is_exploratory(fields, share):
    count = int(exploratory(20, **fields)[0].sum())
    # One of 25 exploratory actions is the best one.
    assert stats.binomtest(count, 20 * 2000, share * 24 / 25).pvalue > 0.001
    assert stats.binomtest(count, 20 * 2000, share * 0.6).pvalue < 0.001


def test_exploratory_actions_are_uniform_and_robots_explore_independently():
    _, chosen = exploratory(1, robots=5000, epsilon=1.0)
    assert stats.chisquare(chosen.flatten().bincount(minlength=25).numpy()).pvalue > 0.001
    counts = exploratory(30, robots=1000, epsilon=0.5)[0].sum(dim=1)
    share = 0.5 * 24 / 25
    squares = ((counts - 1000 * share) ** 2).sum() / (1000 * share * (1 - share))
    assert 0.001 < stats.chi2(30).cdf(float(squares)) < 0.999


# Persistent exploration

ROBOTS, STEPS, LONGEST, EPSILON = 300, 1500, 30, 0.05
IDEAS = torch.full((ROBOTS, 25, 2), 0.25)


def persistent():
    return PersistentExploration(ROBOTS, LONGEST, torch.Generator().manual_seed(3))


def test_a_random_pair_is_kept_for_1_to_30_steps_and_starts_with_epsilon():
    exploration = persistent()
    drawn = [exploration.draw(IDEAS, EPSILON) for _ in range(STEPS)]
    exploring = torch.stack([index >= 0 for _, index in drawn])
    assert all(torch.equal(actions[:, :-1], IDEAS) for actions, _ in drawn)
    motors = torch.stack([actions[torch.arange(ROBOTS), index] for actions, index in drawn])
    new = torch.ones_like(exploring)
    new[1:] = ~exploring[:-1] | (motors[1:] != motors[:-1]).any(-1)
    first = exploring & new
    # A robot is free to start a walk if it was greedy in the step before or ended a walk in it.
    free = first | ~exploring
    starts = stats.binomtest(int(first[1:].sum()), int(free[1:].sum()), EPSILON)
    assert starts.pvalue > 0.002
    lengths = []
    for robot, start in first[: STEPS - LONGEST - 1].T.nonzero().tolist():
        lengths.append(int(free[start + 1 :, robot].long().argmax()) + 1)
    counts = torch.tensor(lengths).bincount(minlength=LONGEST + 1)
    assert len(counts) == LONGEST + 1 and counts[0] == 0
    assert stats.chisquare(counts[1:].numpy()).pvalue > 0.002
    left, right = (motors[first] + 0.5).T.numpy()
    assert min(stats.kstest(side, "uniform").pvalue for side in (left, right)) > 0.002
    assert abs(stats.pearsonr(left, right).statistic) < 0.05


def test_a_walk_continues_when_epsilon_falls_to_zero():
    exploration = persistent()
    exploration.draw(IDEAS, 1.0)
    left = exploration.tensors()["left"].clone()
    going = [int((exploration.draw(IDEAS, 0.0)[1] >= 0).sum()) for _ in range(LONGEST)]
    assert going == [int((left > step).sum()) for step in range(LONGEST)]
    assert going[-1] == 0


# Decay


@pytest.mark.parametrize("age", [0, 1, 24000, 10**7])
def test_a_schedule_decays_exponentially_or_is_constant(age):
    decaying, constant = Schedule(0.04, 0.3, 24000), Schedule(0.04, None, 24000)
    for schedule in (decaying, constant):
        schedule.update(age)
    assert decaying.value == pytest.approx(0.04 + 0.26 * math.exp(-age / 24000))
    assert constant.value == 0.04


def test_on_another_device_a_decaying_value_is_a_tensor_that_keeps_its_place():
    """A recorded step reads it where it was when the step was recorded."""
    with torch.device("meta"):
        decaying, constant = Schedule(0, 1, 10.0), Schedule(0.04, None, 10.0)
    place = decaying.value
    for age in (0, 1, 10**7):
        decaying.update(age)
        assert decaying.value is place
    assert place.device.type == "meta" and place.dtype == torch.float32
    assert constant.value == 0.04
