"""The brain beyond the paper: each step of it against autograd and torch's Adam, and alone."""

import dataclasses
import math
import re
from pathlib import Path

import pytest
import torch

from musebot.controller import (
    BRAINS,
    INGREDIENTS,
    Neurocontroller,
    NoisePatterns,
    Parameters,
    Senses,
    Signal,
)

STEADY = BRAINS["steady"]
SENSES = Senses((Signal(0.0, 1.0, 10.0), Signal(-1.0, 0.0)), Signal(0.0, 1.0, 10.0))
WALLS = Senses(SENSES.state, Signal(-1.0, 0.0))
ROBOTS = 3
FULL = 10 / 11  # the signal of a full load


@pytest.fixture
def double_precision():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def born(seed=1, proposer="creative", robots=ROBOTS, senses=SENSES, **fields):
    parameters = dataclasses.replace(STEADY, **fields)
    return Neurocontroller(parameters, proposer, robots, 2, seed, senses)


def sensed(steps, robots=ROBOTS, seed=0):
    """States of a nose and a contact sensor; the nose often smells nothing."""
    generator = torch.Generator().manual_seed(seed)
    nose = torch.rand(steps, robots, generator=generator) * 10 / 11
    nose *= torch.rand(steps, robots, generator=generator) < 0.6
    contact = -(torch.rand(steps, robots, generator=generator) < 0.3).to(nose.dtype)
    return torch.stack([nose, contact], dim=-1)


def snapshot(tensors):
    return {name: tensor.clone() for name, tensor in tensors.items()}


def same(first, second):
    return first.keys() == second.keys() and all(torch.equal(first[k], second[k]) for k in first)


def live(brain, states):
    actions = []
    for state in states:
        actions.append(brain.act(state, explore=True))
        brain.learn(state[:, 0])
    return actions


# The sequence of a step


class SlowBrain:
    """One robot's networks, one after the other as the rule is written down.

    On arriving in x' with rho': delta = rho' - rho + gamma v' - Q(x, a) - kappa (best - mine),
    where v' is the best that Q promises in x' among the ideas there, at most rho, or nothing,
    where it has fallen to nothing or below, and best and mine are those of x when a was chosen.
    Adam moves Q along delta grad Q(x, a), and the memory towards the best idea of x.
    """

    def __init__(self, brain, robot, parameters, walls):
        own = {name: tensor[robot].clone() for name, tensor in brain.networks().items()}
        self.p = parameters
        self.walls = walls
        self.age = 0
        self.q, self.memory = (
            {k.split(".")[1]: t for k, t in own.items() if k.startswith(owner)}
            for owner in ("evaluation", "memory")
        )
        self.adams = []
        for weights in (self.q, self.memory):
            for tensor in weights.values():
                tensor.requires_grad_()
            self.adams.append(torch.optim.Adam(weights.values(), lr=1.0))
        self.before = None

    def read(self, state):
        nose, contact = state
        return torch.stack([2 * nose - 1, 2 * contact + 1, nose / (5 * (1 - nose)) - 1])

    def layers(self, w, x):
        hidden = torch.tanh(w["hidden_weights"] @ x + w["hidden_biases"])
        return w["output_weights"] @ hidden + w["output_biases"]

    def value(self, x, action):
        return self.layers(self.q, torch.cat([x, 2 * action]))[0]

    def arrive(self, state, action, ideas):
        x, rho = self.read(state), state[1] if self.walls else state[0] / (1 - state[0]) / 10
        promises = [self.value(x, idea).detach() for idea in ideas]
        best = max(promises)
        idea = ideas[promises.index(best)]
        mine = self.value(x, action).detach()
        error = torch.tensor(0.0)
        if self.before is not None:
            error = self.learn(rho, best)
        self.age += 1
        self.before = (x, action, rho, idea, (best - mine).clamp(min=0))
        return error

    def learn(self, rho_now, best_now):
        x, action, rho, idea, gap = self.before
        if rho_now < rho and rho_now <= 0:
            best_now = torch.minimum(best_now, rho.clamp(min=0))
        target = rho_now - rho + 0.9 * best_now - self.p.action_gap * gap
        q = self.value(x, action)
        error, limit = abs(target - q), self.p.error_limit or math.inf
        surprise = error**2 / 2 if error < limit else limit * (error - limit / 2)
        outputs = torch.sigmoid(self.layers(self.memory, x))
        mistake = ((idea + 0.5 - outputs) ** 2 / 2).sum()
        rate = 0.0002 + 0.0018 * math.exp(-self.age / self.p.learn_rate_youth)
        for adam, loss in zip(self.adams, (surprise, mistake), strict=True):
            adam.zero_grad()
            loss.backward()
            adam.param_groups[0]["lr"] = rate
            adam.step()
        return (target - q).detach().clamp(-limit, limit)


