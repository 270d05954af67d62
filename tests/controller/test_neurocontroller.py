"""The modular neurocontroller: selection, learning, and continuation from a checkpoint."""

import os
import subprocess
import sys

import pytest
import torch
from helpers import same, snapshot
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import (
    BRAINS,
    PROPOSERS,
    Neurocontroller,
    NoisePatterns,
    Parameters,
    Senses,
    Signal,
)

quick = settings(deadline=None, max_examples=20)
every_proposer = pytest.mark.parametrize("proposer", PROPOSERS)


def states(steps, robots, sensors, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(steps, robots, sensors, generator=generator) * 2 - 1


# Learning step by step


class SlowBrain:
    """One robot's two networks in double precision; autograd computes the gradients.

    SARSA (Sutton and Barto) with the paper's Eq. 1: in s', select a' first; then move V(s, a),
    computed again, towards the constant r + gamma V(s', a'); then train the memory towards a in
    s, with the TD error as its learn rate.
    """

    def __init__(self, tensors, robot, parameters):
        self.w = {name: tensor[robot].double().clone() for name, tensor in tensors.items()}
        self.parameters = parameters
        self.before = None

    def _layers(self, w, owner, x):
        hidden = torch.sigmoid(w[f"{owner}.hidden_weights"] @ x + w[f"{owner}.hidden_biases"])
        return w[f"{owner}.output_weights"] @ hidden + w[f"{owner}.output_biases"]

    def value(self, state, action, w=None):
        return self._layers(w or self.w, "evaluation", torch.cat([state, action]))[0]

    def _value_loss(self, w, state, action, target):
        return (target - self.value(state, action, w)) ** 2 / 2

    def _memory_loss(self, w, state, action):
        outputs = torch.sigmoid(self._layers(w, "memory", state))
        return ((action + 0.5 - outputs) ** 2 / 2).sum()

    def _descend(self, rate, loss, *arguments):
        w = {name: tensor.clone().requires_grad_() for name, tensor in self.w.items()}
        loss(w, *arguments).backward()
        for name, tensor in w.items():
            if tensor.grad is not None:
                self.w[name] = (tensor - rate * tensor.grad).detach()

    def arrive(self, state, action, reward):
        """Learns from the step that ends in `state`, in which `action` is selected."""
        error = 0.0
        if self.before is not None:
            target = reward + self.parameters.discount * self.value(state, action)
            error = (target - self.value(*self.before)).item()
            self._descend(self.parameters.learn_rate, self._value_loss, *self.before, target)
            if "memory.output_weights" in self.w:
                self._descend(error, self._memory_loss, *self.before)
        self.before = (state, action)
        return error


def record_proposals(brain):
    """Records the ideas of the memory (or, without one, the fixed actions) in every step."""
    proposed = []
    if brain.memory is None:
        motors = torch.tensor(Parameters().fixed_motors)
        grid = torch.cartesian_prod(motors, motors)
        return lambda: grid.expand(len(brain.networks()["evaluation.output_biases"]), -1, -1)
    ideas = brain.memory.ideas

    def recorded(state, count):
        proposed.append(ideas(state, count))
        return proposed[-1]

    brain.memory.ideas = recorded
    return lambda: proposed[-1]


@quick
@given(
    proposer=st.sampled_from(["fixed", "creative"]),
    robots=st.integers(1, 3),
    sensors=st.integers(1, 5),
    seed=st.integers(0, 2**31),
    learn_rate=st.floats(0, 0.3),
    discount=st.floats(0, 1),
    explore=st.booleans(),
    data=st.data(),
)
def test_each_step_learns_from_the_previous_one_as_autograd_does(
    proposer, robots, sensors, seed, learn_rate, discount, explore, data
):
    steps = 5
    reward = st.floats(-1, 1, width=32)
    rewards = data.draw(
        st.lists(st.lists(reward, min_size=robots, max_size=robots), min_size=steps, max_size=steps)
    )
    parameters = Parameters(learn_rate=learn_rate, discount=discount, epsilon=0.5)
    brain = Neurocontroller(parameters, proposer, robots, sensors, seed)
    slow = [SlowBrain(brain.networks(), robot, parameters) for robot in range(robots)]
    proposals = record_proposals(brain)
    for state, reward in zip(states(steps, robots, sensors, seed), rewards, strict=True):
        actions = brain.act(state, explore=explore)
        error = brain.learn(torch.tensor(reward))
        for robot, own in enumerate(slow):
            s, a = state[robot].double(), actions[robot].double()
            best = max(own.value(s, idea.double()) for idea in proposals()[robot])
            # Single precision may order nearly equal values differently.
            assert explore or own.value(s, a) > best - 1e-5
            assert error[robot].item() == pytest.approx(own.arrive(s, a, reward[robot]), abs=1e-5)
            for name, tensor in brain.networks().items():
                torch.testing.assert_close(tensor[robot].double(), own.w[name], atol=1e-5, rtol=0)


@every_proposer
def test_nothing_is_learned_from_the_first_step(proposer):
    brain = Neurocontroller(Parameters(), proposer, 4, 5, seed=1)
    before = snapshot(brain.networks())
    first, second = states(2, 4, 5)
    brain.act(first, explore=True)
    assert torch.equal(brain.learn(torch.ones(4)), torch.zeros(4))
    assert same(before, brain.networks())
    brain.act(second, explore=True)
    assert brain.learn(torch.ones(4)).abs().min() > 0
    assert not same(before, brain.networks())


@every_proposer
def test_acting_changes_no_network(proposer):
    brain = Neurocontroller(Parameters(epsilon=0.5), proposer, 4, 5, seed=1)
    before = snapshot(brain.networks())
    for state in states(20, 4, 5):
        brain.act(state, explore=False)
        brain.act(state, explore=True)
    assert same(before, brain.networks())


def test_training_after_a_test_starts_from_the_last_step_of_the_test():
    brain = Neurocontroller(Parameters(), "fixed", 2, 5, seed=1)
    sensed = states(3, 2, 5)
    slow = SlowBrain(brain.networks(), 0, Parameters())
    for state in sensed[:2]:
        action = brain.act(state, explore=False)
    slow.before = (sensed[1, 0].double(), action[0].double())
    action = brain.act(sensed[2], explore=False)
    error = brain.learn(torch.tensor([0.5, -0.5]))
    expected = slow.arrive(sensed[2, 0].double(), action[0].double(), 0.5)
    assert error[0].item() == pytest.approx(expected, abs=1e-5)


@every_proposer
@pytest.mark.parametrize("placed", [[1], [0, 3], [0, 1, 2, 3], None])
def test_a_robot_placed_elsewhere_does_not_learn_across_and_others_do(proposer, placed):
    across = Neurocontroller(Parameters(), proposer, 4, 5, seed=2)
    anew = Neurocontroller(Parameters(), proposer, 4, 5, seed=2)
    sensed = states(4, 4, 5)
    reward = torch.tensor([0.3, -0.7, 0.5, -0.2])
    for brain in (across, anew):
        for state in sensed[:2]:
            brain.act(state, explore=False)
            brain.learn(reward)
    before = snapshot(anew.networks())
    anew.forget_step(None if placed is None else torch.tensor(placed))
    errors = []
    for brain in (across, anew):
        brain.act(sensed[2], explore=False)
        errors.append(brain.learn(reward))
    for robot in range(4):
        moved = placed is None or robot in placed
        source = before if moved else across.networks()
        assert errors[1][robot] == (0 if moved else errors[0][robot])
        for name, tensor in anew.networks().items():
            assert torch.equal(tensor[robot], source[name][robot])
    anew.act(sensed[3], explore=False)
    assert anew.learn(reward).abs().min() > 0


def test_changing_a_returned_action_or_a_given_state_does_not_affect_learning():
    careful = Neurocontroller(Parameters(), "creative", 2, 5, seed=3)
    careless = Neurocontroller(Parameters(), "creative", 2, 5, seed=3)
    for state in states(5, 2, 5):
        careful.act(state.clone(), explore=False)
        sensed = state.clone()
        careless.act(sensed, explore=False).fill_(9)
        sensed.fill_(9)
        careful.learn(torch.ones(2))
        careless.learn(torch.ones(2))
    assert same(careful.networks(), careless.networks())


# Independence


def test_robots_behave_the_same_alone_and_in_a_batch():
    parameters = Parameters(learn_rate=0.1)
    together = Neurocontroller(parameters, "fixed", 4, 5, seed=5)
    alone = [Neurocontroller(parameters, "fixed", 1, 5, seed=0) for _ in range(4)]
    for robot, brain in enumerate(alone):
        brain.load_networks({k: t[robot : robot + 1] for k, t in together.networks().items()})
    for state in states(30, 4, 5):
        actions = together.act(state, explore=False)
        errors = together.learn(state[:, 0])
        for robot, brain in enumerate(alone):
            row = slice(robot, robot + 1)
            assert torch.equal(brain.act(state[row], explore=False), actions[row])
            torch.testing.assert_close(
                brain.learn(state[row, 0]), errors[row], atol=1e-5, rtol=1e-5
            )
    for robot, brain in enumerate(alone):
        for name, tensor in brain.networks().items():
            own = together.networks()[name][robot : robot + 1]
            torch.testing.assert_close(tensor, own, atol=1e-5, rtol=1e-5)


SENSES = Senses((Signal(0.0, 1.0, 10.0), *[Signal(-1.0, 1.0)] * 4), Signal(0.0, 1.0, 10.0))


@pytest.mark.parametrize(
    "parameters",
    [Parameters(), Parameters(stopping_steps=1), BRAINS["steady"]],
    ids=["paper", "stopping", "steady"],
)
def test_signals_of_one_robot_do_not_affect_others(parameters):
    one, other = (
        Neurocontroller(parameters, "creative", 3, 5, seed=5, senses=SENSES) for _ in range(2)
    )
    for state in states(50, 3, 5):
        changed = state.clone()
        changed[1] = -changed[1]
        first, second = one.act(state, explore=True), other.act(changed, explore=True)
        assert torch.equal(first[[0, 2]], second[[0, 2]])
        one.learn(state[:, 0])
        other.learn(changed[:, 0])
    for name, tensor in one.networks().items():
        assert torch.equal(tensor[[0, 2]], other.networks()[name][[0, 2]])
        assert not torch.equal(tensor[1], other.networks()[name][1])


# Epsilon-greedy


def exploratory(brain, state, explore):
    """Indices of the selected fixed actions that are not the best, and of the best ones."""
    motors = torch.tensor(Parameters().fixed_motors)
    grid = torch.cartesian_prod(motors, motors)
    best = brain.evaluation.values(state, grid.expand(len(state), -1, -1)).argmax(dim=1)
    actions = brain.act(state, explore=explore)
    selected = (actions[:, None] == grid).all(-1).long().argmax(dim=1)
    return selected[selected != best], best


def test_without_exploration_the_best_action_is_selected():
    brain = Neurocontroller(Parameters(epsilon=1.0), "fixed", 500, 5, seed=6)
    for state in states(10, 500, 5):
        assert len(exploratory(brain, state, explore=False)[0]) == 0


def test_with_epsilon_zero_the_best_action_is_selected():
    brain = Neurocontroller(Parameters(epsilon=0.0), "fixed", 500, 5, seed=6)
    for state in states(10, 500, 5):
        assert len(exploratory(brain, state, explore=True)[0]) == 0


@pytest.mark.parametrize("epsilon", [0.01, 0.3])
def test_a_share_of_epsilon_of_the_actions_is_exploratory(epsilon):
    brain = Neurocontroller(Parameters(epsilon=epsilon), "fixed", 2000, 5, seed=6)
    count = sum(len(exploratory(brain, state, explore=True)[0]) for state in states(20, 2000, 5))
    # One of 25 exploratory actions is the best one.
    assert stats.binomtest(count, 20 * 2000, epsilon * 24 / 25).pvalue > 0.001
    assert stats.binomtest(count, 20 * 2000, epsilon * 0.6).pvalue < 0.001


def test_exploratory_actions_are_uniform_over_all_actions():
    brain = Neurocontroller(Parameters(epsilon=1.0), "fixed", 5000, 1, seed=6)
    motors = torch.tensor(Parameters().fixed_motors)
    grid = torch.cartesian_prod(motors, motors)
    actions = brain.act(states(1, 5000, 1)[0], explore=True)
    counts = (actions[:, None] == grid).all(-1).sum(0)
    assert counts.sum() == 5000
    assert stats.chisquare(counts.numpy()).pvalue > 0.001


def test_robots_explore_independently():
    brain = Neurocontroller(Parameters(epsilon=0.5), "fixed", 1000, 1, seed=7)
    counts = [len(exploratory(brain, state, explore=True)[0]) for state in states(30, 1000, 1)]
    share = 0.5 * 24 / 25
    squares = sum((c - 1000 * share) ** 2 for c in counts) / (1000 * share * (1 - share))
    assert 0.001 < stats.chi2(30).cdf(squares) < 0.999


def test_tests_explore_with_the_epsilon_of_tests():
    brain = Neurocontroller(Parameters(test_epsilon=0.3), "fixed", 2000, 5, seed=6)
    count = sum(len(exploratory(brain, s, explore=False)[0]) for s in states(20, 2000, 5))
    assert stats.binomtest(count, 20 * 2000, 0.3 * 24 / 25).pvalue > 0.001


@every_proposer
def test_an_action_is_one_motor_value_per_wheel(proposer):
    brain = Neurocontroller(Parameters(epsilon=0.5), proposer, 7, 1, seed=6)
    for state in states(20, 7, 1):
        actions = brain.act(state, explore=True)
        assert actions.shape == (7, 2)
        assert actions.abs().max() <= 0.5


# Initial brains, and checkpoints


@every_proposer
def test_a_seed_determines_a_life(proposer):
    def life(seed):
        brain = Neurocontroller(Parameters(epsilon=0.2), proposer, 3, 5, seed)
        for state in states(10, 3, 5):
            brain.act(state, explore=True)
            brain.learn(state[:, 0])
        return snapshot(brain.state())

    assert same(life(8), life(8))
    assert not same(life(8), life(9))


@every_proposer
def test_only_creative_robots_have_a_memory(proposer):
    brain = Neurocontroller(Parameters(), proposer, 3, 5, seed=1)
    owners = {name.split(".")[0] for name in brain.networks()}
    assert owners == ({"evaluation", "memory"} if proposer == "creative" else {"evaluation"})
    assert brain.networks()["evaluation.hidden_weights"].shape == (3, 7, 7)
    if proposer == "creative":
        assert brain.networks()["memory.hidden_weights"].shape == (3, 5, 5)
        assert brain.networks()["memory.output_weights"].shape == (3, 2, 5)


def test_an_unknown_proposer_is_refused_by_name():
    with pytest.raises(ValueError, match="got 'oracle'"):
        Neurocontroller(Parameters(), "oracle", 1, 1, seed=1)


def run(brain, sensed):
    actions = []
    for index, state in enumerate(sensed):
        if index % 7 == 3:
            brain.forget_step(torch.tensor([index % 3]))
        actions.append(brain.act(state, explore=index % 2 == 0))
        if index % 5:
            brain.learn(state[:, 0])
    return actions


@every_proposer
@pytest.mark.parametrize("steps", [0, 1, 5, 6, 10])
def test_a_brain_continues_bit_exactly_from_its_state(proposer, steps, monkeypatch):
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 6)  # so that the pool is redrawn
    monkeypatch.setattr(NoisePatterns, "POOL", 256)
    parameters = Parameters(epsilon=0.3, learn_rate=0.1)
    first = Neurocontroller(parameters, proposer, 3, 5, seed=10)
    sensed = states(30, 3, 5)
    run(first, sensed[:steps])
    kept = snapshot(first.state())
    second = Neurocontroller(parameters, proposer, 3, 5, seed=999)
    run(second, sensed[:3])
    second.load_state(kept)
    assert same(second.state(), kept)
    for one, other in zip(run(first, sensed[steps:]), run(second, sensed[steps:]), strict=True):
        assert torch.equal(one, other)
    assert same(second.state(), first.state())


