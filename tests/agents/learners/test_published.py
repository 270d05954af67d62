"""Learners agree with the published algorithms, written here for one robot without our parts."""

import collections
import functools
import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from torch import nn

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.factory import factory_of
from musebot.protocols.agents.learners.avg import _squashed
from musebot.protocols.agents.learners.dqn import DQN
from musebot.protocols.agents.learners.networks import Adam, LayeredNetworks
from musebot.protocols.agents.learners.obgd import make_sparse
from musebot.protocols.agents.learners.sarsa import SarsaLambda
from musebot.protocols.agents.settings import settings_of

SENSES = Senses((Signal(-1, 1),) * 3, Signal(-1, 1))
ONE = Senses((Signal(0, 1),), Signal(0, 1))


def stream(steps, robots, seed=0):
    random = np.random.default_rng(seed)
    states = random.uniform(-1, 1, size=(steps, robots, 3)).astype(np.float32)
    return states, random.normal(size=(steps, robots)).astype(np.float32)


def networks(agent, name, robot):
    """Returns a robot's layers as modules of PyTorch, with their weights."""
    layers = []
    weights = agent.weights()
    for layer in range(3):
        matrix, biases = (torch.tensor(weights[f"{name}.{2 * layer + k}"][robot]) for k in (0, 1))
        linear = nn.Linear(matrix.shape[1], matrix.shape[0])
        linear.weight.data, linear.bias.data = matrix.clone(), biases.clone()
        layers.append(linear)
    return nn.ModuleList(layers)


class Normalizer:
    """Sample mean and variance as defined, from all samples so far."""

    def __init__(self):
        self.samples = []

    def add(self, x):
        self.samples.append(np.array(x, dtype=float))

    def variance(self, ddof):
        samples = np.array(self.samples)
        return samples.var(axis=0, ddof=ddof) if len(samples) > ddof else np.ones_like(samples[0])

    def normal(self, x, ddof):
        return (x - np.mean(self.samples, axis=0)) / np.sqrt(self.variance(ddof) + 1e-8)


def deep(layers, x):
    for layer in layers[:-1]:
        x = layer(x)
        x = F.leaky_relu(F.layer_norm(x, x.size()))
    return layers[-1](x)


def obgd(parameters, traces, delta, decay, kappa):
    total = 0.0
    for parameter, trace in zip(parameters, traces, strict=True):
        trace.mul_(decay).add_(parameter.grad)
        total += trace.abs().sum().item()
    size = 1 / max(1.0, kappa * max(abs(delta), 1.0) * total)
    for parameter, trace in zip(parameters, traces, strict=True):
        parameter.data += size * delta * trace


def lived(agent, states, rewards, *noted):
    """Lets an agent learn; returns what the second robot noted in each step, in lists."""
    agent.reset()
    notes = []
    for state, reward in zip(states, rewards, strict=True):
        agent.act(state, True)
        notes.append([agent.now[name][1].clone() for name in noted])
        agent.learn(reward)
    return map(list, zip(*notes, strict=True))


def normal_inputs(states):
    """Returns standardised signals, and a 1 where the source has the time."""
    seen, inputs = Normalizer(), []
    for state in states:
        seen.add(state)
        inputs.append(torch.tensor([*seen.normal(state, 1), 1.0], dtype=torch.float32))
    return inputs


def check_networks(agent, name, robot, layers):
    for layer, linear in enumerate(layers):
        for k, wanted in enumerate((linear.weight, linear.bias)):
            ours = agent.weights()[f"{name}.{2 * layer + k}"][robot]
            np.testing.assert_allclose(ours, wanted.detach().numpy(), atol=1e-6)


def scaled_rewards(rewards, discount):
    """Returns rewards divided by the deviation of their discounted sums, from the second step."""
    found, trace, moments = [None], 0.0, Normalizer()
    for reward in rewards[1:]:
        trace = discount * trace + reward
        moments.add(trace)
        found.append(reward / math.sqrt(moments.variance(1) + 1e-8))
    return found