def watch(brain):
    """Keeps what the brain's proposer offers."""
    proposed, propose = [], brain._proposer.propose

    def recorded(inputs):
        proposed.append(propose(inputs).clone())
        return proposed[-1]

    brain._proposer.propose = recorded
    return proposed


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize(
    "fields",
    [
        {"learn_rate_youth": 20.0},
        {"action_gap": 0.3, "young_epsilon": 0.6},
        {"error_limit": 0.1},
    ],
)
@pytest.mark.parametrize("walls", [False, True])
def test_each_step_learns_as_the_rule_is_written_down(fields, walls):
    brain = born(senses=WALLS if walls else SENSES, **fields)
    slow = [SlowBrain(brain, robot, brain._parameters, walls) for robot in range(ROBOTS)]
    proposed = watch(brain)
    strayed = lost = limited = 0
    for state in sensed(60):
        actions = brain.act(state, explore=True)
        errors = brain.learn(state[:, 1 if walls else 0])
        for robot, own in enumerate(slow):
            strayed += not (proposed[-1][robot] == actions[robot]).all(-1).any()
            before = own.before
            error = own.arrive(state[robot], actions[robot], proposed[-1][robot])
            lost += before is not None and own.before[2] < before[2] and own.before[2] <= 0
            limited += bool(own.p.error_limit) and abs(error) == own.p.error_limit
            torch.testing.assert_close(errors[robot], error, atol=1e-9, rtol=0)
    assert strayed > 10
    assert lost > 10
    assert not brain._parameters.error_limit or 10 < limited < 60 * ROBOTS - 10
    for robot, own in enumerate(slow):
        for owner, weights in (("evaluation", own.q), ("memory", own.memory)):
            for name, tensor in weights.items():
                mine = brain.networks()[f"{owner}.{name}"][robot]
                torch.testing.assert_close(mine, tensor.detach(), atol=1e-9, rtol=0)


def test_the_ingredients_are_all_that_tells_the_brain_from_the_papers():
    paper, ours = (dataclasses.asdict(p) for p in (Parameters(), STEADY))
    fields = [field for fields in INGREDIENTS.values() for field in fields]
    assert len(fields) == len(set(fields))
    assert {name for name in paper if paper[name] != ours[name]} == set(fields)


def test_docs_beyond_lists_every_ingredient_with_its_fields():
    page = (Path(__file__).parents[2] / "docs" / "beyond.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| ((?:`\w+`(?:, )?)+) \|", page, re.MULTILINE)
    found = {name: tuple(re.findall(r"\w+", fields)) for name, fields in rows}
    assert list(found) == list(INGREDIENTS)
    assert found == dict(INGREDIENTS)


@pytest.mark.parametrize("ingredient", INGREDIENTS)
def test_every_ingredient_can_be_taken_away_alone_and_is_then_missed(ingredient):
    brains = [
        Neurocontroller(BRAINS[name], "creative", ROBOTS, 2, 1, SENSES)
        for name in ("steady", f"steady-{ingredient}")
    ]
    for brain in brains:
        for state in sensed(100):
            before = snapshot(brain.networks())
            live(brain, [state])
            for name, tensor in brain.networks().items():
                assert (tensor - before[name]).abs().max() < 1, name
    assert not same(*(brain.networks() for brain in brains))


