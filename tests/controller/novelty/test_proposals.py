"""Other ways to propose actions: each by hand or by its properties, and all within a brain."""

import dataclasses

import numpy as np
import pytest
import torch
from helpers import ideas_of, proposals_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import BRAINS, CreativeMemory, Neurocontroller, Parameters, RandomActions
from musebot.controller.novelty.action_noise import ActionNoise, cholesky_factor
from musebot.controller.novelty.cross_entropy import CrossEntropy
from musebot.controller.novelty.joined import Joined
from musebot.controller.novelty.main_idea import MainIdeaCopies
from musebot.controller.novelty.sobol import SobolActions
from musebot.controller.senses import Senses, Signal

quick = settings(deadline=None, max_examples=30)

SENSES = Senses((Signal(0.0, 1.0, 10.0), Signal(-1.0, 1.0)), Signal(0.0, 1.0, 10.0))
WAYS = {
    "with main idea": {"keep_main_idea": True},
    "main idea and uniform": {"novelty": "uniform", "keep_main_idea": True},
    "copies": {"novelty": "none"},
    "untrained": {"memory_learns": False},
    "action": {"novelty": "action"},
    "action with main idea": {"novelty": "action", "keep_main_idea": True},
    "uniform": {"novelty": "uniform"},
    "sobol": {"novelty": "sobol"},
    "cross-entropy": {"novelty": "cross_entropy"},
    "learned": {"novelty": "learned"},
    "success rule": {"keep_main_idea": True, "noise_adaptation": 0.1},
}
every_way = pytest.mark.parametrize("way", WAYS)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def steady(way, robots=3, seed=1, **fields):
    parameters = dataclasses.replace(BRAINS["steady"], **(WAYS[way] | fields))
    return Neurocontroller(parameters, "creative", robots, 2, seed, SENSES)


def life(brain, steps, robots=3, seed=0):
    """Lets brains act and learn; returns their actions."""
    random = seeded(seed)
    actions = []
    for _ in range(steps):
        state = torch.rand(robots, 2, generator=random)
        actions.append(brain.act(state, explore=True))
        brain.learn(torch.rand(robots, generator=random))
    return actions


# Each way


def test_copies_are_the_main_idea():
    memory = CreativeMemory(Parameters(), 2, 3, seeded())
    state = torch.rand(2, 3, generator=seeded(1))
    proposed = MainIdeaCopies(memory, 4).propose(state)
    assert torch.equal(proposed, torch.stack([memory.recall(state)] * 4, dim=1))


def test_the_main_idea_precedes_other_actions():
    memory = CreativeMemory(Parameters(), 2, 3, seeded())
    state = torch.rand(2, 3, generator=seeded(1))
    proposed = Joined(MainIdeaCopies(memory, 1), RandomActions(4, seeded(7))).propose(state)
    assert torch.equal(proposed[:, 0], memory.recall(state))
    assert torch.equal(proposed[:, 1:], RandomActions(4, seeded(7)).propose(state))


def test_the_factor_of_three_samples_by_hand():
    # Deviations (-1, 0), (0, -1), (1, 1) in tenths: covariance [[1, .5], [.5, 1]] / 100.
    samples = torch.tensor([[[-0.1, 0.0], [0.0, -0.1], [0.1, 0.1]]])
    expected = torch.tensor([[[0.1, 0.0], [0.05, 0.1 * 0.75**0.5]]])
    torch.testing.assert_close(cholesky_factor(samples), expected)


@quick
@given(st.integers(0, 10**6), st.integers(2, 30))
def test_the_factor_gives_the_covariance_of_the_samples_robot_by_robot(seed, count):
    samples = torch.rand(4, count, 2, generator=seeded(seed), dtype=torch.float64) - 0.5
    factor = cholesky_factor(samples)
    for own, found in zip(samples, factor, strict=True):
        expected = np.cov(own.numpy().T)
        np.testing.assert_allclose((found @ found.T).numpy(), expected, atol=1e-9)
        torch.testing.assert_close(cholesky_factor(own[None])[0], found, atol=1e-6, rtol=1e-6)


