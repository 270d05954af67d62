"""The named brains: `steady` step by step against autograd and torch's Adam; its ingredients."""

import dataclasses
import math
import re
from pathlib import Path

import pytest
import torch
from helpers import same, snapshot

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


def steady(seed=1, proposer="creative", robots=ROBOTS, senses=SENSES, **fields):
    parameters = dataclasses.replace(STEADY, **fields)
    return Neurocontroller(parameters, proposer, robots, 2, seed, senses)


def sensed(steps, robots=ROBOTS, seed=0):
    """States of a nose and a contact sensor; the nose often smells nothing."""
    generator = torch.Generator().manual_seed(seed)
    nose = torch.rand(steps, robots, generator=generator) * 10 / 11
    nose *= torch.rand(steps, robots, generator=generator) < 0.6
    contact = -(torch.rand(steps, robots, generator=generator) < 0.3).to(nose.dtype)
    return torch.stack([nose, contact], dim=-1)


def run(brain, states):
    actions = []
    for state in states:
        actions.append(brain.act(state, explore=True))
        brain.learn(state[:, 0])
    return actions


# Learning step by step


class SlowBrain:
    """One robot's networks, updated literally by the equations.

    In x' with reward rho': delta = rho' - rho - alpha (V_best - V) + gamma V' - Q(x, a), where V'
    is the largest Q of the ideas in x', clipped to max(rho, 0) if the reward fell to 0 or below;
    V_best and V are the values in x when a was selected. Adam moves Q along delta grad Q(x, a),
    and the memory towards the best idea of x.
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

    def encode(self, state):
        nose, contact = state
        return torch.stack([2 * nose - 1, 2 * contact + 1, nose / (5 * (1 - nose)) - 1])

    def layers(self, w, x):
        hidden = torch.tanh(w["hidden_weights"] @ x + w["hidden_biases"])
        return w["output_weights"] @ hidden + w["output_biases"]

    def value(self, x, action):
        return self.layers(self.q, torch.cat([x, 2 * action]))[0]

    def arrive(self, state, action, ideas):
        x, rho = self.encode(state), state[1] if self.walls else state[0] / (1 - state[0]) / 10
        values = [self.value(x, idea).detach() for idea in ideas]
        best = max(values)
        idea = ideas[values.index(best)]
        own_value = self.value(x, action).detach()
        error = torch.tensor(0.0)
        if self.before is not None:
            error = self.learn(rho, best)
        self.age += 1
        self.before = (x, action, rho, idea, (best - own_value).clamp(min=0))
        return error

    def learn(self, rho_now, best_now):
        x, action, rho, idea, advantage = self.before
        if rho_now < rho and rho_now <= 0:
            best_now = torch.minimum(best_now, rho.clamp(min=0))
        target = rho_now - rho + 0.9 * best_now - self.p.advantage_scale * advantage
        q = self.value(x, action)
        error, limit = abs(target - q), self.p.td_error_limit or math.inf
        value_loss = error**2 / 2 if error < limit else limit * (error - limit / 2)
        outputs = torch.sigmoid(self.layers(self.memory, x))
        memory_loss = ((idea + 0.5 - outputs) ** 2 / 2).sum()
        rate = 0.0002 + 0.0018 * math.exp(-self.age / self.p.learn_rate_decay_steps)
        for adam, loss in zip(self.adams, (value_loss, memory_loss), strict=True):
            adam.zero_grad()
            loss.backward()
            adam.param_groups[0]["lr"] = rate
            adam.step()
        return (target - q).detach().clamp(-limit, limit)


def record_proposals(brain):
    """Records the actions that the brain's proposer offers."""
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
        {"learn_rate_decay_steps": 20.0},
        {"advantage_scale": 0.3, "initial_epsilon": 0.6},
        {"td_error_limit": 0.1},
    ],
)
@pytest.mark.parametrize("walls", [False, True])
def test_each_step_learns_by_the_equations(fields, walls):
    brain = steady(senses=WALLS if walls else SENSES, **fields)
    parameters = dataclasses.replace(STEADY, **fields)
    slow = [SlowBrain(brain, robot, parameters, walls) for robot in range(ROBOTS)]
    proposed = record_proposals(brain)
    explored = lost = limited = 0
    for state in sensed(60):
        actions = brain.act(state, explore=True)
        errors = brain.learn(state[:, 1 if walls else 0])
        for robot, own in enumerate(slow):
            explored += not (proposed[-1][robot] == actions[robot]).all(-1).any()
            before = own.before
            error = own.arrive(state[robot], actions[robot], proposed[-1][robot])
            lost += before is not None and own.before[2] < before[2] and own.before[2] <= 0
            limited += bool(own.p.td_error_limit) and abs(error) == own.p.td_error_limit
            torch.testing.assert_close(errors[robot], error, atol=1e-9, rtol=0)
    assert explored > 10
    assert lost > 10
    assert not parameters.td_error_limit or 10 < limited < 60 * ROBOTS - 10
    for robot, own in enumerate(slow):
        for owner, weights in (("evaluation", own.q), ("memory", own.memory)):
            for name, tensor in weights.items():
                own_value = brain.networks()[f"{owner}.{name}"][robot]
                torch.testing.assert_close(own_value, tensor.detach(), atol=1e-9, rtol=0)