def test_a_memory_that_learns_at_the_td_error_follows_the_plain_gradient_as_the_papers():
    plain, adam = (
        Neurocontroller(Parameters(optimizer=name), "creative", ROBOTS, 2, 1).memory
        for name in ("plain", "adam")
    )
    state, action = sensed(1)[0], torch.full((ROBOTS, 2), 0.3)
    for memory in (plain, adam):
        memory.learn(state, action, torch.tensor([0.01, -0.02, 0.0]))
    assert same(plain.networks.tensors(), adam.networks.tensors())


# What each ingredient is for


def outcome(nose_before, nose_now, ahead, **fields):
    """The r and V' that one robot learns from, its best next value being `ahead`."""
    alone = {"action_gap": 0.0, **fields}
    brain = born(robots=1, **alone)
    for nose in (nose_before, nose_now):
        rho = brain._reading.reward(torch.tensor([nose]))
        brain.act(torch.tensor([[nose, 0.0]]), explore=False)
        brain._now["best_value"].fill_(ahead)
        gain, promised, learning = brain._outcome(rho)
    return gain.item(), promised.item(), learning.item()


def test_the_reward_is_the_change_of_the_raw_signal():
    gain, promised, learning = outcome(0.5, 10 / 11, 0.7)
    assert (gain, promised, learning) == pytest.approx((1.0 - 0.1, 0.7, 1.0))


def test_who_has_just_lost_all_expects_no_more_than_it_had():
    assert outcome(0.5, 0.0, 0.7)[:2] == pytest.approx((-0.1, 0.1))
    assert outcome(0.5, 0.0, 0.05)[:2] == pytest.approx((-0.1, 0.05))
    assert outcome(0.5, 0.0, -0.7)[:2] == pytest.approx((-0.1, -0.7))
    assert outcome(0.5, 0.0, 0.7, next_value_capped=False)[:2] == pytest.approx((-0.1, 0.7))


def test_that_a_wall_can_be_left_again_does_not_make_up_for_touching_it():
    brain = born(robots=1, senses=WALLS, action_gap=0.0)
    outcomes = []
    for contact in (0.0, -0.3, -1.0, -1.0, 0.0):
        brain.act(torch.tensor([[0.0, contact]]), explore=False)
        brain._now["best_value"].fill_(0.7)
        outcomes.append([part.item() for part in brain._outcome(torch.tensor([contact]))[:2]])
    expected = (-0.3, 0), (-0.7, 0), (0, 0.7), (1, 0.7)
    assert outcomes[1:] == [pytest.approx(pair) for pair in expected]


def gains(brain, rewards, anew=None, robots=None):
    """The r that each robot learns from, by step; before step `anew` robots are placed anew."""
    found = []
    for step, reward in enumerate(rewards):
        if step == anew:
            brain.forget_step(robots)
        brain.act(torch.zeros(len(reward), 2), explore=False)
        found.append(brain._outcome(torch.tensor(reward))[0].tolist())
    return found


def test_a_lingering_reward_is_lost_little_by_little_and_won_at_once():
    brain = born(robots=2, lingering=0.5, action_gap=0.0)
    noses = [[0.8, 0.0], [0.6, 0.0], [0.0, 0.4], [0.0, 0.4], [0.7, 0.1], [0.0, 0.0]]
    expected = [[-0.2, 0.0], [-0.3, 0.4], [-0.15, 0.0], [0.55, -0.2], [-0.35, -0.1]]
    assert gains(brain, noses)[1:] == [pytest.approx(row) for row in expected]


def test_a_lingering_reward_can_be_all_that_is_beyond_the_paper():
    brain = Neurocontroller(Parameters(lingering=0.5), "random", 1, 2, 1)
    found = gains(brain, [[0.8], [0.0], [0.0], [0.4]])
    assert found[1:] == [pytest.approx([x]) for x in (0.4, 0.2, 0.4)]
    assert brain.state()["now.reward"].tolist() == pytest.approx([0.4])


def test_nothing_lingers_of_another_place():
    brain = born(robots=2, lingering=0.5, action_gap=0.0)
    noses = [[0.0, 0.0], [0.8, 0.8], [0.0, 0.0], [0.2, 0.2]]
    found = gains(brain, noses, anew=2, robots=torch.tensor([0]))
    assert found[1] == pytest.approx([0.8, 0.8])
    assert found[3] == pytest.approx([0.2, -0.2])


