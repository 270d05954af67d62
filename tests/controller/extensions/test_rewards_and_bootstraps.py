"""Targets beyond Eq. 1: bootstrap, reward difference, reward decay and advantage learning."""

import dataclasses

import pytest
import torch

from musebot.controller import BRAINS, Neurocontroller, Parameters, Senses, Signal
from musebot.controller.brains import assemble
from musebot.controller.extensions.step import DetailedStep

NOSE = Signal(0.0, 1.0, 10.0)
SPOT = Senses((NOSE,), NOSE)
WALLS = Senses((NOSE,), Signal(-1.0, 0.0))


class Learned:
    """What robots would learn from their rewards, in a brain like `steady`.

    Attributes:
      rewards: r in the target r + gamma V of the last step, shape (B,).
      next_values: V in this target, shape (B,).
      learning: Who learns, shape (B,).
    """

    def __init__(self, robots=1, senses=SPOT, **fields):
        fields = {"advantage_scale": 0.0, **fields}
        # With gamma = 0 the target is r, with gamma = 1 it is r + V.
        self.targets = [
            assemble(
                dataclasses.replace(BRAINS["steady"], discount=discount, **fields),
                *("random", robots, 1, torch.Generator(), senses),
            ).target
            for discount in (0.0, 1.0)
        ]
        self.before, self.now = (DetailedStep(robots, 1) for _ in range(2))

    def step(self, rewards, value=0.0, best_value=0.0, learn=True):
        """Selects actions of such a value, then learns from the rewards if `learn`."""
        self.before, self.now = self.now, self.before
        robots, zeros = len(rewards), torch.zeros(len(rewards), dtype=torch.int64)
        values = torch.tensor([[value, best_value]] * robots)
        self.now.record(torch.zeros(robots, 1), torch.zeros(robots, 2, 2), values, zeros, zeros + 1)
        if not learn:
            return self
        known = self.before.rewarded
        self.rewards, _ = self.targets[0](torch.tensor(rewards), self.before, self.now)
        self.before.rewarded = known
        both, self.learning = self.targets[1](torch.tensor(rewards), self.before, self.now)
        self.next_values = both - self.rewards
        return self


def outcome(nose_before, nose_now, best_value, **fields):
    """The r and V of the target of one robot, whose best next action has such a value."""
    learned = Learned(**fields).step([nose_before]).step([nose_now], best_value=best_value)
    assert learned.learning.tolist() == [1]
    return learned.rewards.item(), learned.next_values.item()


def test_the_reward_is_the_difference_of_the_raw_signals():
    assert outcome(0.5, 10 / 11, 0.7) == pytest.approx((1.0 - 0.1, 0.7))


def test_the_next_value_is_clipped_to_the_lost_reward():
    assert outcome(0.5, 0.0, 0.7) == pytest.approx((-0.1, 0.1))
    assert outcome(0.5, 0.0, 0.05) == pytest.approx((-0.1, 0.05))
    assert outcome(0.5, 0.0, -0.7) == pytest.approx((-0.1, -0.7))
    assert outcome(0.5, 0.0, 0.7, clipped_bootstrap=False) == pytest.approx((-0.1, 0.7))


@pytest.mark.parametrize(("before", "now"), [(0.0, 0.0), (0.6, 0.5), (0.0, 0.5)])
def test_the_next_value_is_not_clipped_unless_the_reward_fell_to_0(before, now):
    assert outcome(before, now, 0.7)[1] == pytest.approx(0.7)


def test_leaving_a_wall_does_not_compensate_for_touching_it():
    learned = Learned(senses=WALLS).step([0.0])
    for contact, expected in (
        (-0.3, (-0.3, 0)),
        (-1.0, (-0.7, 0)),
        (-1.0, (0, 0.7)),
        (0.0, (1, 0.7)),
    ):
        learned.step([contact], best_value=0.7)
        found = learned.rewards.item(), learned.next_values.item()
        assert found == pytest.approx(expected)


def test_the_bootstrap_is_the_value_of_the_best_or_of_the_selected_action():
    for bootstrap, expected in (("max", 0.7), ("on_policy", 0.2)):
        learned = Learned(bootstrap=bootstrap).step([0.5]).step([0.5], value=0.2, best_value=0.7)
        assert learned.next_values.item() == pytest.approx(expected)


