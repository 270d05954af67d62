"""`musebot check-agent` finds each fault of an agent, and none in our own."""

import re
import sys
import types

import numpy as np
import pytest

from musebot.protocols.agents import agent_check, trust
from musebot.protocols.agents.base import Agent, load_random_state, random_state
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.agents.settings import Setting, tunable
from musebot.protocols.cli import parser as cli
from musebot.protocols.compare.agent_check import checks
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment


class Mean(Agent):
    """A sound agent: it drives by the mean reward so far, and explores a little."""

    def __init__(self, robots, senses, seed):
        self.random = np.random.RandomState(seed)
        self.mean, self.placed = np.zeros(robots), np.ones(1)

    def reset(self):
        self.placed[:] = 1

    def act(self, state, learning):
        noise = self.random.uniform(-0.1, 0.1, (len(state), 2)) * learning
        return np.clip(self.mean[:, None] + 0.1 * state[:, :1] + noise, -0.5, 0.5)

    def learn(self, reward):
        if not self.placed[0]:
            self.mean += 0.1 * (reward - self.mean)
        self.placed[:] = 0

    def state(self):
        _, keys, position, *_ = self.random.get_state()
        return {"mean": self.mean, "placed": self.placed, "keys": keys,
                "position": np.array([position])}  # fmt: skip

    def load_state(self, arrays):
        self.mean[:], self.placed[:] = arrays["mean"], arrays["placed"]
        self.random.set_state(("MT19937", arrays["keys"], int(arrays["position"][0])))

    def weights(self):
        return {"mean": self.mean[:, None].copy()}


class TooFast(Mean):
    def act(self, state, learning):
        return super().act(state, learning) + 0.5


class Unseeded(Mean):
    def __init__(self, robots, senses, seed):
        super().__init__(robots, senses, None)


class Idle(Mean):
    def learn(self, reward):
        pass


class LearnsInTests(Mean):
    def act(self, state, learning):
        self.mean += 0.001
        return super().act(state, learning)


class Forgetful(Mean):
    def state(self):
        return {"mean": self.mean}

    def load_state(self, arrays):
        self.mean[:] = arrays["mean"]


class ForgetsWhatItLearnsFrom(Mean):
    """Its checkpoint lacks the mean of rewards that its weights will become in a later step."""

    def __init__(self, robots, senses, seed):
        super().__init__(robots, senses, seed)
        self.rewards = 0.0

    def learn(self, reward):
        super().learn(reward)
        self.rewards += reward.sum()

    def state(self):
        return super().state() | {"sum": np.array([self.rewards])}


class LosesHalfAWord(Mean):
    """Small whole numbers use half of a drawn word; its checkpoint lacks the other half."""

    def __init__(self, robots, senses, seed):
        super().__init__(robots, senses, seed)
        self.random = np.random.default_rng(seed)

    def act(self, state, learning):
        motors = np.clip(self.mean[:, None] + 0.1 * state[:, :1], -0.5, 0.5) * np.ones(2)
        if learning:
            motors[0] = self.random.integers(5) / 10
        return motors

    def state(self):
        return {"mean": self.mean, "placed": self.placed, "random": random_state(self.random)}

    def load_state(self, arrays):
        self.mean[:], self.placed[:] = arrays["mean"], arrays["placed"]
        load_random_state(self.random, [*arrays["random"][:4], 0, 0])


class KeepsHalfAWord(LosesHalfAWord):
    def load_state(self, arrays):
        super().load_state(arrays)
        load_random_state(self.random, arrays["random"])


class Shared(Mean):
    def learn(self, reward):
        super().learn(np.full_like(reward, reward.mean()))


class AcrossPlacements(Mean):
    def reset(self):
        pass

    def learn(self, reward):
        self.mean += 0.1 * (reward - self.mean)


class Diverges(Mean):
    def weights(self):
        return {"mean": np.full((len(self.mean), 1), np.inf)}


class DivergesAtBirth(Mean):
    """A weight is not a number until the first step."""

    def __init__(self, robots, senses, seed):
        super().__init__(robots, senses, seed)
        self.mean[2] = np.nan

    def learn(self, reward):
        self.mean[2] = 0.0
        super().learn(reward)


class DivergesLater(Mean):
    """A weight of robot 3 is not a number from the tenth step on."""

    steps = 0

    def learn(self, reward):
        super().learn(reward)
        self.steps += 1
        if self.steps == 10:
            self.mean[3] = np.nan


class TakesOver(Mean):
    def load_weights(self, arrays):
        self.mean[:] = arrays["mean"][:, 0]


