"""Noise patterns and ideas of the creative memory, against slow oracles."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import CreativeMemory, NoisePatterns, Parameters
from musebot.controller.networks import load_into

quick = settings(deadline=None, max_examples=30)


def draw_from(patterns, count):
    """Returns so many noise patterns of a new step."""
    patterns.renew()
    return patterns.draw(count)


def ideas_of(memory, state, count):
    """Returns so many ideas of a new step for each robot."""
    memory.patterns.renew()
    return memory.ideas(state, count)


# Noise patterns


def deviations(patterns, noisy, noise):
    """Finds deviations of patterns, shape (M, N), from independent draws.

    Each should have exactly `noisy` of its N connections at +-noise, at uniform places and
    with independent fair signs. A correct sampler deviates in fewer than 1 of 100 draws.
    """
    count, connections = patterns.shape
    at, plus = patterns != 0, patterns > 0
    found = set()
    if not (at.sum(1) == noisy).all():
        found.add("number")
    if not torch.equal(patterns[at].abs(), torch.full((int(at.sum()),), noise)):
        found.add("size")

    # Drawing without replacement makes the places of a pattern negatively correlated; with
    # the factor (N - 1) / N the sum is chi-square distributed with N - 1 degrees of freedom.
    share = noisy / connections
    excess = at.sum(0).double() - count * share
    place = (excess**2).sum() / (count * share * (1 - share))
    place *= (connections - 1) / connections
    if not 0.001 < stats.chi2(connections - 1).cdf(place.item()) < 0.999:
        found.add("places")

    # How often two places are noisy together: binomial for each pair.
    both = (at.double().T @ at.double())[*torch.triu_indices(connections, connections, 1)]
    chance = share * (noisy - 1) / (connections - 1)
    z = (both - count * chance).abs() / (count * chance * (1 - chance)) ** 0.5
    if 2 * len(z) * stats.norm.sf(z.max().item()) < 0.001:
        found.add("pairs of places")

    # Given the places, the signs are independent tosses of a fair coin.
    heads, tosses = plus.sum(0).double(), at.sum(0).double()
    sign = ((2 * heads - tosses) ** 2 / tosses.clamp(min=1)).sum()
    if not 0.001 < stats.chi2(connections).cdf(sign.item()) < 0.999:
        found.add("signs")
    squares = (patterns.sign().sum(1).double() ** 2).sum() - count * noisy
    if squares.abs() > 4 * (2 * noisy * (noisy - 1) * count) ** 0.5:
        found.add("signs within a pattern")
    return found


def new_patterns(connections=15, seed=2):
    patterns = NoisePatterns(connections, 0.25, 0.76, torch.Generator().manual_seed(seed))
    draw_from(patterns, 1)
    return patterns, patterns.tensors()["pool"]


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
    assert ((held != 0).sum(1) == memory.patterns.noisy).all()
    assert len(held.unique(dim=0)) > 900
    held[:] = 9  # the ideas may change what they are given
    if steps == 0:
        assert not (draw_from(memory.patterns, 2000) == 9).any()


@pytest.mark.parametrize("connections", [15, 35])
def test_a_constant_is_added_or_subtracted_in_a_quarter_of_the_connections_at_random(connections):
    patterns, pool = new_patterns(connections, seed=11)
    assert deviations(pool, patterns.noisy, 0.76) == set()


def wrong_sampler(kind, connections=35, noisy=9, count=16384, noise=0.76):
    generator = torch.Generator().manual_seed(11)
    keys = torch.rand(count, connections, generator=generator)
    signs = torch.randint(2, (count, noisy), generator=generator) * 2.0 - 1.0
    if kind == "biased places":
        keys *= 1 + 0.005 * torch.arange(connections)
    chosen = keys.argsort(dim=1)[:, :noisy]
    if kind == "the same places":
        chosen = chosen[:1].expand(count, -1)
    if kind == "with replacement":
        chosen = torch.randint(connections, (count, noisy), generator=generator)
    if kind == "places side by side":
        first = torch.randint(connections, (count, 1), generator=generator)
        chosen = (first + torch.arange(noisy)) % connections
    if kind == "biased signs":
        signs = (torch.rand(signs.shape, generator=generator) < 0.51) * 2.0 - 1.0
    if kind == "one sign a pattern":
        signs = signs[:, :1].expand(-1, noisy)
    if kind == "noise of any size":
        signs = torch.rand(signs.shape, generator=generator) * 2 - 1
    return torch.zeros(count, connections).scatter_(1, chosen, noise * signs)


@pytest.mark.parametrize(
    ("kind", "deviation"),
    [
        ("biased places", "places"),
        ("the same places", "places"),
        ("with replacement", "number"),
        ("places side by side", "pairs of places"),
        ("biased signs", "signs"),
        ("one sign a pattern", "signs within a pattern"),
        ("noise of any size", "size"),
    ],
)
def test_the_check_detects_a_wrong_sampler(kind, deviation):
    assert deviations(wrong_sampler("none"), 9, 0.76) == set()
    assert deviation in deviations(wrong_sampler(kind), 9, 0.76)


@pytest.mark.parametrize("sensors", [5, 1])
@pytest.mark.parametrize("on_biases", [False, True])
def test_connections_are_the_weights_and_also_the_biases_if_they_count(sensors, on_biases):
    parameters = Parameters(noise_on_biases=on_biases)
    memory = CreativeMemory(parameters, 1, sensors, torch.Generator().manual_seed(0))
    connections = 5 * sensors + 2 * 5 + on_biases * (5 + 2)  # five hidden neurons, two motors
    assert draw_from(memory.patterns, 10).shape == (10, connections)
    assert memory.patterns.noisy == round(connections / 4)


@quick
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


def record_patterns(memory):
    """Records a copy of every pattern that the memory draws."""
    drawn, draw = [], memory.patterns.draw

    def recorded(count):
        patterns = draw(count)
        drawn.append(patterns.clone())
        return patterns

    memory.patterns.draw = recorded
    return drawn


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


@quick
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
    drawn = record_patterns(memory)
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


def test_noise_differs_between_ideas_robots_and_steps():
    memory, state = initial(6, 5, seed=1)
    alike = {k: t[:1].expand_as(t) for k, t in memory.networks.tensors().items()}
    load_into(memory.networks.tensors(), {k: t.clone() for k, t in alike.items()})
    state = state[:1].expand(6, -1)
    ideas = torch.stack([ideas_of(memory, state, 25) for _ in range(4)])
    different = len(ideas.reshape(-1, 2).unique(dim=0))
    assert different > 0.95 * 4 * 6 * 25  # the pool holds 16384, two may take the same


def test_making_ideas_changes_neither_the_pool_nor_the_networks():
    memory, state = initial(4, 5, seed=1, keep_main_idea=True)
    before = memory.networks.weights.clone()
    ideas_of(memory, state, 25)
    pool = memory.patterns.tensors()["pool"].clone()
    memory.ideas(state, 25)
    assert torch.equal(memory.patterns.tensors()["pool"], pool)
    assert ((pool != 0).sum(1) == 9).all()
    assert torch.equal(memory.networks.weights, before)