def test_nothing_lingers_across_steps_that_are_not_learnt_from():
    brain = born(robots=1, lingering=0.5, raw_reward=False)
    (state,) = sensed(1, robots=1)
    for reward in (0.8, 0.8, None, 0.1, 0.1):
        brain.act(state, explore=False)
        if reward is not None:
            brain.learn(torch.tensor([reward]))
    assert brain._before["reward"].tolist() == brain._now["reward"].tolist() == [pytest.approx(0.1)]


def test_what_lingers_has_not_fallen_to_nothing_and_is_not_capped():
    assert outcome(0.5, 0.0, 0.7, lingering=0.5)[:2] == pytest.approx((-0.05, 0.7))


def test_a_touch_is_felt_in_full_though_rewards_linger():
    brains = [born(senses=WALLS, lingering=share) for share in (0.0, 0.9)]
    for state in sensed(30):
        for brain in brains:
            brain.act(state, explore=True)
            brain.learn(state[:, 1])
    assert same(*(brain.networks() for brain in brains))
    brain = born(robots=1, lingering=0.9, action_gap=0.0)
    assert gains(brain, [[0.8], [-1.0], [0.0]])[1:] == [pytest.approx([x]) for x in (-1.8, 1.0)]


@pytest.mark.parametrize(("before", "now"), [(0.0, 0.0), (0.6, 0.5), (0.0, 0.5)])
def test_others_expect_what_is_promised(before, now):
    assert outcome(before, now, 0.7)[1] == pytest.approx(0.7)


def test_an_action_is_rewarded_less_by_its_share_of_what_it_is_worse_than_the_best():
    brain = born(robots=1)
    first, second = sensed(2, robots=1)
    for state in (first, second):
        brain.act(state, explore=False)
        brain._now["value"].fill_(0.2)
        brain._now["best_value"].fill_(0.7)
        gain, _, _ = brain._outcome(torch.tensor([0.5]))
    assert gain.item() == pytest.approx(0.0 - 0.8 * 0.5)


def test_a_stray_action_that_is_judged_better_than_every_idea_loses_nothing():
    brain = born(robots=1)
    for value in (0.7, 0.2):
        brain.act(sensed(1, robots=1)[0], explore=False)
        brain._now["value"].fill_(value)
        brain._now["best_value"].fill_(0.2)
        gain, _, _ = brain._outcome(torch.tensor([0.5]))
    assert gain.item() == pytest.approx(0.0)


def test_a_change_is_not_learnt_where_the_reward_before_is_not_known():
    brain = born()
    first, second, third = sensed(3)
    brain.act(first, explore=False)  # as in the test before training: nobody learns
    brain.act(second, explore=False)
    before = snapshot(brain.networks())
    assert torch.equal(brain.learn(second[:, 0]), torch.zeros(ROBOTS))
    assert same(before, brain.networks())
    brain.act(third, explore=False)
    assert brain.learn(third[:, 0]).abs().min() > 0


def test_a_robot_placed_anew_learns_nothing_from_the_step_across_and_others_do():
    across, anew = born(), born()
    states = sensed(6)
    for brain in (across, anew):
        live(brain, states[:5])
    before = snapshot(anew.evaluation.networks.tensors())
    anew.forget_step(torch.tensor([1]))
    for brain in (across, anew):
        brain.act(states[5], explore=False)
    errors = [brain.learn(states[5][:, 0]) for brain in (across, anew)]
    assert errors[1][1] == 0
    assert torch.equal(errors[0][[0, 2]], errors[1][[0, 2]])
    for name, tensor in anew.evaluation.networks.tensors().items():
        assert torch.equal(tensor[1], before[name][1])
        assert not torch.equal(tensor[0], before[name][0])


def test_the_memory_learns_what_was_best_though_the_robot_strayed():
    brain = born(epsilon=1.0, young_epsilon=None)
    proposed = watch(brain)
    wanted = []
    brain.memory.learn = lambda state, action, rates, rate: wanted.append(action.clone())
    states = sensed(3)
    for state in states[:2]:
        brain.act(state, explore=True)
    brain.learn(states[1][:, 0])
    values = brain.values(states[0], proposed[0])
    assert torch.equal(wanted[0], proposed[0][torch.arange(ROBOTS), values.argmax(dim=1)])


