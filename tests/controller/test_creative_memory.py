"""Noise patterns and ideas of the creative memory, against slow oracles."""

import pytest
import torch
from helpers import recorded
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import Parameters
from musebot.controller.creative_memory import CreativeMemory, NoisePatterns


def draw_from(patterns, count):
    """Returns so many noise patterns of a new step."""
    patterns.renew()
    return patterns.draw(count)


def ideas_of(memory, state, count):
    """Returns so many ideas of a new step for each robot."""
    memory.patterns.renew()
    return memory.ideas(state, count)


# Noise patterns


def new_patterns(connections=15, seed=2):
    patterns = NoisePatterns(connections, 0.25, 0.76, torch.Generator().manual_seed(seed))
    draw_from(patterns, 1)
    return patterns, patterns.tensors()["pool"]


@pytest.mark.parametrize("connections", [15, 35])
def test_a_constant_is_added_or_subtracted_in_a_quarter_of_the_connections_at_random(connections):
    """Each check fails in fewer than 1 of 500 correct samples."""
    patterns, pool = new_patterns(connections, seed=11)
    count, noisy = len(pool), patterns.noisy
    at, plus = pool != 0, pool > 0
    assert (at.sum(1) == noisy).all()
    assert torch.equal(pool[at].abs(), torch.full((count * noisy,), 0.76))

    # Drawing without replacement makes the places of a pattern negatively correlated; with
    # the factor (N - 1) / N the sum is chi-square distributed with N - 1 degrees of freedom.
    share = noisy / connections
    excess = at.sum(0).double() - count * share
    place = (excess**2).sum() / (count * share * (1 - share)) * (connections - 1) / connections
    assert 0.001 < stats.chi2(connections - 1).cdf(place.item()) < 0.999

    # How often two places are noisy together: binomial for each pair.
    both = (at.double().T @ at.double())[*torch.triu_indices(connections, connections, 1)]
    chance = share * (noisy - 1) / (connections - 1)
    z = (both - count * chance).abs() / (count * chance * (1 - chance)) ** 0.5
    assert 2 * len(z) * stats.norm.sf(z.max().item()) > 0.001

    # Given the places, the signs are independent tosses of a fair coin.
    heads, tosses = plus.sum(0).double(), at.sum(0).double()
    sign = ((2 * heads - tosses) ** 2 / tosses).sum()
    assert 0.001 < stats.chi2(connections).cdf(sign.item()) < 0.999
    squares = (pool.sign().sum(1).double() ** 2).sum() - count * noisy
    assert squares.abs() < 4 * (2 * noisy * (noisy - 1) * count) ** 0.5


def changes(steps, draws, robots=2):
    """Returns in which of several draws after the first the patterns of a memory are new."""
    parameters = Parameters(noise_steps=steps, ideas=3)
    memory = CreativeMemory(parameters, robots, 1, torch.Generator().manual_seed(5))
    patterns = [draw_from(memory.patterns, 3 * robots) for _ in range(draws)]
    return [not torch.equal(*pair) for pair in zip(patterns, patterns[1:], strict=False)]


def test_ideas_keep_their_noise_for_the_given_steps_for_one_or_for_life():
    assert changes(1, 6) == [True] * 5
    assert changes(2, 7) == [False, True, False, True, False, True]
    assert changes(0, 1200) == [False] * 1199  # longer than the pool of patterns lives


@pytest.mark.parametrize("steps", [0, 4])
def test_held_noise_differs_between_ideas_and_robots_and_is_that_of_the_pool(steps):
    parameters = Parameters(noise_steps=steps, ideas=1000)
    memory = CreativeMemory(parameters, 2, 1, torch.Generator().manual_seed(5))
    held = draw_from(memory.patterns, 2000)
    assert ((held != 0).sum(1) == 4).all()  # of 15, a quarter
    assert len(held.unique(dim=0)) > 900
    held[:] = 9  # the ideas may change what they are given
    if steps == 0:
        assert not (draw_from(memory.patterns, 2000) == 9).any()


