"""Duration, frequency and distribution of persistent exploratory actions."""

import pytest
import torch
from scipy import stats

from musebot.controller.extensions.exploration import PersistentExploration

ROBOTS, STEPS, LONGEST = 300, 1500, 30


def walks(exploration, epsilon=0.05):
    """Which robots explore, shape (T, B), and their motor values, shape (T, B, 2)."""
    ideas = torch.zeros(ROBOTS, 25, 2)
    exploring, motors = [], []
    for _ in range(STEPS):
        actions, index = exploration.draw(ideas, epsilon)
        exploring.append(index >= 0)
        motors.append(actions[torch.arange(ROBOTS), index])
    return torch.stack(exploring), torch.stack(motors)


def deviations(exploring, motors, epsilon=0.05):
    """Finds deviations from walks of 1 to 30 steps that start with probability epsilon.

    A correct exploration deviates in fewer than 1 of 100 draws.
    """
    found = set()
    new = torch.ones_like(exploring)
    new[1:] = ~exploring[:-1] | (motors[1:] != motors[:-1]).any(-1)
    first = exploring & new
    # A robot is free to start a walk if it was greedy in the step before or ended a walk in it.
    free = first | ~exploring
    share = stats.binomtest(int(first[1:].sum()), int(free[1:].sum()), epsilon)
    if share.pvalue < 0.002:
        found.add("frequency")
    lengths = []
    for robot in range(ROBOTS):
        starts = first[:, robot].nonzero()[:, 0]
        for start in starts[starts < STEPS - LONGEST - 1]:
            after = free[start + 1 :, robot].long().argmax()
            lengths.append(int(after) + 1)
    counts = torch.tensor(lengths).bincount(minlength=LONGEST + 1)
    if len(counts) > LONGEST + 1 or counts[0] or not _even(counts[1:]):
        found.add("duration")
    pairs = motors[first] + 0.5
    for side in (0, 1):
        if stats.kstest(pairs[:, side].numpy(), "uniform").pvalue < 0.002:
            found.add("distribution")
    if abs(stats.pearsonr(*pairs.T.numpy()).statistic) > 0.05:
        found.add("distribution")
    return found


def _even(counts):
    return stats.chisquare(counts.numpy()).pvalue > 0.002


def persistent(seed=3):
    return PersistentExploration(ROBOTS, LONGEST, torch.Generator().manual_seed(seed))


def test_a_random_pair_is_kept_for_1_to_30_steps_and_starts_with_epsilon():
    assert deviations(*walks(persistent())) == set()


class TooLong(PersistentExploration):
    """Walks of 2 to 31 steps."""

    def draw(self, actions, epsilon):
        before = self._left.clone()
        actions, index = super().draw(actions, epsilon)
        self._left += ((before == 0) & (index >= 0)).long()
        return actions, index


class EqualMotors(PersistentExploration):
    """Equal motor values for both wheels."""

    def draw(self, actions, epsilon):
        actions, index = super().draw(actions, epsilon)
        return actions[..., :1].expand(-1, -1, 2), index


@pytest.mark.parametrize(
    ("wrong", "deviation"), [(TooLong, "duration"), (EqualMotors, "distribution")]
)
def test_the_check_detects_wrong_walks(wrong, deviation):
    generator = torch.Generator().manual_seed(3)
    assert deviation in deviations(*walks(wrong(ROBOTS, LONGEST, generator)))


def test_the_check_detects_another_epsilon():
    assert "frequency" in deviations(*walks(persistent(), 0.055), epsilon=0.05)


def test_the_ideas_are_unchanged_and_the_pair_comes_last():
    ideas = torch.rand(ROBOTS, 25, 2) - 0.5
    actions, index = persistent().draw(ideas, 0.5)
    assert actions.shape == (ROBOTS, 26, 2)
    assert torch.equal(actions[:, :25], ideas)
    assert set(index.tolist()) == {-1, 25}


def test_a_walk_continues_when_epsilon_falls_to_zero():
    exploration = persistent()
    ideas = torch.zeros(ROBOTS, 25, 2)
    exploration.draw(ideas, 1.0)
    left = exploration.tensors()["left"].clone()
    going = [int((exploration.draw(ideas, 0.0)[1] >= 0).sum()) for _ in range(LONGEST)]
    assert going == [int((left > step).sum()) for step in range(LONGEST)]
    assert going[-1] == 0