@pytest.mark.parametrize("proposer", ["fixed", "creative"])
def test_a_state_with_a_missing_or_misshapen_tensor_is_refused_and_changes_nothing(proposer):
    brain = Neurocontroller(Parameters(), proposer, 3, 5, seed=10)
    other = Neurocontroller(Parameters(), proposer, 3, 5, seed=11)
    run(brain, states(4, 3, 5))
    before, kept = snapshot(brain.state()), snapshot(other.state())
    assert {"generator", "now.state", "now.action", "now.value", "now.chained"} < kept.keys()
    assert ({"noise.pool", "noise.age"} < kept.keys()) == (proposer == "creative")
    for name in kept:
        with pytest.raises(ValueError, match=f"{name} is missing"):
            brain.load_state({k: t for k, t in kept.items() if k != name})
        with pytest.raises(ValueError, match=f"{name} must have shape"):
            brain.load_state(kept | {name: torch.stack([kept[name], kept[name]])})
        assert same(brain.state(), before)


def test_networks_of_another_brain_can_be_loaded():
    brain, other = (Neurocontroller(Parameters(), "creative", 3, 5, seed) for seed in (1, 2))
    brain.load_networks(snapshot(other.networks()))
    assert same(brain.networks(), other.networks())
    state = states(1, 3, 5)[0]
    torch.testing.assert_close(brain.memory.recall(state), other.memory.recall(state))
    with pytest.raises(ValueError, match=r"memory\.\w+ is missing"):
        fixed = Neurocontroller(Parameters(), "fixed", 3, 5, seed=3)
        brain.load_networks(fixed.networks())
    with pytest.raises(ValueError, match=r"evaluation\.hidden_weights must have shape \(3, 7, 7\)"):
        brain.load_networks(Neurocontroller(Parameters(), "creative", 3, 1, seed=3).networks())


@pytest.mark.parametrize("given", [None, Senses(SENSES.state[:2], SENSES.reward)])
def test_a_brain_that_needs_senses_refuses_a_wrong_number_of_signals(given):
    with pytest.raises(
        ValueError, match="senses must give the range of all 3 signals, got (none|2)"
    ):
        Neurocontroller(BRAINS["steady"], "creative", 1, 3, seed=1, senses=given)


# Imports


def test_the_controller_imports_neither_mujoco_nor_other_packages_of_musebot():
    code = "import sys, musebot.controller; print(*sys.modules)"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    modules = set(result.stdout.split())
    assert "torch" in modules
    assert not {"mujoco", "dm_control", "dm_env"} & {name.split(".")[0] for name in modules}
    ours = {name.split(".")[1] for name in modules if name.startswith("musebot.")}
    assert ours == {"controller", "gymnasium_registration"}  # the latter by `import musebot`
