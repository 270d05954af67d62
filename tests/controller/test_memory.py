"""The creative memory: noise patterns, ideas, and back-propagation, against slow oracles."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import CreativeMemory, NoisePatterns, Parameters

quick = settings(deadline=None, max_examples=30)


# Noise patterns


def complaints(patterns, noisy, noise):
    """What is wrong with patterns, shape (M, N), that should be drawn independently.

    Each should have exactly `noisy` of its N connections at +-noise, at uniform places and
    with independent fair signs. A fair sampler gets a complaint in fewer than 1 of 100 draws.
    """
    count, connections = patterns.shape
    at, plus = patterns != 0, patterns > 0
    found = set()
    if not (at.sum(1) == noisy).all():
        found.add("number")
    if not torch.equal(patterns[at].abs(), torch.full((int(at.sum()),), noise)):
        found.add("size")

    # Drawing without replacement makes the places of a pattern repel each other; the factor
    # (N - 1) / N makes the sum a chi-square variable of N - 1 degrees of freedom again.
    share = noisy / connections
    deviations = at.sum(0).double() - count * share
    place = (deviations**2).sum() / (count * share * (1 - share))
    place *= (connections - 1) / connections
    if not 0.001 < stats.chi2(connections - 1).cdf(place.item()) < 0.999:
        found.add("places")

    # How often two places are noisy together: binomial for each pair.
    both = (at.double().T @ at.double())[*torch.triu_indices(connections, connections, 1)]
    chance = share * (noisy - 1) / (connections - 1)
    z = (both - count * chance).abs() / (count * chance * (1 - chance)) ** 0.5
    if 2 * len(z) * stats.norm.sf(z.max().item()) < 0.001:
        found.add("pairs of places")

    # Given the places, the signs are independent throws of a coin.
    heads, throws = plus.sum(0).double(), at.sum(0).double()
    sign = ((2 * heads - throws) ** 2 / throws.clamp(min=1)).sum()
    if not 0.001 < stats.chi2(connections).cdf(sign.item()) < 0.999:
        found.add("signs")
    squares = (patterns.sign().sum(1).double() ** 2).sum() - count * noisy
    if squares.abs() > 4 * (2 * noisy * (noisy - 1) * count) ** 0.5:
        found.add("signs within a pattern")
    return found


def fresh_pool(connections, seed, share=0.25, noise=0.76):
    patterns = NoisePatterns(connections, share, noise, torch.Generator().manual_seed(seed))
    patterns.draw(1)
    return patterns.tensors()["pool"], patterns.noisy


@pytest.mark.parametrize("connections", [15, 35])
def test_patterns_have_their_number_of_noisy_connections_at_fair_places_with_fair_signs(
    connections,
):
    pool, noisy = fresh_pool(connections, seed=11)
    assert complaints(pool, noisy, 0.76) == set()


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
    ("kind", "complaint"),
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
def test_that_check_complains_of_a_wrong_sampler(kind, complaint):
    assert complaints(wrong_sampler("none"), 9, 0.76) == set()
    assert complaint in complaints(wrong_sampler(kind), 9, 0.76)


@pytest.mark.parametrize(
    ("sensors", "connections", "noisy"), [(5, 35, 9), (1, 15, 4)], ids=["walls", "spot"]
)
def test_a_quarter_of_the_memorys_connections_is_noisy(sensors, connections, noisy):
    memory = CreativeMemory(Parameters(), 1, sensors, torch.Generator().manual_seed(0))
    patterns = memory.patterns.draw(1000)
    assert patterns.shape == (1000, connections)
    assert ((patterns != 0).sum(1) == noisy).all()
    assert set(patterns.unique().tolist()) == set(torch.tensor([-0.76, 0.0, 0.76]).tolist())
    assert noisy * 0.76 / connections == pytest.approx(0.19, abs=0.015)


@pytest.mark.parametrize(("sensors", "connections"), [(5, 42), (1, 22)])
def test_biases_are_connections_only_where_noise_falls_on_them(sensors, connections):
    parameters = Parameters(noise_on_biases=True)
    memory = CreativeMemory(parameters, 1, sensors, torch.Generator().manual_seed(0))
    patterns = memory.patterns.draw(10)
    assert patterns.shape == (10, connections)
    assert ((patterns != 0).sum(1) - connections / 4).abs().max() <= 0.5


@quick
@given(st.integers(1, 60), st.floats(0, 1), st.integers(0, 2**31))
def test_the_number_of_noisy_connections_is_the_share_to_the_nearest(connections, share, seed):
    class Small(NoisePatterns):
        POOL = 8

    patterns = Small(connections, share, 1.0, torch.Generator().manual_seed(seed)).draw(20)
    counts = (patterns != 0).sum(1)
    assert counts.min() == counts.max()
    assert abs(counts[0].item() - share * connections) <= 0.5 + 1e-9


def test_ideas_take_patterns_from_all_over_the_pool():
    patterns = NoisePatterns(15, 0.25, 0.76, torch.Generator().manual_seed(2))
    patterns.draw(1)
    pool = patterns.tensors()["pool"]
    pool[:, 0] = torch.arange(len(pool))
    taken = patterns.draw(20 * len(pool))[:, 0].long().bincount(minlength=len(pool))
    assert stats.chisquare(taken.numpy()).pvalue > 0.001


def test_the_pool_is_drawn_anew_after_its_lifetime_and_not_before():
    class Small(NoisePatterns):
        POOL = 64

    patterns = Small(15, 0.25, 0.76, torch.Generator().manual_seed(2))
    pool = patterns.tensors()["pool"]
    before = pool.clone()
    for _ in range(3):
        patterns.draw(2)
        assert not torch.equal(pool, before)
        before = pool.clone()
        for _ in range(Small.LIFETIME - 1):
            drawn = patterns.draw(2)
            assert torch.equal(pool, before)
        assert (drawn[:, None] == pool).all(-1).any(1).all()


def test_what_is_done_to_a_drawn_pattern_does_not_reach_the_pool():
    patterns = NoisePatterns(15, 0.25, 0.76, torch.Generator().manual_seed(2))
    drawn = patterns.draw(100)
    pool = patterns.tensors()["pool"].clone()
    drawn.fill_(7)
    assert torch.equal(patterns.tensors()["pool"], pool)


# Ideas


def born(robots, sensors, seed, **fields):
    generator = torch.Generator().manual_seed(seed)
    memory = CreativeMemory(Parameters(**fields), robots, sensors, generator)
    return memory, torch.rand(robots, sensors, generator=generator) * 3 - 1.5


def tap(memory):
    """Keeps a copy of every pattern that the memory draws from now on."""
    drawn, draw = [], memory.patterns.draw

    def recorded(count):
        patterns = draw(count)
        drawn.append(patterns.clone())
        return patterns

    memory.patterns.draw = recorded
    return drawn


def motors(w, x):
    """A memory network by the textbook: logistic everywhere, [0, 1] moved to [-0.5, 0.5]."""
    hidden = torch.sigmoid(w["hidden_weights"] @ x + w["hidden_biases"])
    return torch.sigmoid(w["output_weights"] @ hidden + w["output_biases"]) - 0.5


def noisy_network(w, pattern, on_biases):
    """W + N, built in full: sensor weights, motor weights, and the biases where they count."""
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
def test_ideas_are_what_networks_with_noisy_connections_do(robots, sensors, seed, **fields):
    memory, state = born(robots, sensors, seed, **fields)
    drawn = tap(memory)
    ideas = memory.ideas(state)
    assert ideas.shape == (robots, fields["ideas"], 2)
    assert ideas.abs().max() <= 0.5
    patterns = drawn[0].view(robots, fields["ideas"], -1)
    for robot in range(robots):
        w = {k: t[robot].double() for k, t in memory.networks.tensors().items()}
        for index in range(fields["ideas"]):
            noisy = noisy_network(w, patterns[robot, index], fields["noise_on_biases"])
            if fields["keep_main_idea"] and index == 0:
                noisy = w
            wanted = motors(noisy, state[robot].double())
            torch.testing.assert_close(ideas[robot, index].double(), wanted, atol=1e-5, rtol=0)


def test_every_idea_of_every_robot_and_step_has_noise_of_its_own():
    memory, state = born(6, 5, seed=1)
    alike = {k: t[:1].expand_as(t) for k, t in memory.networks.tensors().items()}
    memory.networks.load({k: t.clone() for k, t in alike.items()})
    state = state[:1].expand(6, -1)
    ideas = torch.stack([memory.ideas(state) for _ in range(4)])
    different = len(ideas.reshape(-1, 2).unique(dim=0))
    assert different > 0.95 * 4 * 6 * 25  # the pool holds 16384, two may take the same


def test_the_main_idea_comes_first_where_it_is_kept_and_nowhere_else():
    memory, state = born(4, 5, seed=1, keep_main_idea=True)
    torch.testing.assert_close(memory.ideas(state)[:, 0], memory.recall(state))
    memory, state = born(4, 5, seed=1)
    assert (memory.ideas(state) - memory.recall(state)[:, None]).abs().amax(-1).min() > 1e-4


def test_keeping_the_main_idea_does_not_rub_noise_out_of_the_pool():
    memory, state = born(4, 5, seed=1, keep_main_idea=True)
    memory.ideas(state)
    assert ((memory.patterns.tensors()["pool"] != 0).sum(1) == 9).all()


def test_without_noise_every_idea_is_the_main_idea():
    memory, state = born(4, 5, seed=1, noise=0.0, noise_on_biases=True)
    main = memory.recall(state)[:, None].expand(-1, 25, -1)
    torch.testing.assert_close(memory.ideas(state), main, atol=1e-6, rtol=0)


def test_having_ideas_changes_no_connection():
    memory, state = born(4, 5, seed=1)
    before = {k: t.clone() for k, t in memory.networks.tensors().items()}
    memory.ideas(state)
    assert all(torch.equal(before[k], t) for k, t in memory.networks.tensors().items())


def test_a_robot_has_the_same_ideas_alone_and_among_others():
    memory, state = born(5, 5, seed=3)
    drawn = tap(memory)
    together = memory.ideas(state)
    for robot in range(5):
        row = slice(robot, robot + 1)
        alone, _ = born(1, 5, seed=0)
        alone.networks.load({k: t[row] for k, t in memory.networks.tensors().items()})
        own = drawn[0].view(5, 25, -1)[robot]
        alone.patterns.draw = lambda count, own=own: own.clone()
        torch.testing.assert_close(alone.ideas(state[row]), together[row], atol=1e-6, rtol=0)


# Learning


@quick
@given(
    robots=st.integers(1, 4),
    sensors=st.integers(1, 5),
    seed=st.integers(0, 2**31),
    memory_hidden=st.integers(1, 6),
    data=st.data(),
)
def test_learning_is_gradient_descent_on_half_the_squared_error_in_the_outputs_of_0_to_1(
    robots, sensors, seed, memory_hidden, data
):
    memory, state = born(robots, sensors, seed, memory_hidden=memory_hidden)
    rate = st.floats(-2, 2, width=32)
    rates = torch.tensor(data.draw(st.lists(rate, min_size=robots, max_size=robots)))
    action = torch.rand(robots, 2, generator=torch.Generator().manual_seed(seed)) - 0.5
    wanted = []
    for robot in range(robots):
        w = {
            k: t[robot].double().clone().requires_grad_()
            for k, t in memory.networks.tensors().items()
        }
        outputs = motors(w, state[robot].double()) + 0.5
        ((action[robot].double() + 0.5 - outputs) ** 2 / 2).sum().backward()
        wanted.append({k: (t - rates[robot] * t.grad).detach() for k, t in w.items()})
    memory.learn(state, action, rates)
    for robot, after in enumerate(wanted):
        for name, tensor in memory.networks.tensors().items():
            torch.testing.assert_close(tensor[robot].double(), after[name], atol=1e-5, rtol=0)


def test_a_positive_rate_draws_the_main_idea_to_the_action_and_a_negative_one_away():
    memory, state = born(2, 5, seed=4)
    state, action = state[:1].expand(2, -1), torch.tensor([[0.3, -0.2]]).expand(2, -1)
    memory.networks.load(
        {k: t[:1].expand_as(t).clone() for k, t in memory.networks.tensors().items()}
    )
    before = (memory.recall(state) - action).norm(dim=1)
    memory.learn(state, action, torch.tensor([0.5, -0.5]))
    after = (memory.recall(state) - action).norm(dim=1)
    assert after[0] < before[0]
    assert after[1] > before[1]


def test_what_is_repeated_is_remembered():
    memory, state = born(3, 5, seed=5)
    action = torch.tensor([[0.4, -0.4], [0.0, 0.0], [-0.3, 0.2]])
    for _ in range(2000):
        memory.learn(state, action, torch.ones(3))
    torch.testing.assert_close(memory.recall(state), action, atol=0.02, rtol=0)