def test_stream_ac_is_the_published_algorithm():
    discount, trace, kappa, entropy = 0.99, 0.8, 2.0, 0.01
    agent = factory_of("stream_ac")(2, SENSES, 3)
    states, rewards = stream(12, 2)
    actor, critic = (networks(agent, name, 1) for name in ("actor", "critic"))
    first = {k: v.copy() for k, v in agent.weights().items()}
    (actions,) = lived(agent, states, rewards, "action")
    inputs = normal_inputs(states[:, 1])
    paid = scaled_rewards(rewards[:, 1], discount)
    traces = [[torch.zeros_like(p) for p in net.parameters()] for net in (actor, critic)]
    for step in range(1, len(states)):
        before, now = inputs[step - 1], inputs[step]
        value = deep(critic, before)
        delta = (paid[step] + discount * deep(critic, now) - value).item()
        mean, sums = deep(actor, before).split(2)
        policy = torch.distributions.Normal(mean, F.softplus(sums))
        likely = policy.log_prob(actions[step - 1]).sum()
        for net in (actor, critic):
            net.zero_grad()
        value.sum().backward()
        (likely + entropy * np.sign(delta) * policy.entropy().sum()).backward()
        obgd([*actor.parameters()], traces[0], delta, discount * trace, 1.5 * kappa)
        obgd([*critic.parameters()], traces[1], delta, discount * trace, kappa)
    check_networks(agent, "actor", 1, actor)
    check_networks(agent, "critic", 1, critic)
    assert any(not np.allclose(first[k], v, atol=1e-3) for k, v in agent.weights().items())


def test_stream_q_is_the_published_algorithm():
    discount, trace, kappa = 0.9, 0.8, 2.0
    agent = factory_of("stream_q")(2, SENSES, 3, discount=discount, epsilon=0.2)
    states, rewards = stream(15, 2)
    layers = networks(agent, "values", 1)
    chosen, explored = lived(agent, states, rewards, "chosen", "exploratory")
    inputs = normal_inputs(states[:, 1])
    paid = scaled_rewards(rewards[:, 1], discount)
    traces = [torch.zeros_like(p) for p in layers.parameters()]
    for step in range(1, len(states)):
        value = deep(layers, inputs[step - 1])[chosen[step - 1]]
        best = deep(layers, inputs[step]).max().item()
        layers.zero_grad()
        value.backward()
        delta = paid[step] + discount * best - value.item()
        obgd([*layers.parameters()], traces, delta, discount * trace, kappa)
        if explored[step - 1]:
            for one in traces:
                one.zero_()
    assert any(explored)
    check_networks(agent, "values", 1, layers)


def test_avg_is_the_published_algorithm():
    discount, entropy = 0.99, 0.07
    agent = factory_of("avg")(2, SENSES, 3, actor_rate=0.0063, critic_rate=0.0087)
    states, rewards = stream(12, 2)
    actor, critic = (networks(agent, name, 1) for name in ("actor", "critic"))
    (noises,) = lived(agent, states, rewards, "noise")

    def unit(layers, x):
        x = F.leaky_relu(layers[0](x))
        x = F.leaky_relu(layers[1](x))
        return layers[2](x / x.norm().clamp(min=1e-12))

    def act(x, noise):
        mean, log_spread = unit(actor, x).split(2)
        spread = torch.diag(log_spread.clamp(-20, 2).exp())
        policy = torch.distributions.MultivariateNormal(mean, spread @ spread)
        raw = mean + spread.diagonal() * noise
        squash = 2 * (math.log(2) - raw - F.softplus(-2 * raw))
        return torch.tanh(raw), policy.log_prob(raw) - squash.sum()

    adams = [
        torch.optim.Adam(net.parameters(), lr=rate, betas=(0.0, 0.999))
        for net, rate in ((actor, 0.0063), (critic, 0.0087))
    ]
    paid, inputs = Normalizer(), []
    mean, variance, count = np.zeros(3), np.ones(3), 1e-4  # as Gymnasium's NormalizeObservation
    for state in states[:, 1].astype(float):
        apart, total = state - mean, count + 1
        variance = (variance * count + apart**2 * count / total) / total
        mean, count = mean + apart / total, total
        normal = (state - mean) / np.sqrt(variance + 1e-8)
        inputs.append(torch.tensor(normal, dtype=torch.float32))
    taken = [act(inputs[0], noises[0])]
    for step in range(1, len(states)):
        # The robot acts before it learns: each action is one of the weights of its own step.
        taken.append(tuple(x.detach() for x in act(inputs[step], noises[step])))
        action, density = (x.detach() for x in taken[step - 1])
        following, next_density = taken[step]
        paid.add(rewards[step, 1] - entropy * density.item())
        variance = paid.variance(0)
        sigma = math.sqrt(variance) if variance > 0.01 else 1.0
        with torch.no_grad():
            soft = unit(critic, torch.cat([inputs[step], following])) - entropy * next_density
        value = unit(critic, torch.cat([inputs[step - 1], action]))
        loss = ((rewards[step, 1] + discount * soft - value) / sigma) ** 2
        own, own_density = act(inputs[step - 1], noises[step - 1])
        cost = entropy * own_density - unit(critic, torch.cat([inputs[step - 1], own]))
        adams[0].zero_grad()
        cost.sum().backward()
        actors = [parameter.grad.clone() for parameter in actor.parameters()]
        adams[1].zero_grad()
        loss.sum().backward()
        for parameter, gradient in zip(actor.parameters(), actors, strict=True):
            parameter.grad = gradient
        for optimizer in adams:
            optimizer.step()
    check_networks(agent, "actor", 1, actor)
    check_networks(agent, "critic", 1, critic)


