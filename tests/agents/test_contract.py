"""Our own agents keep the contract; each fault of an agent breaks its own law."""

import sys
import types

import numpy as np
import pytest

from musebot.protocols.agents import factory
from musebot.protocols.agents.base import Agent, load_random_state, random_state
from musebot.protocols.agents.contract import AgentContract, check_agent
from musebot.protocols.agents.names import OWN, OWN_BOUNDS, RECORDED_NAMES
from musebot.protocols.agents.settings import Setting, tunable
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError

OWN_CASES = [(name, "spot_finding", "raw") for name in OWN]
OWN_CASES += [("sarsa_lambda", "wall_avoidance", "paper"), ("newborn", "spot_finding", "paper")]


@pytest.mark.parametrize("case", OWN_CASES, ids="-".join)
def test_own_agents_keep_every_law(case):
    contract = AgentContract()
    contract.name, contract.task, contract.signals = case
    contract.learns = RECORDED_NAMES[contract.name] not in OWN_BOUNDS
    assert contract.broken() == []


class Mean(Agent):
    """A sound agent: it drives by the mean reward so far, and explores a little."""

    def __init__(self, robots, senses, seed):
        self.random = np.random.default_rng(seed)
        self.mean, self.placed = np.zeros(robots), np.ones(1)

    def reset(self):
        self.placed[:] = 1

    def act(self, state, learning):
        noise = 0.0 * self.mean
        if learning:  # small whole numbers use half of a drawn word
            noise[0] = self.random.integers(5) / 50
        return np.clip((self.mean + noise)[:, None] + 0.1 * state[:, :1] + [0, 0], -0.5, 0.5)

    def learn(self, reward):
        if not self.placed[0]:
            self.mean += 0.1 * (reward - self.mean)
        self.placed[:] = 0

    def state(self):
        return {"mean": self.mean, "placed": self.placed, "random": random_state(self.random)}

    def load_state(self, arrays):
        self.mean[:], self.placed[:] = arrays["mean"], arrays["placed"]
        load_random_state(self.random, arrays["random"])

    def weights(self):
        return {"mean": self.mean[:, None].copy()}

    def load_weights(self, arrays):
        self.mean[:] = arrays["mean"][:, 0]


def faulty(**methods):
    """Returns a class of agents, `Mean` with some other methods."""
    return type("Faulty", (Mean,), methods)


def shared(agent, reward):
    Mean.learn(agent, np.full_like(reward, reward.mean()))


def learning_in_tests(agent, state, learning):
    agent.mean += 0.001
    return Mean.act(agent, state, learning)


def half_a_word_lost(agent, arrays):
    Mean.load_state(agent, arrays)
    agent.random.bit_generator.state |= {"has_uint32": 0}


def refused(agent, *given):
    raise KeyError("median")


class ForgetsWhatItLearnsFrom(Mean):
    """Its checkpoint lacks the sum of rewards that its weights will become in a later step."""

    total = 0.0

    def learn(self, reward):
        super().learn(reward)
        self.total += reward.sum()

    def state(self):
        return super().state() | {"total": np.array([self.total])}


class BreaksAtTheEnd(Mean):
    """A weight becomes NaN in the last step of training."""

    steps, last = 0, 60

    def learn(self, reward):
        super().learn(reward)
        self.steps += 1
        if self.steps == self.last:
            self.mean[3] = np.nan

    def state(self):
        return super().state() | {"steps": np.array(self.steps)}

    def load_state(self, arrays):
        super().load_state(arrays)
        self.steps = int(arrays["steps"])


class KeepsNotAll(Mean):
    """Its actions also depend on the seed, which `weights` leaves out."""

    def __init__(self, robots, senses, seed):
        super().__init__(robots, senses, seed)
        self.offset = np.full(1, 0.01 * seed)

    def state(self):
        return super().state() | {"offset": self.offset}

    def load_state(self, arrays):
        super().load_state(arrays)
        self.offset[:] = arrays["offset"]

    def act(self, state, learning):
        return np.clip(super().act(state, learning) + self.offset, -0.5, 0.5)