def test_without_the_reward_difference_the_reward_is_the_signal():
    assert outcome(0.5, 10 / 11, 0.7, reward_form="signal")[0] == pytest.approx(1.0)
    fields = {"reward_form": "signal", "raw_reward": False}
    assert outcome(0.5, 0.25, 0.7, **fields)[0] == pytest.approx(0.25)


def test_the_difference_is_not_learned_if_the_previous_reward_is_unknown():
    learned = Learned().step([0.5], learn=False).step([0.5])
    assert learned.learning.tolist() == [0]
    assert learned.step([0.5]).learning.tolist() == [1]


# Reward decay


def rewards_of(learned, rewards, placed_before=None, robots=None):
    """The r of each step; before one of the steps robots are placed elsewhere."""
    found = []
    for number, row in enumerate(rewards):
        if number == placed_before:
            learned.now.forget(robots)
        found.append(learned.step(row).rewards.tolist())
    return found


def test_a_decaying_reward_is_lost_gradually_and_gained_at_once():
    noses = [[0.8, 0.0], [0.6, 0.0], [0.0, 0.4], [0.0, 0.4], [0.7, 0.1], [0.0, 0.0]]
    expected = [[-0.2, 0.0], [-0.3, 0.4], [-0.15, 0.0], [0.55, -0.2], [-0.35, -0.1]]
    found = rewards_of(Learned(2, reward_decay=0.5, raw_reward=False), noses)
    assert found[1:] == [pytest.approx(row) for row in expected]


def test_reward_decay_can_be_the_only_extension():
    parameters = Parameters(reward_decay=0.5, discount=0.0)
    target = assemble(parameters, "random", 1, 1, torch.Generator(), None).target
    learned = Learned()
    learned.targets = [target, target]
    found = rewards_of(learned, [[0.8], [0.0], [0.0], [0.4]])
    assert found[1:] == [pytest.approx([x]) for x in (0.4, 0.2, 0.4)]


def test_a_reward_does_not_decay_across_a_placement():
    learned = Learned(2, reward_decay=0.5, raw_reward=False)
    noses = [[0.0, 0.0], [0.8, 0.8], [0.0, 0.0], [0.2, 0.2]]
    found = rewards_of(learned, noses, placed_before=2, robots=torch.tensor([0]))
    assert found[1] == pytest.approx([0.8, 0.8])
    assert found[3] == pytest.approx([0.2, -0.2])


def test_a_reward_does_not_decay_across_steps_without_learning():
    learned = Learned(reward_decay=0.5, raw_reward=False)
    for reward, learn in ((0.8, True), (0.8, True), (0.8, False), (0.1, True), (0.1, True)):
        learned.step([reward], learn=learn)
    assert learned.before.reward.tolist() == [pytest.approx(0.1)]
    assert learned.now.reward.tolist() == [pytest.approx(0.1)]


def test_a_decaying_reward_has_not_fallen_to_0_and_is_not_clipped():
    assert outcome(0.5, 0.0, 0.7, reward_decay=0.5) == pytest.approx((-0.05, 0.7))


def test_negative_rewards_do_not_decay():
    found = rewards_of(Learned(reward_decay=0.9, raw_reward=False), [[0.8], [-1.0], [0.0]])
    assert found[1:] == [pytest.approx([x]) for x in (-1.8, 1.0)]
    generator = torch.Generator().manual_seed(0)
    contacts = -(torch.rand(30, 3, generator=generator) < 0.3).float()
    networks = []
    for decay in (0.0, 0.9):
        parameters = dataclasses.replace(BRAINS["steady"], reward_decay=decay)
        brain = Neurocontroller(parameters, "creative", 3, 1, 1, WALLS)
        for contact in contacts:
            brain.act(contact[:, None], explore=True)
            brain.learn(contact)
        networks.append(brain.networks())
    assert all(torch.equal(tensor, networks[1][name]) for name, tensor in networks[0].items())


# Advantage learning


def test_a_worse_action_is_rewarded_less_by_a_share_of_its_disadvantage():
    learned = Learned(advantage_scale=0.8)
    for _ in range(2):
        learned.step([0.5], value=0.2, best_value=0.7)
    assert learned.rewards.item() == pytest.approx(0.0 - 0.8 * 0.5)


def test_an_exploratory_action_better_than_every_idea_is_not_rewarded_less():
    learned = Learned(advantage_scale=0.8).step([0.5], value=0.7, best_value=0.2)
    assert learned.step([0.5], value=0.2, best_value=0.2).rewards.item() == pytest.approx(0.0)