@pytest.mark.parametrize(("count", "own"), [(25, 17), (9, 6), (5, 3), (3, 2), (1, 1)])
def test_a_third_of_the_ideas_are_random_and_the_others_the_memorys(count, own):
    brain = born(ideas=count, noise=0.0)  # so that the memory's own are all its main idea
    state = sensed(1)[0]
    ideas = brain.propose(state)
    main = brain.memory.recall(brain._reading.state(state))[:, None]
    alike = (ideas - main).abs().amax(-1) < 1e-6
    assert ideas.shape == (ROBOTS, count, 2)
    assert alike[:, :own].all()
    assert not alike[:, own:].any()


def test_epsilon_and_learn_rate_fall_with_age():
    assert STEADY.epsilon_at(0) == pytest.approx(0.3)
    assert STEADY.epsilon_at(24000) == pytest.approx(0.04 + 0.26 / math.e)
    assert STEADY.epsilon_at(10**7) == pytest.approx(0.04)
    assert STEADY.learn_rate_at(0) == pytest.approx(0.002)
    assert STEADY.learn_rate_at(62400) == pytest.approx(0.0002 + 0.0018 / math.e)
    assert STEADY.learn_rate_at(10**7) == pytest.approx(0.0002)
    assert Parameters().epsilon_at(10**7) == Parameters().epsilon
    assert Parameters().learn_rate_at(10**7) == Parameters().learn_rate


def test_robots_age_by_steps_of_learning_and_not_in_tests():
    brain = born()
    live(brain, sensed(5))
    brain.act(sensed(1)[0], explore=False)
    assert torch.equal(brain.state()["learning.age"], torch.tensor(5))


def test_the_old_stray_less_and_learn_more_slowly_than_the_young():
    brain = born(robots=200, epsilon_youth=10, learn_rate_youth=10, epsilon=0.0, held_steps=1)
    proposed, strayed, moved = watch(brain), [], []
    for state in sensed(100, robots=200):
        weights = brain.networks()["evaluation.output_weights"].clone()
        actions = brain.act(state, explore=True)
        brain.learn(state[:, 0])
        strayed.append(~(proposed[-1] == actions[:, None]).all(-1).any(-1))
        moved.append((brain.networks()["evaluation.output_weights"] - weights).abs().mean())
    assert 20 < torch.stack(strayed[:10]).sum()
    assert torch.stack(strayed[60:]).sum() < 20
    assert 3 * sum(moved[60:70]) < sum(moved[1:11])


# Abandoning training


def contented(steps, brain="paper", seed=1, proposer="creative", **fields):
    parameters = dataclasses.replace(BRAINS[brain], content_steps=steps, **fields)
    return Neurocontroller(parameters, proposer, ROBOTS, 2, seed, SENSES)


def rewarded(brain, rewards, seed=0):
    """Lives as many steps as each robot has rewards, by step; returns the TD errors."""
    errors = []
    for state, reward in zip(sensed(len(rewards), seed=seed), rewards, strict=True):
        brain.act(state, explore=True)
        errors.append(brain.learn(torch.tensor(reward)))
    return torch.stack(errors)


# In the spot for three steps in a row, for two and two, and next to it.
REWARDS = [[FULL, FULL, 0.909], [FULL, FULL, 0.909], [FULL, 0.9, 0.909], *[[0.1, FULL, 0.909]] * 2]


@pytest.mark.parametrize("name", ["paper", "steady"])
def test_who_had_a_full_load_for_long_enough_in_a_row_learns_no_more(name):
    brain, other = contented(3, name), contented(0, name)
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


@pytest.mark.parametrize("held", [0, 30])
def test_who_is_content_explores_no_more(held):
    brain = contented(3, proposer="fixed", epsilon=1.0, held_steps=held)
    rewarded(brain, REWARDS)
    for state in sensed(20, seed=2):
        values = brain.values(state, ideas := brain.propose(state))
        best = ideas[torch.arange(ROBOTS), values.argmax(dim=1)]
        chosen = brain.act(state, explore=True)
        assert torch.equal(chosen[0], best[0])
        assert not torch.equal(chosen[1:], best[1:])