SEED, RESTORED, WEIGHTS = "same seed", "after a checkpoint", "loaded weights"
FAULTS = {  # an agent, and what the contract says of it
    "Mean": (Mean, set()),
    "KeepsNothing": (
        faulty(weights=Agent.weights, load_weights=Agent.load_weights),
        set(),
    ),
    "TooFast": (
        faulty(act=lambda self, *given: Mean.act(self, *given) + 0.5),
        {"must lie in [-0.5, 0.5], the largest is"},
    ),
    "Unseeded": (
        faulty(__init__=lambda self, *given: Mean.__init__(self, *given[:2], None)),
        {SEED, RESTORED, "other robots' signals"},
    ),
    "Idle": (
        faulty(learn=lambda *_: None),
        {"60 steps of training change no weights"},
    ),
    "LearnsInTests": (faulty(act=learning_in_tests), {"a test changes the weights mean"}),
    "Forgets": (ForgetsWhatItLearnsFrom, {"state() has other total"}),
    "LosesHalfAWord": (faulty(load_state=half_a_word_lost), {RESTORED}),
    "RefusesItsState": (
        faulty(load_state=refused),
        {"load_state cannot restore what was stored: KeyError('median')"},
    ),
    "Shared": (faulty(learn=shared), {"other robots' signals change"}),
    "AcrossPlacements": (
        faulty(reset=lambda self: None),
        {"the first reward after reset changes mean"},
    ),
    "NotFiniteLater": (
        type("BreaksLater", (BreaksAtTheEnd,), {"last": 10}),
        {"mean of robot 3 is not finite after 10 steps", "values are not finite"},
    ),
    "NotFiniteAtTheEnd": (BreaksAtTheEnd, {"mean of robot 3 is not finite after 60 steps"}),
    "FailsInAct": (faulty(act=refused), {"failed in act (KeyError: 'median'"}),
    "KeepsNotAll": (KeepsNotAll, {WEIGHTS}),
    "FailsWhenItLoads": (
        faulty(load_weights=lambda *_: sys.exit(0)),
        {"failed in load_weights: it called for an exit (status 0)"},
    ),
}


@pytest.fixture(autouse=True)
def mine(monkeypatch):
    """A module of a user's with all agents above."""
    module = types.ModuleType("mine")
    vars(module).update({name: cls for name, (cls, _) in FAULTS.items()})
    monkeypatch.setitem(sys.modules, "mine", module)
    monkeypatch.setattr(factory, "_TRUSTED", set())
    monkeypatch.setattr(sys, "path", [*sys.path])
    return module


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_breaks_its_own_law_and_no_other(name):
    broken, (_, laws) = check_agent(f"mine:{name}"), FAULTS[name]
    assert all(any(words in sentence for sentence in broken) for words in laws)
    assert all(any(words in sentence for words in laws) for sentence in broken)
    assert all("\n" not in sentence for sentence in broken) and len({*broken}) == len(broken)


def rated(of):
    """Returns a factory of agents whose rate may differ, which take it as `of` says."""

    class Rated(Mean):
        def learn(self, reward):
            if not self.placed[0]:
                self.mean += self.rate * (reward - self.mean)
            self.placed[:] = 0

    def make(robots, senses, seed, *, rate):
        agent = Rated(robots, senses, seed)
        agent.rate = of(rate)
        return agent

    return tunable(rate=Setting(0.1, 0.01, 1.0, each=True))(make)


@pytest.mark.parametrize(
    ("of", "words"),
    [
        (lambda rate: rate, ""),
        (lambda rate: np.ravel(rate)[0], "another value of one robot's settings changes"),
        (float, "the factory mine:make failed (TypeError"),
        (lambda rate: rate if np.isscalar(rate) else 0.0, "a value for each robot gives other"),
    ],
)
def test_robots_may_differ_in_the_settings_that_say_so(of, words, mine):
    mine.make = rated(of)
    broken = check_agent("mine:make")
    assert all(words in sentence for sentence in broken) and bool(broken) == bool(words)


def test_an_agent_that_cannot_be_made_is_an_error():
    for name, settings in (("mine:Lost", ()), ("mine:Mean", ("rate=1",))):
        with pytest.raises(InputError):
            check_agent(name, settings)


def test_the_exit_status_says_whether_a_law_is_broken(capsys):
    assert cli.main(["doctor", "--agent", "mine:Mean"]) == 0
    assert capsys.readouterr().out == "mine:Mean passed all checks\n"
    assert cli.main(["doctor", "--agent", "mine:Idle"]) == 1
    captured = capsys.readouterr()
    assert "spot_finding, raw signals: 60 steps of training change no weights" in captured.out
    assert captured.err == "musebot: mine:Idle failed 4 checks\n"
    assert cli.main(["doctor", "--agent", "creative"]) == 2


def test_the_state_of_another_generator_or_a_damaged_one_is_refused():
    other, own = np.random.Generator(np.random.MT19937(1)), np.random.default_rng(1)
    with pytest.raises(ValueError, match="must be PCG64, got MT19937"):
        random_state(other)
    state = random_state(own)
    large = np.frombuffer(bytes(state).replace(b'"inc": ', b'"inc": 9999'), np.uint8)
    for generator, wrong in ((other, state), (own, state[:5]), (own, 0 * state), (own, large)):
        with pytest.raises(ValueError, match="this is no state of the generator"):
            load_random_state(generator, wrong)