@pytest.mark.parametrize("memory", [4, 48])
def test_sarsa_lambda_is_the_published_algorithm(memory, monkeypatch):
    monkeypatch.setattr(SarsaLambda, "MEMORY", memory)
    agent = factory_of("sarsa_lambda")(
        2, SENSES, 0, rate=0.8, discount=0.9, trace=0.8, epsilon=0.2, initial=2.0
    )
    states, rewards = stream(30, 2)
    states[10:20] = states[10]  # tiles that are met again have a trace of 1
    (tiles,) = lived(agent, states, rewards, "weights_of")
    tiles = [step.tolist() for step in tiles]
    assert agent._offsets[:, :2].tolist() == [[t / 8, 3 * t % 8 / 8] for t in range(8)]
    values, traces = collections.defaultdict(lambda: 2.0 / SarsaLambda.TILINGS), {}
    least = 0.72 ** (memory - 0.5)  # older traces are dropped
    for before, now, reward in zip(tiles, tiles[1:], rewards[1:, 1], strict=False):
        assert len({*now}) == SarsaLambda.TILINGS
        error = reward + 0.9 * sum(values[i] for i in now) - sum(values[i] for i in before)
        traces = {i: 0.72 * z for i, z in traces.items()} | dict.fromkeys(before, 1.0)
        traces = {i: z for i, z in traces.items() if z > least}
        for i, z in traces.items():
            values[i] += 0.8 / SarsaLambda.TILINGS * error * z
    for i, value in values.items():
        assert agent.values[1, i] == pytest.approx(value, abs=1e-5)
    assert agent.state()["traces"][1].sum() == pytest.approx(sum(traces.values()), rel=1e-4)


@pytest.mark.parametrize(
    ("name", "number"), [("sarsa_lambda", 1), ("stream_q", 7), ("stream_ac", 13)]
)
def test_traces_end_where_a_robot_is_placed_anew_or_tested(name, number):
    states, rewards = stream(20, 2)
    for tested in (False, True):
        agent = factory_of(name)(2, SENSES, 0)
        lived(agent, states, rewards)
        # One of each layer's weights and biases, and the trace of rewards.
        traces = [array for key, array in agent.state().items() if "trace" in key]
        assert len(traces) == number and any(array.any() for array in traces)
        if tested:
            agent.act(states[0], False)
        else:
            agent.reset()
        traces = [array for key, array in agent.state().items() if "trace" in key]
        assert not any(array.any() for array in traces)


def test_avg_bounds_the_spread_of_its_actions():
    outputs = torch.tensor([[0.0, 0.0, 50.0, -50.0]])
    action, _ = _squashed(outputs, torch.tensor([[0.1, 1.0]]))
    assert action.atanh()[0].tolist() == pytest.approx([0.1 * math.exp(2), math.exp(-20)])


@pytest.mark.parametrize("rate", [0.01, torch.tensor([0.01, 0.03])])
def test_adam_is_pytorchs_and_moments_that_decay_never_become_subnormal(rate):
    random = torch.Generator().manual_seed(0)
    nets = LayeredNetworks(2, (1, 2, 1), random)
    adam, smallest = Adam(nets, rate, 0.9), torch.finfo().tiny
    rows = [row.double().requires_grad_() for row in nets.flat]
    rates = torch.as_tensor(rate).expand(2).tolist()
    theirs = [torch.optim.Adam([row], lr=lr) for row, lr in zip(rows, rates, strict=True)]
    for step in range(2500):
        gradient = torch.randn(nets.flat.shape, generator=random) * (step < 20)
        adam.step(gradient)
        for row, optimizer, slopes in zip(rows, theirs, gradient, strict=True):
            row.grad = slopes.double()
            optimizer.step()
        for moment in adam.tensors[1:]:
            assert not ((moment != 0) & (moment.abs() < smallest)).any()
    assert torch.allclose(nets.flat.double(), torch.stack(rows), atol=1e-4)


