"""The named brains, step by step against autograd and torch's optimizers; the ingredients."""

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


class LiteralBrain:
    """One robot's brain, updated literally by the equations; autograd computes the gradients.

    In x', with reward r' and value V' of the action selected there (Sutton and Barto's SARSA),
    delta = r' + gamma V' - Q(x, a). Q moves along delta grad Q(x, a), then the memory towards the
    action a, with delta as its learn rate (Eq. 1, section 3). The ingredients of `steady` change
    one term each.
    """

    def __init__(self, brain, robot, parameters, senses):
        own = {name: tensor[robot].clone() for name, tensor in brain.networks().items()}
        self.q, self.memory, self.context = (
            {k.split(".")[1]: t for k, t in own.items() if k.startswith(owner)}
            for owner in ("evaluation", "memory", "context")
        )
        self.p, self.senses = parameters, senses
        self.units = torch.zeros(parameters.context_neurons)
        self.age, self.before = 0, None
        adam = parameters.optimizer == "adam"
        kinds = (adam, adam and parameters.memory_target == "best")
        self.optimizers = []
        for weights, with_adam in zip((self.q, self.memory), kinds, strict=True):
            for tensor in weights.values():
                tensor.requires_grad_()
            kind = torch.optim.Adam if with_adam else torch.optim.SGD
            self.optimizers.append(kind(weights.values(), lr=1.0) if weights else None)

    def inputs(self, state):
        nose, contact = state
        x = [2 * nose - 1, 2 * contact + 1] if self.p.centred_inputs else [nose, contact]
        if self.p.raw_signals:
            raw = nose / (1 - nose) / 10
            x.append(2 * raw - 1 if self.p.centred_inputs else raw)
        return torch.stack(x)

    def layers(self, w, x):
        function = torch.tanh if self.p.activation == "tanh" else torch.sigmoid
        hidden = function(w["hidden_weights"] @ x + w["hidden_biases"])
        return w["output_weights"] @ hidden + w["output_biases"]

    def value(self, x, action):
        return self.layers(self.q, torch.cat([x, 2 * action if self.p.centred_inputs else action]))[
            0
        ]

    def arrive(self, state, action, reward, ideas):
        """Learns from the step that ends in `state`; returns the TD error, and the best idea."""
        own = self.inputs(state)
        x = torch.cat([own, self.units])
        if self.p.raw_reward and self.senses.reward.maximal:
            reward = reward / (1 - reward) / 10
        values = [self.value(x, idea).item() for idea in ideas]
        now = {"x": x, "action": action, "reward": reward.item(), "best": max(values)}
        now |= {"value": self.value(x, action).item(), "idea": ideas[values.index(max(values))]}
        error = 0.0 if self.before is None else self.learn(self.before, now)
        self.age += 1
        self.before = now
        if self.context:
            sums = self.context["recurrent_weights"] @ self.units
            sums = sums + self.context["input_weights"] @ own
            rates = torch.logspace(math.log10(0.5), math.log10(0.005), len(self.units))
            self.units = self.units + rates * (torch.tanh(sums) - self.units)
        return error, now["idea"]

    def learn(self, before, now):
        p = self.p
        ahead = now["best"] if p.bootstrap == "max" else now["value"]
        if p.clipped_bootstrap and now["reward"] < before["reward"] and now["reward"] <= 0:
            ahead = min(ahead, max(before["reward"], 0))
        reward = now["reward"] - (before["reward"] if p.reward_form == "difference" else 0)
        reward -= p.advantage_scale * max(before["best"] - before["value"], 0)
        error = (reward + p.discount * ahead - self.value(before["x"], before["action"])).item()
        rate = p.learn_rate
        if p.initial_learn_rate is not None:
            rate += (p.initial_learn_rate - rate) * math.exp(-self.age / p.learn_rate_decay_steps)
        self.move(0, -error * self.value(before["x"], before["action"]), rate)
        if self.memory:
            best = p.memory_target == "best"
            outputs = torch.sigmoid(self.layers(self.memory, before["x"])) - 0.5
            wanted = before["idea"] if best else before["action"]
            self.move(1, ((wanted - outputs) ** 2 / 2).sum(), rate if best else error)
        return error

    def move(self, which, loss, rate):
        optimizer = self.optimizers[which]
        optimizer.zero_grad()
        loss.backward()
        optimizer.param_groups[0]["lr"] = rate
        optimizer.step()


def record_proposals(brain):
    """Records the actions that the brain's proposer offers."""
    proposed, propose = [], brain._proposer.propose

    def recorded(inputs):
        proposed.append(propose(inputs).clone())
        return proposed[-1]

    brain._proposer.propose = recorded
    return proposed