class KeepsNotAll(TakesOver):
    """Its actions also depend on the seed, which `weights` does not tell."""

    def __init__(self, robots, senses, seed):
        super().__init__(robots, senses, seed)
        self.offset = 0.01 * seed

    def state(self):
        return super().state() | {"offset": np.array([self.offset])}

    def load_state(self, arrays):
        super().load_state(arrays)
        self.offset = arrays["offset"][0]

    def act(self, state, learning):
        return np.clip(super().act(state, learning) + self.offset, -0.5, 0.5)


class KeepsNothing(Mean):
    def weights(self):
        return {}


class RefusesItsWeights(Mean):
    def load_weights(self, arrays):
        raise KeyError("median")


FAULTS = {
    Mean: set(),
    TakesOver: set(),
    KeepsNothing: set(),
    KeepsNotAll: {"kept weights drive it again, for films"},
    RefusesItsWeights: {"kept weights drive it again, for films"},
    TooFast: {"motor values lie in [-0.5, 0.5]"},
    Unseeded: {
        "the seed decides everything",
        "a restored checkpoint continues bit-exactly",
        "robots share nothing but random numbers",
    },
    Idle: {"training changes weights"},
    LearnsInTests: {"tests change no weights"},
    Forgetful: {"a restored checkpoint continues bit-exactly"},
    ForgetsWhatItLearnsFrom: {"a restored checkpoint continues bit-exactly"},
    LosesHalfAWord: {"a restored checkpoint continues bit-exactly"},
    KeepsHalfAWord: set(),
    Shared: {"robots share nothing but random numbers"},
    AcrossPlacements: {"nothing is learned across a placement"},
    Diverges: {"weights stay finite"},
    DivergesAtBirth: {"motor values lie in [-0.5, 0.5]", "weights stay finite"},
    DivergesLater: {"motor values lie in [-0.5, 0.5]", "weights stay finite"},
}


@pytest.fixture(autouse=True)
def module(monkeypatch):
    """A module of a user's with all agents above; timing takes a moment only."""
    mine = types.ModuleType("mine")
    for cls in FAULTS:
        setattr(mine, cls.__name__, cls)
    monkeypatch.setitem(sys.modules, "mine", mine)
    monkeypatch.setattr(trust, "_TRUSTED", {f"mine:{cls.__name__}" for cls in FAULTS})
    monkeypatch.setattr(agent_check, "TIMED", (4, 30))


@pytest.mark.parametrize("cls", FAULTS, ids=lambda cls: cls.__name__)
def test_each_fault_fails_its_own_check(cls):
    found = [*checks(Experiment(), Condition("spot_finding", f"mine:{cls.__name__}"))]
    failed = {check.name for check in found if check.passed is False}
    assert failed == FAULTS[cls]
    assert len(found) == {KeepsNothing: 10, Diverges: 2, DivergesAtBirth: 2, DivergesLater: 2}.get(
        cls, 11
    )
    assert all(check.says for check in found)


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("DivergesAtBirth", "robot 2 is not finite at birth"),
        ("DivergesLater", "robot 3 is not finite after 10 steps"),
    ],
)
def test_a_weight_that_is_not_finite_is_named_with_its_robot_and_step(name, where):
    found = checks(Experiment(), Condition("spot_finding", f"mine:{name}"))
    (says,) = (check.says for check in found if check.name == "weights stay finite")
    assert says == f"mean of {where}; the other checks were skipped"


class Rated(Mean):
    """Learns at a rate that may differ between robots."""

    def __init__(self, robots, senses, seed, rate):
        super().__init__(robots, senses, seed)
        self.rate = rate

    def learn(self, reward):
        if not self.placed[0]:
            self.mean += self.rate * (reward - self.mean)
        self.placed[:] = 0


def sound(robots, senses, seed, *, rate):
    return Rated(robots, senses, seed, rate)


def of_the_first(robots, senses, seed, *, rate):
    return Rated(robots, senses, seed, np.ravel(rate)[0])


def of_numbers(robots, senses, seed, *, rate):
    return Rated(robots, senses, seed, float(rate))


def of_none(robots, senses, seed, *, rate):
    return Rated(robots, senses, seed, rate if np.isscalar(rate) else 0.0)


