"""How robots stray: for how long, how often, where to; and wrong ways are noticed."""

import pytest
import torch
from scipy import stats

from musebot.controller import Parameters
from musebot.controller.exploration import HeldPair, OneStep, make_exploration

ROBOTS, STEPS, LONGEST = 300, 1500, 30


def walks(exploration, epsilon=0.05):
    """Who strays, shape (T, B), and with which motors, shape (T, B, 2)."""
    proposed = torch.zeros(ROBOTS, 25, 2)
    astray, motors = [], []
    for _ in range(STEPS):
        actions, index = exploration.stray(proposed, epsilon)
        astray.append(index >= 0)
        motors.append(actions[torch.arange(ROBOTS), index])
    return torch.stack(astray), torch.stack(motors)


def complaints(astray, motors, epsilon=0.05):
    """What is wrong with walks of 1 to 30 steps that begin with a probability of epsilon.

    Right ones get a complaint in fewer than 1 of 100 draws.
    """
    found = set()
    new = torch.ones_like(astray)
    new[1:] = ~astray[:-1] | (motors[1:] != motors[:-1]).any(-1)
    first = astray & new
    # A robot is free before a step where the step before was free, or the last of a walk:
    # what follows at once is free, too, and may begin another walk.
    free = first | ~astray
    share = stats.binomtest(int(first[1:].sum()), int(free[1:].sum()), epsilon)
    if share.pvalue < 0.002:
        found.add("how often")
    lengths = []
    for robot in range(ROBOTS):
        starts = first[:, robot].nonzero()[:, 0]
        for start in starts[starts < STEPS - LONGEST - 1]:
            after = free[start + 1 :, robot].long().argmax()
            lengths.append(int(after) + 1)
    counts = torch.tensor(lengths).bincount(minlength=LONGEST + 1)
    if len(counts) > LONGEST + 1 or counts[0] or not _even(counts[1:]):
        found.add("how long")
    pairs = motors[first] + 0.5
    for side in (0, 1):
        if stats.kstest(pairs[:, side].numpy(), "uniform").pvalue < 0.002:
            found.add("where to")
    if abs(stats.pearsonr(*pairs.T.numpy()).statistic) > 0.05:
        found.add("where to")
    return found


def _even(counts):
    return stats.chisquare(counts.numpy()).pvalue > 0.002


def held(seed=3):
    return HeldPair(ROBOTS, LONGEST, torch.Generator().manual_seed(seed))


def test_a_random_pair_is_held_for_1_to_30_steps_and_begins_with_epsilon():
    assert complaints(*walks(held())) == set()


class TooLong(HeldPair):
    """Walks of 2 to 31 steps."""

    def stray(self, actions, epsilon):
        before = self._left.clone()
        actions, index = super().stray(actions, epsilon)
        self._left += ((before == 0) & (index >= 0)).long()
        return actions, index


class OneForAll(HeldPair):
    """Both wheels alike."""

    def stray(self, actions, epsilon):
        actions, index = super().stray(actions, epsilon)
        return actions[..., :1].expand(-1, -1, 2), index


@pytest.mark.parametrize(("wrong", "complaint"), [(TooLong, "how long"), (OneForAll, "where to")])
def test_that_check_complains_of_wrong_walks(wrong, complaint):
    generator = torch.Generator().manual_seed(3)
    assert complaint in complaints(*walks(wrong(ROBOTS, LONGEST, generator)))


def test_that_check_complains_of_another_epsilon():
    assert "how often" in complaints(*walks(held(), 0.055), epsilon=0.05)


def test_the_proposed_actions_stay_what_they_are_and_the_pair_comes_last():
    proposed = torch.rand(ROBOTS, 25, 2) - 0.5
    actions, index = held().stray(proposed, 0.5)
    assert actions.shape == (ROBOTS, 26, 2)
    assert torch.equal(actions[:, :25], proposed)
    assert set(index.tolist()) == {-1, 25}


def test_a_walk_goes_on_where_no_other_may_begin():
    exploration = held()
    proposed = torch.zeros(ROBOTS, 25, 2)
    exploration.stray(proposed, 1.0)
    left = exploration.tensors()["left"].clone()
    going = [int((exploration.stray(proposed, 0.0)[1] >= 0).sum()) for _ in range(LONGEST)]
    assert going == [int((left > step).sum()) for step in range(LONGEST)]
    assert going[-1] == 0


def test_the_papers_exploration_is_one_step_among_the_proposed():
    generator = torch.Generator().manual_seed(0)
    assert isinstance(make_exploration(Parameters(), 3, generator), OneStep)
    assert isinstance(make_exploration(Parameters(held_steps=2), 3, generator), HeldPair)