LIVES = [(name, "creative", walls) for name in BRAINS for walls in (False, True)]
LIVES += [(name, other, True) for name in ("paper", "steady") for other in ("fixed", "random")]


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize(("name", "proposer", "walls"), LIVES)
def test_every_brain_learns_step_by_step_by_the_equations(name, proposer, walls):
    quick = {"ideas": 4, "learn_rate_decay_steps": 20.0}
    parameters = dataclasses.replace(BRAINS[name], **quick)
    senses = WALLS if walls else SENSES
    brain = Neurocontroller(parameters, proposer, ROBOTS, 2, 1, senses)
    literal = [LiteralBrain(brain, robot, parameters, senses) for robot in range(ROBOTS)]
    proposed = record_proposals(brain)
    for step, state in enumerate(sensed(25)):
        actions = brain.act(state, explore=step % 3 > 0)
        rewards = state[:, 1 if walls else 0]
        errors = brain.learn(rewards)
        for robot, own in enumerate(literal):
            lived = state[robot], actions[robot], rewards[robot], proposed[-1][robot]
            error, best = own.arrive(*lived)
            assert errors[robot].item() == pytest.approx(error, abs=1e-9)
            assert step % 3 or torch.equal(actions[robot], best)
    for robot, own in enumerate(literal):
        for owner, weights in (("evaluation", own.q), ("memory", own.memory)):
            for part, tensor in weights.items():
                found = brain.networks()[f"{owner}.{part}"][robot]
                torch.testing.assert_close(found, tensor.detach(), atol=1e-9, rtol=0)


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


# Fields that change nothing while the ingredient that reads them is off, or that are neutral.
NEUTRAL = [
    {"epsilon_decay_steps": 5.0, "learn_rate_decay_steps": 5.0},
    {"initial_epsilon": 0.01, "initial_learn_rate": 0.01},
    {"raw_reward": True},  # a punishment does not saturate
    {"random_share": 0.01},  # less than half an idea
]


@pytest.mark.parametrize("fields", NEUTRAL, ids=lambda fields: " ".join(fields))
@pytest.mark.parametrize("proposer", ["fixed", "random", "creative"])
def test_what_an_ingredient_adds_leaves_the_papers_life_unchanged_where_it_is_off(fields, proposer):
    lives = []
    for parameters in (Parameters(), Parameters(**fields)):
        brain = Neurocontroller(parameters, proposer, ROBOTS, 2, 1, WALLS)
        actions = []
        for state in sensed(30):
            actions.append(brain.act(state, explore=True))
            brain.learn(state[:, 1])
        lives.append((actions, snapshot(brain.state())))
    (paper, own), (others, other) = lives
    assert all(map(torch.equal, paper, others))
    assert same(own, other)


def test_the_papers_checkpoint_has_nothing_of_the_ingredients():
    brain = Neurocontroller(Parameters(), "creative", ROBOTS, 2, 1)
    parts = {name.rpartition(".")[0] for name in brain.state()}
    assert parts == {"", "evaluation", "memory", "now", "noise"}
    now = {name for name in brain.state() if name.startswith("now.")}
    assert now == {"now.state", "now.action", "now.value", "now.chained"}


@pytest.mark.parametrize(("count", "own"), [(25, 17), (9, 6), (5, 3), (3, 2), (1, 1)])
def test_a_third_of_the_ideas_are_random_and_the_others_the_memorys(count, own):
    brain = steady(ideas=count, noise=0.0)  # so that the memory's ideas equal its main idea
    ideas = brain.propose(sensed(1)[0])
    alike = (ideas - ideas[:, :1]).abs().amax(-1) < 1e-6
    assert ideas.shape == (ROBOTS, count, 2)
    assert alike[:, :own].all()
    assert not alike[:, own:].any()


@pytest.mark.parametrize(
    ("fields", "learns"),
    [
        ({"noise": 0.0}, False),
        ({"noisy_share": 0.0}, False),
        ({"keep_main_idea": True, "ideas": 1}, False),
        ({"keep_main_idea": True, "ideas": 2}, True),
        ({"noise": 0.0, "random_share": 0.5}, True),
        ({"noise": 0.0, "memory_target": "selected"}, True),
    ],
)
def test_a_memory_does_not_learn_from_itself_alone(fields, learns):
    brain = steady(**{"random_share": 0.0, "ideas": 4, "epsilon": 0.5} | fields)
    before = snapshot(brain.networks())
    run(brain, sensed(20))
    after = brain.networks()
    assert torch.equal(before["memory.hidden_weights"], after["memory.hidden_weights"]) != learns
    assert not torch.equal(before["evaluation.hidden_weights"], after["evaluation.hidden_weights"])


def test_exploration_and_learning_decrease_with_steps_of_training_only():
    fast = {"epsilon_decay_steps": 10, "learn_rate_decay_steps": 10}
    brain = steady(robots=200, epsilon=0.0, exploration_steps=1, **fast)
    proposed, explored, moved = record_proposals(brain), [], []
    for state in sensed(80, robots=200):
        weights = brain.networks()["evaluation.output_weights"].clone()
        actions = brain.act(state, explore=True)
        brain.learn(state[:, 0])
        explored.append(~(proposed[-1] == actions[:, None]).all(-1).any(-1))
        moved.append((brain.networks()["evaluation.output_weights"] - weights).abs().mean())
    assert 20 < torch.stack(explored[:10]).sum()
    assert torch.stack(explored[60:]).sum() < 20
    assert 3 * sum(moved[60:70]) < sum(moved[1:11])
    brain.act(sensed(1, robots=200)[0], explore=False)
    assert brain.state()["age"] == 80