@pytest.mark.parametrize("content_steps", [0, 3])
def test_until_somebody_is_content_a_brain_lives_as_the_papers_to_the_bit(content_steps):
    paper = Neurocontroller(Parameters(), "creative", ROBOTS, 2, 1)
    brain = contented(content_steps)
    rewards = [[FULL, FULL, 0.3], [0.2, FULL, FULL], [0.2, 0.1, FULL]] * 7
    errors = [rewarded(one, rewards) for one in (paper, brain)]
    assert torch.equal(*errors)
    assert same(paper.networks(), brain.networks())


def test_where_no_reward_saturates_nobody_is_ever_content():
    walls = Senses((Signal(0.0, 1.0), Signal(-1.0, 0.0)), Signal(-1.0, 0.0))
    paper = Neurocontroller(Parameters(), "creative", ROBOTS, 2, 1)
    brain = Neurocontroller(Parameters(content_steps=1), "creative", ROBOTS, 2, 1, walls)
    errors = [rewarded(one, [[0.0, -1.0, FULL]] * 20) for one in (paper, brain)]
    assert torch.equal(*errors)
    assert same(paper.networks(), brain.networks())


def test_a_robot_stays_content_when_it_goes_on_from_a_state():
    first, second = contented(3), contented(3, seed=999)
    rewarded(first, REWARDS[:2])
    kept = snapshot(first.state())
    assert kept["contentment.full_steps"].tolist() == [2, 2, 0]
    second.load_state(kept)
    for brain in (first, second):
        rewarded(brain, REWARDS[2:])
    assert same(first.state(), second.state())
    second.load_state(snapshot(first.state()))
    assert torch.equal(*(rewarded(one, REWARDS)[:, 0] for one in (first, second)))
    assert rewarded(second, REWARDS)[:, 0].abs().max() == 0


def test_a_brain_that_can_be_content_must_be_told_of_its_senses():
    with pytest.raises(ValueError, match="must be told of all 2"):
        Neurocontroller(BRAINS["paper-content"], "creative", ROBOTS, 2, 1)


# Independence, and going on


@pytest.mark.usefixtures("double_precision")
def test_robots_live_the_same_alone_and_among_others():
    together = born(proposer="fixed", epsilon=0.0, young_epsilon=None)
    alone = [born(0, "fixed", 1, epsilon=0.0, young_epsilon=None) for _ in range(ROBOTS)]
    for robot, brain in enumerate(alone):
        brain.load_networks({k: t[robot : robot + 1] for k, t in together.networks().items()})
    for state in sensed(50):
        actions, errors = together.act(state, explore=True), together.learn(state[:, 0])
        for robot, brain in enumerate(alone):
            row = slice(robot, robot + 1)
            assert torch.equal(brain.act(state[row], explore=True), actions[row])
            torch.testing.assert_close(brain.learn(state[row, 0]), errors[row], atol=1e-9, rtol=0)


@pytest.mark.parametrize("proposer", ["fixed", "random", "creative"])
@pytest.mark.parametrize("steps", [0, 1, 17, 40])
def test_a_brain_goes_on_from_its_state_to_the_bit(proposer, steps, monkeypatch):
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 6)
    monkeypatch.setattr(NoisePatterns, "POOL", 256)
    first, second = born(10, proposer), born(999, proposer)
    states = sensed(60)
    live(first, states[:steps])
    live(second, states[:7])
    kept = snapshot(first.state())
    second.load_state(kept)
    assert same(second.state(), kept)
    for one, other in zip(live(first, states[steps:]), live(second, states[steps:]), strict=True):
        assert torch.equal(one, other)
    assert same(second.state(), first.state())


def test_the_papers_state_has_nothing_of_all_this():
    brain = Neurocontroller(Parameters(), "creative", ROBOTS, 2, 1)
    parts = {name.rpartition(".")[0] for name in brain.state()}
    assert parts == {"", "evaluation", "memory", "now", "noise"}
    now = {name for name in brain.state() if name.startswith("now.")}
    assert now == {"now.state", "now.action", "now.value", "now.chained"}
