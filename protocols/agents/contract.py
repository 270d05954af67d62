"""Checks that an agent obeys the laws of all agents, on random signals, without a simulation.

Example:
  A test of your own agent, for pytest:

    from musebot.protocols.agents.contract import AgentContract

    class TestMine(AgentContract):
        name = "my_agent:table"
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ...controller.senses import Senses
from ..errors import InputError, RunError
from ..progress import tracked
from .base import Agent
from .checked_agent import CheckedAgent, copied
from .factory import factory_of, trust
from .names import OWN_BOUNDS, recorded_name
from .settings import Setting, checked_settings, settings_from, settings_of
from .signals import raw_senses, senses_of

ROBOTS, STEPS = 4, 60
_CHECKPOINTS = 12, 25, 40  # odd and even numbers of steps
_CASES = (  # tasks and observation sets: each kind of signal is in one of them
    ("wall_avoidance", "paper"),
    ("spot_finding", "paper"),
    ("spot_finding", "raw"),
    ("spot_finding_walls", "raw"),
)
Arrays = Mapping[str, np.ndarray]


class AgentContract:
    """The laws of agents, a test each; a test raises AssertionError if the agent breaks its law.

    Attributes:
      name: Name of the agent, or its factory as package.module:factory. The tests run its code.
      task: Name of the task whose signals the agent receives.
      signals: Observation set: "paper", or "raw" with smell and reward before they saturate.
      learns: Whether training must change the agent's weights.
      settings: Values of the agent's settings that differ from the defaults, by name.
    """

    name = ""
    task = "spot_finding"
    signals = "paper"
    learns = True
    settings: Mapping[str, float] = {}

    def test_motor_values_lie_in_their_range(self) -> None:
        """Motor values lie in [-0.5, 0.5]; the simulation would clip others."""
        _law(np.isfinite(self.motors).all(), "motor values are not finite")
        largest = float(np.abs(self.motors).max())
        _law(largest <= 0.5, f"motor values must lie in [-0.5, 0.5], the largest is {largest:.3g}")

    def test_weights_stay_finite(self) -> None:
        """No weight becomes NaN or infinite; a simulation would stop such a robot."""
        agent = self.made()
        for step in range(STEPS + 1):  # the last only checks: no step is left
            for name, array in agent.weights().items():
                for robot in np.argwhere(~np.isfinite(array))[:1, 0]:
                    _law(False, f"{name} of robot {robot} is not finite after {step} steps")
            self.feed(agent, step, step + 1)

    def test_the_seed_decides_everything(self) -> None:
        """Equal seeds give equal actions, so that a life can be simulated again."""
        _same("the same seed gives other actions", self.life(), self.motors)

    def test_training_changes_weights(self) -> None:
        """Training changes the weights; an agent that returns no weights is not checked."""
        agent = self.made()
        born = copied(agent.weights())
        self.feed(agent, 0, STEPS)
        if born and self.learns:
            changed = _differing(born, agent.weights())
            _law(changed, f"{STEPS} steps of training change no weights; does it learn later?")

    def test_tests_change_no_weights(self) -> None:
        """A test, which is without learning, leaves the weights as they are."""
        agent = self.made()
        self.feed(agent, 0, 30)
        before = copied(agent.weights())
        self.feed(agent, 30, STEPS, learning=False)
        changed = _differing(before, agent.weights())
        _law(not changed, f"a test changes the weights {changed}")

    def test_a_restored_state_continues_bit_exactly(self) -> None:
        """Tries three checkpoints, since a missing array may matter at some steps only."""
        first, begin = self.made(), 0
        states = {}
        for step in _CHECKPOINTS:
            self.feed(first, begin, step)
            states[step], begin = copied(first.state()), step
        self.feed(first, begin, STEPS)
        for step, state in states.items():
            second = self.made(seed=3)
            _loaded("load_state", second, state)
            rest = self.feed(second, step, STEPS)
            lived = np.concatenate([self.motors[:step], rest])
            _same(f"after a checkpoint at step {step} other actions", lived, self.motors)
            changed = _differing(first.state(), second.state())
            _law(not changed, f"after a checkpoint at step {step} state() has other {changed}")

    def test_robots_share_nothing_but_random_numbers(self) -> None:
        """Changing all other robots' signals and rewards does not change a robot's actions."""
        states, rewards = (array.copy() for array in self.stream)
        states[:, 1:], rewards[:, 1:] = states[::-1, 1:], rewards[::-1, 1:]
        first = _lived(self.made(), states, rewards)[:, 0]
        equal = _close(first, self.motors[:, 0], atol=1e-4)
        _law(equal, "other robots' signals change a robot's actions")

    def test_nothing_is_learned_across_a_placement(self) -> None:
        """The first reward after `reset` changes no weights, since it belongs to no action."""
        found = []
        for reward in (self.stream[1].min(), self.stream[1].max()):
            agent = self.made()
            self.feed(agent, 0, 20)
            agent.reset()
            agent.act(self.stream[0][20], True)
            agent.learn(np.full(ROBOTS, reward))
            found.append(copied(agent.weights()))
        changed = _differing(*found)
        _law(not changed, f"the first reward after reset changes {changed}")

    def test_kept_weights_drive_it_again(self) -> None:
        """Loaded weights give the same actions, as films need; `load_weights` may be missing."""
        agent, other = self.made(), self.made(seed=3)
        self.feed(agent, 0, STEPS)
        try:
            _loaded("load_weights", other, copied(agent.weights()))
        except NotImplementedError:
            return
        tests = []
        for one in (agent, agent, other):
            one.reset()
            tests.append(self.feed(one, 0, 30, learning=False))
        if _close(*tests[:2], atol=1e-5):  # the agent's tests are not random
            equal = _close(*tests[1:], atol=1e-5)
            _law(equal, "loaded weights drive it otherwise: weights() misses something")

    def test_robots_may_differ_in_their_settings(self) -> None:
        """A single value acts as the same value for each robot; its own affects no other."""
        each = {n: one for n, one in settings_of(self._factory).items() if one.each}
        if not each:
            return
        alike, alone = self.life(**_at(each, 0.5)), self.life(**_at(each, *[0.5] * ROBOTS))
        _law(_close(alike, alone, atol=1e-3), "a value for each robot gives other actions")
        differing = self.life(**_at(each, 1.0, *[0.5] * (ROBOTS - 1)))[:, 1:]
        equal = _close(alone[:, 1:], differing, atol=1e-3)
        _law(equal, "another value of one robot's settings changes the actions of others")

    def broken(self) -> list[str]:
        """Returns a sentence for each law that the agent breaks, without repetitions.

        Raises:
          InputError: the agent cannot be made.
          RunError: its factory exits.
        """
        self.made()
        sentences = []
        for law in [law for law in dir(self) if law.startswith("test_")]:
            try:
                getattr(self, law)()
            except (AssertionError, InputError, RunError) as error:
                sentences.append(str(error))
        return [*dict.fromkeys(sentences)]

    @property
    def _factory(self) -> Callable[..., Agent]:
        name = recorded_name(self.name)
        trust(name)
        return factory_of(name)

    @functools.cached_property
    def stream(self) -> tuple[np.ndarray, np.ndarray]:
        """Random signals (STEPS, B, S) and rewards (STEPS, B), some at an end of their ranges."""
        random, reward = np.random.default_rng(0), self._senses.reward
        low, high = np.array([(signal.low, signal.high) for signal in self._senses.state]).T
        states = random.uniform(low, high, (STEPS, ROBOTS, len(low)))
        rewards = random.uniform(reward.low, reward.high, (STEPS, ROBOTS))
        # Saturated and silent signals occur in a life more often than any other.
        states[::7], states[1::7], rewards[::5] = low, high, reward.low
        return states.astype(np.float32), rewards.astype(np.float32)

    @property
    def _senses(self) -> Senses:
        senses = senses_of(self.task)
        return raw_senses(senses) if self.signals == "raw" else senses

    def made(self, seed: int = 1, **settings: list[float]) -> Agent:
        """Returns a new agent of `ROBOTS` robots, after its first `reset`."""
        values = {name: [value] for name, value in self.settings.items()} | settings
        checked = checked_settings(self.name, self._factory, values, ROBOTS)
        make = functools.partial(self._factory, ROBOTS, self._senses, seed, **checked)
        agent = CheckedAgent(self.name, make, ROBOTS)
        agent.reset()
        return agent

    def feed(self, agent: Agent, first: int, last: int, learning: bool = True) -> np.ndarray:
        """Feeds steps `first` to `last` - 1 to an agent; returns motor values (steps, B, 2)."""
        states, rewards = self.stream
        return _lived(agent, states[first:last], rewards[first:last], learning)

    @functools.cached_property
    def motors(self) -> np.ndarray:
        """Motor values of an agent in training, shape (STEPS, B, 2)."""
        return self.life()

    def life(self, **settings: list[float]) -> np.ndarray:
        """Returns the motor values of a new agent in training, shape (STEPS, B, 2)."""
        return self.feed(self.made(1, **settings), 0, STEPS)


def check_agent(name: str, settings: Sequence[str] = ()) -> list[str]:
    """Returns the sentences of `AgentContract.broken` for four pairs of task and signals.

    The agent's code is run; its settings are given as NAME=VALUE.

    Raises:
      InputError, RunError: see `AgentContract.broken`.
    """
    broken = []
    for task, signals in tracked(_CASES, f"checking {name}"):
        contract = AgentContract()
        contract.name, contract.task, contract.signals = name, task, signals
        contract.learns = recorded_name(name) not in OWN_BOUNDS
        contract.settings = {one: value for one, (value,) in settings_from(settings).items()}
        broken += [f"{task}, {signals} signals: {sentence}" for sentence in contract.broken()]
    return broken


def _law(holds: object, sentence: str) -> None:
    if not holds:  # not an assert, which Python leaves out with -O
        raise AssertionError(sentence)


def _same(sentence: str, motors: np.ndarray, others: np.ndarray) -> None:
    later = (motors != others) & ~(np.isnan(motors) & np.isnan(others))
    later = later.any(axis=(1, 2))
    _law(not later.any(), f"{sentence} from step {later.argmax()} on")


def _close(motors: np.ndarray, others: np.ndarray, atol: float) -> bool:
    return np.allclose(motors, others, atol=atol, equal_nan=True)


def _lived(
    agent: Agent, states: np.ndarray, rewards: np.ndarray, learning: bool = True
) -> np.ndarray:
    motors = []
    for state, reward in zip(states, rewards, strict=True):
        motors.append(np.array(agent.act(state, learning)))
        if learning:
            agent.learn(reward)
    return np.array(motors)


def _loaded(method: str, agent: Agent, arrays: Arrays) -> None:
    try:
        getattr(agent, method)(arrays)
    except (ValueError, KeyError) as error:
        _law(False, f"{method} cannot restore what was stored: {error!r}")


def _at(settings: Mapping[str, Setting], *shares: float) -> dict[str, list[float]]:
    """Returns each setting's values at the given shares of its range, from 0 to 1."""
    return {name: [one.at(share) for share in shares] for name, one in settings.items()}


def _differing(first: Arrays, second: Arrays) -> str:
    """Returns the names of at most three arrays that are not bit-equal; "" if all are equal."""
    none = np.empty(0)
    wrong = [
        name
        for name in {**first, **second}
        if not np.array_equal(first.get(name, none), second.get(name, none), equal_nan=True)
    ]
    return ", ".join(wrong[:3])