def test_of_equal_values_each_action_is_taken_as_often():
    agent = factory_of("sarsa_lambda")(2500, SENSES, 0, initial=0.7, epsilon=0.01)
    agent.reset()
    still = np.zeros((2500, 3), np.float32)
    taken, *tested = (agent.act(still, learning) for learning in (True, False, False))
    assert np.array_equal(*tested)
    for motors in (taken, tested[0]):
        counts = np.unique(motors, axis=0, return_counts=True)[1]
        assert len(counts) == 25 and stats.chisquare(counts).pvalue > 1e-4


@pytest.mark.parametrize("name", ["q_learner", "sarsa_lambda", "stream_q", "amortised_q", "dqn"])
def test_as_many_actions_are_random_as_epsilon_says(name):
    agent = factory_of(name)(1000, SENSES, 0, epsilon=0.2, epsilon_steps=10.0)
    for age, wanted in ((1, 0.92), (6, 0.52), (11, 0.2), (12, 0.2)):
        agent._age.fill_(age - 1)
        assert agent.draw_exploratory().float().mean() == pytest.approx(wanted, abs=0.06)


def test_exploratory_actions_of_amortised_q_are_uniform():
    agent = factory_of("amortised_q")(4000, SENSES, 0, epsilon=0.2)
    agent.reset()
    agent.act(np.zeros((4000, 3), np.float32), True)
    other = (agent.now["action"] != agent.now["best"]).any(dim=1)
    assert other.float().mean() == pytest.approx(0.2, abs=0.03)
    for motor in agent.now["action"][other].T:
        assert stats.kstest(motor.numpy(), "uniform", args=(-1, 2)).pvalue > 1e-4


def test_no_gradient_of_avg_is_boundless_at_the_start_of_a_life():
    """The first signals of a life are those of which the moments know nothing."""
    agent = factory_of("avg")(3, ONE, 0)
    random = np.random.default_rng(0)
    signals, rewards = random.uniform(size=(2, 5, 3)).astype(np.float32)
    agent.reset()
    for state, reward in zip(signals[..., None], rewards, strict=True):
        agent.act(state, True)
        agent.learn(reward)
    moments = [array for key, array in agent.state().items() if ".adam." in key]
    assert len(moments) == 2 * 13 and max(array.max() for array in moments) < 1e3


def test_streaming_learners_with_one_signal_tell_more_of_it_than_its_sign():
    for name, networks in (("stream_q", "networks"), ("stream_ac", "actor")):
        agent = factory_of(name)(1, ONE, 0)
        smells = torch.tensor([[[0.1, 1.0], [0.5, 1.0], [2.0, 1.0]]])
        seen = getattr(agent, networks)(smells)[0]
        assert len(torch.unique(seen.round(decimals=4), dim=0)) == 3


def test_distant_states_share_no_tile_and_neighbours_some():
    """With six signals no tiling has a cell for each tile."""
    agent = factory_of("sarsa_lambda")(3, ONE, 0)
    tiles = agent.tiles(torch.tensor([[0.0], [0.05], [0.9]]))
    assert 0 < (tiles[0] == tiles[1]).sum() < SarsaLambda.TILINGS
    assert not (tiles[0] == tiles[2]).any()
    senses = Senses((Signal(0, 1),) * 6, Signal(0, 1))
    states = torch.rand(2000, 6, generator=torch.Generator().manual_seed(0)) * 2 - 1
    for cells in (512, 16384):
        tiles = factory_of("sarsa_lambda")(1, senses, 0, cells=cells).tiles(states)
        expected = cells * (1 - (1 - 1 / cells) ** 2000)  # if each state took a cell at random
        assert len(torch.unique(tiles[:, 0])) == pytest.approx(expected, rel=0.05)
        assert 0 <= tiles.min() <= tiles.max() < cells