@pytest.mark.parametrize(
    ("factory", "says"),
    [
        (sound, "rate"),
        (of_the_first, "another value of one robot changes the actions of others"),
        (
            of_numbers,
            "it fails with an array, which each=True allows: the factory mine:of_numbers failed "
            r"\(TypeError: .*, test_agent_check.py line \d+\)",
        ),
        (of_none, "the same value for each robot gives other actions"),
    ],
)
def test_robots_may_differ_in_the_settings_that_say_so(factory, says, monkeypatch):
    setting = Setting(0.1, 0.01, 1.0, each=True)
    name = f"mine:{factory.__name__}"
    setattr(sys.modules["mine"], factory.__name__, tunable(rate=setting)(factory))
    trust.trust(name)
    found = [*checks(Experiment(), Condition("spot_finding", name))]
    (check,) = (one for one in found if one.name == "robots may differ in their settings")
    assert check.passed is (factory is sound) and re.fullmatch(says, check.says)


def test_an_agent_that_stands_still_is_told_so():
    found = [*checks(Experiment(), Condition("spot_finding", recorded_name("newborn")))]
    assert "it moves" not in {check.name for check in found}
    still = {"act": lambda self, state, learning: np.zeros((len(state), 2))}
    sys.modules["mine"].Still = type("Still", (Mean,), still)
    trust.trust("mine:Still")
    found = [*checks(Experiment(), Condition("spot_finding", "mine:Still"))]
    assert [check.passed for check in found if check.name == "it moves"] == [None]


def test_kept_weights_drive_an_agent_again_only_if_it_can_take_them_over():
    for cls, passed in ((Mean, None), (KeepsNothing, None), (TakesOver, True)):
        found = checks(Experiment(), Condition("spot_finding", f"mine:{cls.__name__}"))
        assert [c.passed for c in found if c.name == "kept weights drive it again, for films"] == [
            passed
        ]


@pytest.mark.parametrize("signals", ["paper", "raw"])
@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
@pytest.mark.parametrize("name", ["sarsa_lambda", "stream_ac", "hand_coded", "newborn"])
def test_our_own_agents_pass(name, task, signals):
    found = checks(Experiment(signals=signals), Condition(task, recorded_name(name)))
    failed = {check.name for check in found if check.passed is False}
    assert not failed - ({"training changes weights"} if name == "newborn" else set())


def test_the_exit_status_says_whether_one_has_failed(capsys, commands_in_process):
    assert cli.main(["check-agent", "mine:Mean"]) == 0
    said = capsys.readouterr().out
    assert "FAILED" not in said
    lines = said.splitlines()
    assert lines[-1] == "mine:Mean passed all checks" and "spot_finding, paper signals" in lines
    assert cli.main(["check-agent", "mine:Mean", "--protocol", "walls"]) == 0
    assert "spot_finding_walls, paper signals" in capsys.readouterr().out
    assert cli.main(["check-agent", "mine:Idle"]) == 1
    captured = capsys.readouterr()
    assert "FAILED  training changes weights: none changed" in captured.out.splitlines()
    assert captured.err == "musebot: mine:Idle failed 2 of the checks\n"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["creative"], "creative is a proposer of the brain, not an agent"),
        (["stream"], "there is no agent 'stream': did you mean stream_q"),
        (["nowhere:make"], "there is no agent nowhere:make"),
        (["avg", "--task", "sleeping"], "the task must be one of"),
        (["avg", "--agent-set", "rate=1"], "avg has no setting rate"),
        (["avg", "--protocol", "doors"], "the protocol must be one of"),
        (["avg", "--protocol", "walls", "--task", "wall_avoidance"], "has only spot_finding"),
        (["ppo"], "policies"),
    ],
)
def test_bad_input_is_one_sentence(words, sentence, capsys, commands_in_process):
    assert cli.main(["check-agent", *words]) == 2
    captured = capsys.readouterr()
    assert sentence in captured.err and captured.err.count("\n") == 1 and not captured.out


@pytest.mark.parametrize("drawn", range(4))
def test_a_restored_generator_draws_the_same_numbers(drawn):
    first, second = np.random.default_rng(1), np.random.default_rng(2)
    first.integers(5, size=drawn)
    words = random_state(first)
    assert (words.dtype, words.shape, words[4]) == (np.uint64, (6,), drawn % 2)
    load_random_state(second, words)
    numbers = [[*one.integers(5, size=9), *one.random(3)] for one in (first, second)]
    assert numbers[0] == numbers[1]


def test_the_state_of_another_generator_or_of_other_words_is_refused():
    with pytest.raises(ValueError, match="must be PCG64, got MT19937"):
        random_state(np.random.Generator(np.random.MT19937(1)))
    words = random_state(np.random.default_rng(1))
    for wrong in (words[:5], words[:, None], 0 * words, words | 2**40):
        with pytest.raises(ValueError, match="six words|no state of PCG64"):
            load_random_state(np.random.default_rng(1), wrong)