def test_steady_differs_from_the_paper_by_its_ingredients_only():
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
def test_every_ingredient_can_be_removed_alone_and_has_an_effect(ingredient):
    brains = [
        Neurocontroller(BRAINS[name], "creative", ROBOTS, 2, 1, SENSES)
        for name in ("steady", f"steady-{ingredient}")
    ]
    for brain in brains:
        for state in sensed(100):
            before = snapshot(brain.networks())
            run(brain, [state])
            for name, tensor in brain.networks().items():
                assert (tensor - before[name]).abs().max() < 1, name
    assert not same(*(brain.networks() for brain in brains))


def test_a_robot_placed_elsewhere_does_not_learn_across_and_others_do():
    across, anew = steady(), steady()
    states = sensed(6)
    for brain in (across, anew):
        run(brain, states[:5])
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


def test_the_memory_learns_the_best_action_when_the_robot_explores():
    brain = steady(epsilon=1.0, initial_epsilon=None)
    proposed = record_proposals(brain)
    learned = []
    brain.memory.learn = lambda state, action, rates, rate: learned.append(action.clone())
    states = sensed(3)
    for state in states[:2]:
        brain.act(state, explore=True)
    brain.learn(states[1][:, 0])
    values = brain.values(states[0], proposed[0])
    assert torch.equal(learned[0], proposed[0][torch.arange(ROBOTS), values.argmax(dim=1)])


@pytest.mark.parametrize(("count", "own"), [(25, 17), (9, 6), (5, 3), (3, 2), (1, 1)])
def test_a_third_of_the_ideas_are_random_and_the_others_the_memorys(count, own):
    brain = steady(ideas=count, noise=0.0)  # so that the memory's ideas equal its main idea
    state = sensed(1)[0]
    ideas = brain.propose(state)
    main = brain.memory.recall(brain._encoding.state(state))[:, None]
    alike = (ideas - main).abs().amax(-1) < 1e-6
    assert ideas.shape == (ROBOTS, count, 2)
    assert alike[:, :own].all()
    assert not alike[:, own:].any()


def test_decay_counts_steps_of_training_and_not_of_tests():
    brain = steady()
    run(brain, sensed(5))
    brain.act(sensed(1)[0], explore=False)
    assert torch.equal(brain.state()["age"], torch.tensor(5))


def test_exploration_and_learning_decrease_with_age():
    brain = steady(
        robots=200,
        epsilon_decay_steps=10,
        learn_rate_decay_steps=10,
        epsilon=0.0,
        exploration_steps=1,
    )
    proposed, explored, moved = record_proposals(brain), [], []
    for state in sensed(100, robots=200):
        weights = brain.networks()["evaluation.output_weights"].clone()
        actions = brain.act(state, explore=True)
        brain.learn(state[:, 0])
        explored.append(~(proposed[-1] == actions[:, None]).all(-1).any(-1))
        moved.append((brain.networks()["evaluation.output_weights"] - weights).abs().mean())
    assert 20 < torch.stack(explored[:10]).sum()
    assert torch.stack(explored[60:]).sum() < 20
    assert 3 * sum(moved[60:70]) < sum(moved[1:11])


# Independence, and checkpoints


@pytest.mark.usefixtures("double_precision")
def test_robots_behave_the_same_alone_and_in_a_batch():
    together = steady(proposer="fixed", epsilon=0.0, initial_epsilon=None)
    alone = [steady(0, "fixed", 1, epsilon=0.0, initial_epsilon=None) for _ in range(ROBOTS)]
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
def test_a_brain_continues_bit_exactly_from_its_state(proposer, steps, monkeypatch):
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 6)
    monkeypatch.setattr(NoisePatterns, "POOL", 256)
    first, second = steady(10, proposer), steady(999, proposer)
    states = sensed(60)
    run(first, states[:steps])
    run(second, states[:7])
    kept = snapshot(first.state())
    second.load_state(kept)
    assert same(second.state(), kept)
    for one, other in zip(run(first, states[steps:]), run(second, states[steps:]), strict=True):
        assert torch.equal(one, other)
    assert same(second.state(), first.state())


def test_the_papers_checkpoint_has_nothing_of_the_extensions():
    brain = Neurocontroller(Parameters(), "creative", ROBOTS, 2, 1)
    parts = {name.rpartition(".")[0] for name in brain.state()}
    assert parts == {"", "evaluation", "memory", "now", "noise"}
    now = {name for name in brain.state() if name.startswith("now.")}
    assert now == {"now.state", "now.action", "now.value", "now.chained"}
