"""The named brains, step by step against autograd and torch's optimizers; the ingredients."""

import dataclasses
import math
import re
from pathlib import Path

import pytest
import torch
from helpers import recorded, same, snapshot
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.controller import (
    BRAINS,
    INGREDIENTS,
    Neurocontroller,
    Parameters,
    Senses,
    Signal,
)

few = settings(max_examples=20)
STEADY = BRAINS["steady"]
SENSES = Senses((Signal(0.0, 1.0, 10.0), Signal(-1.0, 0.0)), Signal(0.0, 1.0, 10.0))
WALLS = Senses(SENSES.state, Signal(-1.0, 0.0))
ROBOTS = 3


def steady(seed=1, proposer="creative", robots=ROBOTS, senses=SENSES, **fields):
    parameters = dataclasses.replace(STEADY, **fields)
    return Neurocontroller(parameters, proposer, robots, senses, seed)


def sensed(steps, robots=ROBOTS, seed=0):
    """States of a nose and a contact sensor; the nose often smells nothing."""
    generator = torch.Generator().manual_seed(seed)
    nose = torch.rand(steps, robots, generator=generator) * 10 / 11
    nose *= torch.rand(steps, robots, generator=generator) < 0.6
    contact = -torch.rand(steps, robots, generator=generator)
    contact *= torch.rand(steps, robots, generator=generator) < 0.6
    return torch.stack([nose, contact], dim=-1)


def run(brain, states, reward=0):
    for state in states:
        brain.act(state, explore=True)
        brain.learn(state[:, reward])


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

    def arrive(self, state, action, reward, ideas, learns):
        """Learns from the step that ends in `state`; returns the TD error, and the best idea."""
        own = self.inputs(state)
        x = torch.cat([own, self.units])
        if self.p.raw_reward and self.senses.reward.maximal:
            reward = reward / (1 - reward) / 10
        values = [self.value(x, idea).item() for idea in ideas]
        now = {"x": x, "action": action, "reward": reward.item() if learns else None}
        now |= {"value": self.value(x, action).item(), "best": max(values)}
        now |= {"idea": ideas[values.index(max(values))]}
        error = 0.0
        if learns:
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
        difference = p.reward_form == "difference"
        if before["reward"] is None and (difference or p.clipped_bootstrap):
            return 0.0  # the reward to compare was not sensed
        ahead = now["best"] if p.bootstrap == "max" else now["value"]
        if p.clipped_bootstrap and now["reward"] < before["reward"] and now["reward"] <= 0:
            ahead = min(ahead, max(before["reward"], 0))
        reward = now["reward"] - (before["reward"] if difference else 0)
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


# The named brains, and the paper's with each term of the target alone.
ALL = dict(BRAINS)
for term in ("raw_reward", "reward_difference", "max_target", "clipped_bootstrap", "advantage"):
    added = {field: getattr(STEADY, field) for field in INGREDIENTS[term]}
    ALL[f"paper+{term}"] = dataclasses.replace(Parameters(epsilon=0.3), **added)
LIVES = [(name, "creative", SENSES) for name in ALL]
LIVES += [(name, "creative", WALLS) for name in ALL if not name.startswith("steady-")]
LIVES += [(name, other, SENSES) for name in ("paper", "steady") for other in ("fixed", "random")]


@pytest.fixture
def double_precision():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize(("name", "proposer", "senses"), LIVES)
def test_every_brain_learns_step_by_step_by_the_equations(name, proposer, senses):
    """Some steps are tests, without exploration or learning; after some, robots are moved."""
    parameters = dataclasses.replace(ALL[name], ideas=4, learn_rate_decay_steps=20.0)
    brain = Neurocontroller(parameters, proposer, ROBOTS, senses, 1)
    literal = [LiteralBrain(brain, robot, parameters, senses) for robot in range(ROBOTS)]
    proposed = recorded(brain, "_propose")
    for step, state in enumerate(sensed(30)):
        explore, learns = step % 3 > 0, step % 8 != 6
        actions = brain.act(state, explore)
        rewards = state[:, 0 if senses is SENSES else 1]
        errors = brain.learn(rewards) if learns else torch.zeros(ROBOTS)
        for robot, own in enumerate(literal):
            lived = state[robot], actions[robot], rewards[robot], proposed[-1][robot]
            error, best = own.arrive(*lived, learns)
            assert errors[robot].item() == pytest.approx(error, abs=1e-9)
            assert explore or torch.equal(actions[robot], best)
        if moved := {12: [0, 2], 20: [*range(ROBOTS)]}.get(step):
            brain.forget_step(torch.tensor(moved) if len(moved) < ROBOTS else None)
            for robot in moved:
                literal[robot].before = None
    for robot, own in enumerate(literal):
        weights = {"evaluation": own.q, "memory": own.memory, "context": own.context}
        for name, tensor in brain.networks().items():
            owner, part = name.split(".")
            expected = weights[owner][part].detach()
            torch.testing.assert_close(tensor[robot], expected, atol=1e-9, rtol=0)


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