def test_a_step_of_the_q_learner_is_watkins_update_as_autograd_computes_it():
    agent = factory_of("q_learner")(4, SENSES, 3)
    states, rewards = stream(2, 4)
    agent.reset()
    agent.act(states[0], True)
    agent.act(states[1], True)
    before = {k: torch.from_numpy(v.copy()).requires_grad_() for k, v in agent.weights().items()}

    def values(state):
        sums = torch.einsum("bhi,bi->bh", before["hidden_weights"], torch.from_numpy(state))
        hidden = (sums + before["hidden_biases"]).sigmoid()
        return (
            torch.einsum("boh,bh->bo", before["output_weights"], hidden) + before["output_biases"]
        )

    value = values(states[0])[torch.arange(4), agent.before["chosen"]]
    best = values(states[1]).amax(dim=1).detach()
    (0.5 * (torch.from_numpy(rewards[1]) + 0.9 * best - value) ** 2).sum().backward()
    agent.learn(rewards[1])
    for name, weights in agent.weights().items():
        assert before[name].grad.abs().max() > 0
        wanted = before[name] - 0.05 * before[name].grad
        assert torch.from_numpy(weights) == pytest.approx(wanted.detach(), abs=1e-6)


def relu(layers, x, rectified=torch.relu):
    for layer in layers[:-1]:
        x = rectified(layer(x))
    return layers[-1](x)


tanh = functools.partial(relu, rectified=torch.tanh)


class ShortMemory(DQN):
    REPLAY, BATCH, COPY = 5, 4, 3


def test_dqn_is_the_published_algorithm_beyond_the_end_of_its_memory(monkeypatch):
    settings = {name: one.default for name, one in settings_of(factory_of("dqn")).items()}
    agent = ShortMemory(2, SENSES, 3, **settings | {"rate": 0.001, "discount": 0.95})
    states, rewards = stream(14, 2)
    layers, target = (networks(agent, "values", 1) for _ in range(2))
    optimizer = torch.optim.Adam(layers.parameters(), lr=0.001)
    draw, drawn = torch.randint, []

    def noted(*arguments, **options):
        drawn.append(draw(*arguments, **options))
        return drawn[-1]

    monkeypatch.setattr(torch, "randint", noted)
    agent.reset()
    chosen, memory = [], {}
    for step, (state, reward) in enumerate(zip(states, rewards, strict=True)):
        agent.act(state, True)
        chosen.append(int(agent.now["chosen"][1]))
        agent.learn(reward)
        if step == 0:
            continue
        memory[(step - 1) % 5] = step
        losses = []
        for place in drawn[-1][1].tolist():
            then = memory[place]
            best = relu(target, torch.tensor(states[then, 1])).max().detach()
            value = relu(layers, torch.tensor(states[then - 1, 1]))[chosen[then - 1]]
            losses.append(F.smooth_l1_loss(value, rewards[then, 1] + 0.95 * best))
        optimizer.zero_grad()
        (sum(losses) / len(losses)).backward()
        optimizer.step()
        if step % 3 == 0:
            target.load_state_dict(layers.state_dict())
    check_networks(agent, "values", 1, layers)
    assert len(memory) == 5


def test_amortised_q_is_the_algorithm_of_the_source():
    agent = factory_of("amortised_q")(2, SENSES, 3, rate=0.002, proposer_rate=0.003)
    states, rewards = stream(12, 2)
    values, proposer = (networks(agent, name, 1) for name in ("values", "proposer"))
    adams = [
        torch.optim.Adam(net.parameters(), lr=rate)
        for net, rate in ((values, 0.002), (proposer, 0.003))
    ]
    agent.reset()
    before = None
    for state, reward in zip(states, rewards, strict=True):
        agent.act(state, True)
        now = torch.tensor(state[1]), agent.now["action"][1].clone(), agent.now["best"][1].clone()
        # The value of the best action, as it was when the robot chose.
        best = tanh(values, torch.cat([now[0], now[2]])).item()
        agent.learn(reward)
        if before is not None:
            loss = 0.5 * (reward[1] + 0.9 * best - tanh(values, torch.cat(before[:2]))) ** 2
            mean, sums = tanh(proposer, before[0]).split(2)
            policy = torch.distributions.Normal(mean.tanh(), 0.1 + 0.9 * sums.sigmoid())
            gain = policy.log_prob(before[2]).sum() + 0.1 * policy.entropy().sum()
            for optimizer, objective in zip(adams, (loss.sum(), -gain), strict=True):
                optimizer.zero_grad()
                objective.backward()
                optimizer.step()
        before = now
    check_networks(agent, "values", 1, values)
    check_networks(agent, "proposer", 1, proposer)


@given(st.integers(1, 40))
def test_a_neuron_keeps_a_tenth_of_its_weights_but_at_least_one(fan_in):
    weights = torch.ones(2, 5, fan_in)
    make_sparse([weights, torch.zeros(2, 5)], torch.Generator().manual_seed(fan_in))
    wanted = max(fan_in - math.ceil(0.9 * fan_in), 1)
    assert (weights.sum(dim=2) == wanted).all()