def test_samples_without_spread_in_one_or_both_motors_have_a_factor():
    line = torch.tensor([[[0.2, -0.1], [0.2, 0.1]]])
    expected = torch.tensor([[[0.0, 0.0], [0.0, 0.02**0.5]]])
    torch.testing.assert_close(cholesky_factor(line), expected)
    assert torch.equal(cholesky_factor(torch.full((1, 4, 2), 0.25)), torch.zeros(1, 2, 2))


def test_action_noise_has_mean_and_covariance_of_the_memory_in_this_state():
    memory = CreativeMemory(Parameters(noise=0.3), 1, 3, seeded())
    state = torch.rand(1, 3, generator=seeded(1))
    main = memory.recall(state)[0]
    assert main.abs().max() < 0.35  # far enough from the ends, so that nothing is clipped
    proposer = ActionNoise(memory, 50, seeded(2))
    drawn = torch.cat([proposals_of(proposer, state)[0] for _ in range(400)])
    wanted = np.cov(ideas_of(memory, state, 20000)[0].numpy().T)
    torch.testing.assert_close(drawn.mean(0), main, atol=3e-3, rtol=0)
    np.testing.assert_allclose(np.cov(drawn.numpy().T), wanted, atol=0.06 * wanted.max())


def test_without_noise_in_the_connections_there_is_none_on_the_action():
    memory = CreativeMemory(Parameters(noise=0.0), 2, 3, seeded())
    state = torch.rand(2, 3, generator=seeded(1))
    proposed = proposals_of(ActionNoise(memory, 4, seeded()), state)
    expected = memory.recall(state)[:, None].expand(-1, 4, -1)
    torch.testing.assert_close(proposed, expected, atol=1e-6, rtol=0)


def test_sobol_actions_are_the_sequence_shifted_by_one_amount_for_a_robot():
    proposed = SobolActions(5, seeded(3)).propose(torch.zeros(2, 1))
    points = torch.tensor([[0, 0], [1 / 2, 1 / 2], [3 / 4, 1 / 4], [1 / 4, 3 / 4], [3 / 8, 3 / 8]])
    for own in proposed:
        apart = (own - own[0] - points + 0.5) % 1 - 0.5
        torch.testing.assert_close(apart, torch.zeros(5, 2), atol=1e-6, rtol=0)
    assert not torch.equal(proposed[0], proposed[1])


@pytest.mark.parametrize("count", [3, 9, 25])
def test_sobol_actions_are_uniform_each_and_further_apart_than_random_ones(count):
    robots = torch.zeros(2000, 1)
    proposed = SobolActions(count, seeded(4)).propose(robots)
    assert proposed.min() >= -0.5
    assert proposed.max() < 0.5
    for motor in proposed[:, -1].numpy().T + 0.5:
        assert stats.kstest(motor, "uniform").pvalue > 1e-3
    nearest = []
    for actions in (proposed, RandomActions(count, seeded(5)).propose(robots)):
        distances = torch.cdist(actions, actions) + torch.eye(count) * 9
        nearest.append(distances.amin(dim=(1, 2)).mean())
    assert nearest[0] > nearest[1]


def test_the_second_round_by_hand():
    # Eight actions: the elite of two has the mean (0.2, 0) and the deviation (0.1, 0).
    actions = torch.zeros(1, 8, 2)
    actions[0, 2], actions[0, 5] = torch.tensor([0.1, 0.0]), torch.tensor([0.3, 0.0])
    values = torch.tensor([[0.0, 1, 7, 2, 3, 9, 4, 5]])
    normals = torch.tensor([[[0.0, 0.0], [1.0, -1.0], [90.0, -90.0]]])
    second = CrossEntropy(None, 8, seeded()).around(actions, values, normals)
    floor = 0.3 / 12**0.5
    expected = torch.tensor([[[0.2, 0.0], [0.2 + 0.07 + floor, -floor], [0.5, -0.5]]])
    torch.testing.assert_close(second, expected)