@given(st.integers(1, 60), st.floats(0, 1), st.integers(0, 2**31))
def test_the_number_of_noisy_connections_is_rounded_but_not_to_zero(connections, share, seed):
    class Small(NoisePatterns):
        POOL = 8

    small = Small(connections, share, 1.0, torch.Generator().manual_seed(seed))
    patterns = draw_from(small, 20)
    counts = (patterns != 0).sum(1)
    assert counts.min() == counts.max()
    if share == 0:
        assert counts[0] == 0
    elif share * connections < 0.5:
        assert counts[0] == 1
    else:
        assert abs(counts[0].item() - share * connections) <= 0.5 + 1e-9


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_fixed_connections_stay_and_only_their_signs_are_drawn_anew(share):
    patterns = NoisePatterns(15, share, 0.76, torch.Generator().manual_seed(2), robots=300)
    chosen = patterns.fixed.clone()
    assert chosen.shape == (300, round(15 * share))
    assert all(len(set(own)) == len(own) for own in chosen.tolist())
    if share == 0.25:  # each connection is chosen as often, by chance
        assert (chosen.flatten().bincount(minlength=15) - 80).abs().max() < 40
    seen = torch.zeros(300, 15, dtype=torch.bool)
    for _ in range(2 * patterns.LIFETIME // 100):
        patterns.renew(100)
        drawn = draw_from(patterns, 300 * 6).view(300, 6, 15)
        inside = torch.zeros(300, 15, dtype=torch.bool).scatter_(1, chosen, True)
        assert torch.equal(drawn.abs(), 0.76 * inside[:, None].expand(-1, 6, -1))
        seen |= (drawn > 0).any(1) & (drawn < 0).any(1)
    assert torch.equal(seen, inside) and torch.equal(patterns.fixed, chosen)


def test_patterns_are_drawn_uniformly_from_the_pool():
    patterns, pool = new_patterns()
    pool[:, 0] = torch.arange(len(pool))
    taken = draw_from(patterns, 20 * len(pool))[:, 0].long().bincount(minlength=len(pool))
    assert stats.chisquare(taken.numpy()).pvalue > 0.001


def test_the_pool_is_redrawn_after_its_lifetime_and_not_before():
    class Small(NoisePatterns):
        POOL = 64

    patterns = Small(15, 0.25, 0.76, torch.Generator().manual_seed(2))
    pool = patterns.tensors()["pool"]
    before = pool.clone()
    for _ in range(3):
        draw_from(patterns, 2)
        assert not torch.equal(pool, before)
        before = pool.clone()
        for _ in range(Small.LIFETIME - 1):
            drawn = draw_from(patterns, 2)
            assert torch.equal(pool, before)
        assert (drawn[:, None] == pool).all(-1).any(1).all()


# Ideas


def initial(robots, sensors, seed, **fields):
    generator = torch.Generator().manual_seed(seed)
    memory = CreativeMemory(Parameters(**fields), robots, sensors, generator)
    return memory, torch.rand(robots, sensors, generator=generator) * 3 - 1.5


def motors(w, x):
    """A memory network with logistic neurons, its outputs shifted to [-0.5, 0.5]."""
    hidden = torch.sigmoid(w["hidden_weights"] @ x + w["hidden_biases"])
    return torch.sigmoid(w["output_weights"] @ hidden + w["output_biases"]) - 0.5


def noisy_network(w, pattern, on_biases):
    """The noisy network W + N: sensor weights, motor weights, and the biases if they count."""
    names = ["hidden_weights", "output_weights"]
    if on_biases:
        names += ["hidden_biases", "output_biases"]
    pieces = pattern.double().split([w[name].numel() for name in names])
    return w | {n: w[n] + p.view(w[n].shape) for n, p in zip(names, pieces, strict=True)}


@given(
    robots=st.integers(1, 4),
    sensors=st.integers(1, 5),
    seed=st.integers(0, 2**31),
    memory_hidden=st.integers(1, 6),
    ideas=st.integers(1, 25),
    noise=st.floats(0, 2),
    noisy_share=st.floats(0, 1),
    noise_on_biases=st.booleans(),
    keep_main_idea=st.booleans(),
)
def test_ideas_equal_the_outputs_of_noisy_networks(robots, sensors, seed, **fields):
    memory, state = initial(robots, sensors, seed, **fields)
    drawn = recorded(memory.patterns, "draw")
    ideas = ideas_of(memory, state, fields["ideas"])
    assert ideas.shape == (robots, fields["ideas"], 2)
    assert ideas.abs().max() <= 0.5
    patterns = drawn[0].view(robots, fields["ideas"], -1)
    for robot in range(robots):
        w = {k: t[robot].double() for k, t in memory.networks.tensors().items()}
        for index in range(fields["ideas"]):
            noisy = noisy_network(w, patterns[robot, index], fields["noise_on_biases"])
            if fields["keep_main_idea"] and index == 0:
                noisy = w
            expected = motors(noisy, state[robot].double())
            torch.testing.assert_close(ideas[robot, index].double(), expected, atol=1e-5, rtol=0)


def test_making_ideas_changes_neither_the_pool_nor_the_networks():
    memory, state = initial(4, 5, seed=1, keep_main_idea=True)
    before = memory.networks.weights.clone()
    ideas_of(memory, state, 25)
    pool = memory.patterns.tensors()["pool"].clone()
    memory.ideas(state, 25)
    assert torch.equal(memory.patterns.tensors()["pool"], pool)
    assert torch.equal(memory.networks.weights, before)