def test_every_ingredient_can_be_removed_alone_and_has_an_effect():
    found = {}
    for name, parameters in BRAINS.items():
        brain = Neurocontroller(parameters, "creative", ROBOTS, SENSES, 1)
        for state in sensed(60):
            before = snapshot(brain.networks())
            run(brain, [state])
            for part, tensor in brain.networks().items():
                assert (tensor - before[part]).abs().max() < 1, (name, part)
        found[name] = brain.networks()
    for ingredient in INGREDIENTS:
        assert not same(found["steady"], found[f"steady-{ingredient}"]), ingredient


# Fields that change nothing while the ingredient that reads them is off, or that are neutral.
NEUTRAL = [
    {"epsilon_decay_steps": 5.0, "learn_rate_decay_steps": 5.0},
    {"initial_epsilon": 0.01, "initial_learn_rate": 0.01},
    {"raw_reward": True},  # a punishment does not saturate
    {"random_share": 0.01},  # less than half an idea
]


def test_what_an_ingredient_adds_leaves_the_papers_life_unchanged_where_it_is_off():
    lives = []
    for fields in ({}, *NEUTRAL):
        brain = Neurocontroller(Parameters(**fields), "creative", ROBOTS, WALLS, 1)
        run(brain, sensed(30), reward=1)
        lives.append(brain.state())
    paper, *others = lives
    assert [same(paper, other) for other in others] == [True] * len(NEUTRAL)


def test_a_brain_lives_with_the_least_of_every_whole_number():
    for field in dataclasses.fields(Parameters):
        if least := re.match(r"a whole number from (\d+)", field.metadata["words"]):
            brain = steady(**{field.name: int(least[1])})
            run(brain, sensed(3))
            assert all(t.isfinite().all() for t in brain.networks().values()), field.name


def test_the_papers_checkpoint_has_nothing_of_the_ingredients():
    brain = Neurocontroller(Parameters(), "creative", ROBOTS, SENSES, 1)
    parts = {name.rpartition(".")[0] for name in brain.state()}
    assert parts == {"", "evaluation", "memory", "now", "noise"}
    now = {name for name in brain.state() if name.startswith("now.")}
    assert now == {"now.state", "now.action", "now.value", "now.chained"}


@few
@given(st.integers(1, 30), st.floats(0, 1, exclude_max=True))
def test_a_share_of_the_ideas_is_random_and_the_others_are_the_memorys(count, share):
    brain = steady(ideas=count, random_share=share, noise=0.0)  # all of the memory's are equal
    ideas = brain.propose(sensed(1)[0])
    alike = (ideas - ideas[:, :1]).abs().amax(-1) < 1e-6
    assert ideas.shape == (ROBOTS, count, 2)
    own = max(count - round(share * count), 1)
    assert alike[:, :own].all()
    assert not alike[:, own:].any()


@few
@given(
    noise=st.sampled_from([0.0, 0.76]),
    noisy_share=st.sampled_from([0.0, 0.25]),
    ideas=st.integers(1, 3),
    random_share=st.sampled_from([0.0, 0.5]),
    keep_main_idea=st.booleans(),
    memory_target=st.sampled_from(["selected", "best"]),
)
def test_a_memory_does_not_learn_from_its_main_idea_alone(memory_target, **fields):
    brain = steady(memory_target=memory_target, epsilon=0.5, **fields)
    states, before = sensed(20), snapshot(brain.networks())
    ideas = torch.cat([brain.propose(states[0]) for _ in range(3)], dim=1)
    alone = (ideas - ideas[:, :1]).abs().max() < 1e-6
    run(brain, states)
    same_weights = {name: tensor.equal(before[name]) for name, tensor in brain.networks().items()}
    assert same_weights["memory.hidden_weights"] == (alone and memory_target == "best")
    assert not same_weights["evaluation.hidden_weights"]


def test_exploration_and_learning_decrease_with_steps_of_training_only():
    fast = {"epsilon_decay_steps": 10, "learn_rate_decay_steps": 10}
    brain = steady(robots=200, epsilon=0.0, exploration_steps=1, **fast)
    proposed, explored, moved = recorded(brain, "_propose"), [], []
    for state in sensed(80, robots=200):
        weights = brain.networks()["evaluation.output_weights"].clone()
        actions = brain.act(state, explore=True)
        brain.learn(state[:, 0])
        explored.append(~(proposed[-1] == actions[:, None]).all(-1).any(-1))
        moved.append((brain.networks()["evaluation.output_weights"] - weights).abs().mean())
    assert 20 < torch.stack(explored[:10]).sum()
    assert torch.stack(explored[60:]).sum() < 20
    assert 3 * sum(moved[60:70]) < sum(moved[1:11])
    assert brain.state()["age"] == 80