@quick
@given(st.integers(0, 10**6), st.integers(1, 30), st.integers(0, 30))
def test_the_second_round_of_a_robot_does_not_depend_on_others(seed, count, others):
    random = seeded(seed)
    actions = torch.rand(3, count, 2, generator=random) - 0.5
    values = torch.rand(3, count, generator=random)
    normals = torch.randn(3, others, 2, generator=random)
    method = CrossEntropy(None, count, random)
    together = method.around(actions, values, normals)
    assert together.shape == (3, others, 2)
    assert (together.abs() <= 0.5).all()
    for robot in range(3):
        row = slice(robot, robot + 1)
        alone = method.around(actions[row], values[row], normals[row])
        torch.testing.assert_close(alone, together[row])


@pytest.mark.parametrize("count", [1, 2, 3, 9, 25])
def test_both_rounds_are_candidates_and_the_second_is_better(count):
    evaluated = []

    def values(state, actions):
        evaluated.append(actions)
        return -(actions - 0.3).square().sum(dim=-1)

    proposed = CrossEntropy(values, count, seeded()).propose(torch.zeros(400, 1))
    first, second = proposed.split([-(-count // 2), count // 2], dim=1)
    assert len(evaluated) == 1
    assert torch.equal(evaluated[0], first)
    if count > 2:  # of a single action, the elite is no choice
        assert values(None, second).mean() > values(None, first).mean() + 0.05


# Within a brain


@every_way
@pytest.mark.parametrize("ideas", [1, 2, 3, 9, 25])
@pytest.mark.parametrize("share", [0.0, 0.32])
def test_every_way_has_equally_many_candidates(way, ideas, share):
    if way == "success rule" and ideas - round(share * ideas) < 2:
        with pytest.raises(ValueError, match="at least 2 ideas"):
            steady(way, ideas=ideas, random_share=share)
        return
    brain = steady(way, ideas=ideas, random_share=share)
    proposed = brain.propose(torch.rand(3, 2, generator=seeded()))
    assert proposed.shape == (3, ideas, 2)
    assert (proposed.abs() <= 0.5).all()
    brain.act(torch.rand(3, 2, generator=seeded()), explore=False)


@every_way
def test_a_brain_continues_bit_exactly_from_its_checkpoint(way):
    first, second = steady(way), steady(way, seed=2)
    life(first, 7)
    second.load_state({name: tensor.clone() for name, tensor in first.state().items()})
    for one, other in zip(life(first, 5, seed=1), life(second, 5, seed=1), strict=True):
        assert torch.equal(one, other)
    for name, tensor in first.state().items():
        assert torch.equal(tensor, second.state()[name]), name


@every_way
def test_a_robot_learns_in_a_batch_as_alone(way):
    together = steady(way)
    alone = [steady(way, robots=1) for _ in range(3)]
    for robot, brain in enumerate(alone):
        row = slice(robot, robot + 1)
        brain.load_networks({n: t[row] for n, t in together.networks().items()})
    random = seeded(6)
    for _ in range(3):
        state, reward = torch.rand(3, 2, generator=random), torch.rand(3, generator=random)
        together.act(state, explore=True)
        steps = {
            name.removeprefix("now."): tensor.clone()
            for name, tensor in together.state().items()
            if name.startswith("now.")
        }
        together.learn(reward)
        for robot, brain in enumerate(alone):
            row = slice(robot, robot + 1)
            # It draws other numbers, so it is given the step that was drawn in the batch.
            brain.act(state[row], explore=True)
            brain._now.load({n: t[row] if t.ndim else t for n, t in steps.items()})
            brain.learn(reward[row])
            for name, tensor in brain.networks().items():
                if name != "memory.noise_scale":  # depends on the numbers that were drawn
                    own = together.networks()[name][row]
                    torch.testing.assert_close(tensor, own, atol=2e-4, rtol=1e-3)


@every_way
def test_only_a_memory_that_proposes_exists_and_only_one_that_learns_changes(way):
    brain = steady(way)
    born = {name: tensor.clone() for name, tensor in brain.networks().items()}
    parts = {name.partition(".")[0] for name in born}
    without = way in ("uniform", "sobol", "cross-entropy")
    assert parts == ({"evaluation"} if without else {"evaluation", "memory"})
    life(brain, 6)
    for name, tensor in brain.networks().items():
        changed = not torch.equal(tensor, born[name])
        assert changed == (way != "untrained" or name.startswith("evaluation")), name


@pytest.mark.parametrize("share", [0.0, 0.32])
@pytest.mark.parametrize(
    ("way", "fields"),
    [
        ("copies", {}),
        ("copies", {"novelty": "connections", "noise": 0.0}),
        ("copies", {"novelty": "action", "noisy_share": 0.0}),
        ("with main idea", {"ideas": 1}),
    ],
)
def test_a_memory_whose_main_idea_is_alone_does_not_learn_from_rounding_errors(way, fields, share):
    brain = steady(way, random_share=share, **fields)
    if fields.get("ideas") == 1:
        share = 0  # one idea is never random
    born = brain.networks()["memory.hidden_weights"].clone()
    life(brain, 30)
    assert torch.equal(brain.networks()["memory.hidden_weights"], born) == (share == 0)


def test_uniform_ideas_without_the_main_idea_are_those_of_the_random_proposer():
    one = steady("uniform", random_share=0.0)
    other = Neurocontroller(BRAINS["steady"], "random", 3, 2, 1, SENSES)
    state = torch.rand(3, 2, generator=seeded())
    assert torch.equal(one.propose(state), other.propose(state))


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"novelty": "luck"}, "novelty must be 'connections' or 'none' or"),
        ({"noise_adaptation": -0.1}, "noise_adaptation must lie in"),
        ({"memory_learns": 1}, "memory_learns must be true or false"),
        ({"novelty": "sobol", "memory_learns": False}, "memory_learns false needs a memory"),
        (
            {"novelty": "sobol", "keep_main_idea": True, "ideas": 1},
            "novelty 'sobol' with keep_main_idea needs at least 2 ideas that are not random, got 1",
        ),
        (
            {"novelty": "cross_entropy", "keep_main_idea": True, "random_share": 0.99},
            "novelty 'cross_entropy' with keep_main_idea needs at least 2 ideas",
        ),
        ({"novelty": "learned"}, "novelty 'learned' needs memory_target 'best'"),
        ({"novelty": "action", "noise_steps": 0}, "novelty 'action' needs noise_steps 1, got 0"),
        ({"noise_adaptation": 0.1}, "noise_adaptation needs keep_main_idea"),
        (
            {"noise_adaptation": 0.1, "novelty": "sobol"},
            "noise_adaptation needs novelty 'connections', got 'sobol'",
        ),
        (
            {"noise_adaptation": 0.1, "keep_main_idea": True, "noise": 0},
            "noise_adaptation needs noise and noisy_share above 0",
        ),
        (
            {"noise_adaptation": 0.1, "keep_main_idea": True, "noisy_share": 0},
            "noise_adaptation needs noise and noisy_share above 0",
        ),
        (
            {"noise_adaptation": 0.1, "keep_main_idea": True, "ideas": 1},
            "noise_adaptation needs .* at least 2 ideas of the memory$",
        ),
        (
            {"noise_adaptation": 0.1, "keep_main_idea": True, "stopping_steps": 5},
            "noise_adaptation and stopping_steps exclude each other",
        ),
        (
            {"separate_smell": True, "context_neurons": 2},
            "separate_smell and context_neurons exclude each other",
        ),
        (
            {"separate_smell": True, "evaluation_hidden": 1},
            "separate_smell needs evaluation_hidden of at least 2",
        ),
        (
            {"stopping_steps": 5, "test_epsilon": 0.1},
            "stopping_steps and test_epsilon exclude each other",
        ),
    ],
)
def test_fields_that_exclude_each_other_are_refused_in_a_sentence(fields, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        Parameters(**fields)
