"""Checks that an agent keeps to the interface: what `musebot check-agent` reports."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from ...controller.parameters import Parameters
from ..agents.base import Agent
from ..agents.factory import factory_of
from ..agents.senses import senses_of
from ..agents.settings import Setting, settings_of
from ..errors import InputError, RunError
from ..lives.agent import make_agent
from ..lives.conditions import Condition
from ..lives.experiment import Experiment

ROBOTS = 8
_STEPS = 300
_CHECKPOINTS = range(12, _STEPS, 29)  # odd and even numbers of steps
_LIMIT = 0.5  # largest motor value
TIMED = 60, 500
"""Robots and control steps of the measurement of speed."""
_PARTS = 10  # parts of these steps; the first is not timed


class Check(NamedTuple):
    """What one check found.

    Attributes:
      name: What the agent should do.
      passed: Whether it does; None for a remark, or if it cannot be determined.
      says: What was seen.
    """

    name: str
    passed: bool | None
    says: str


class Stream:
    """Signals and rewards drawn uniformly from their ranges, the same for every agent."""

    def __init__(self, task: str, robots: int, steps: int) -> None:
        """Draws a stream for a task of the domain "arena"."""
        senses, random = senses_of(task), np.random.default_rng(0)
        low, high = np.array([(signal.low, signal.high) for signal in senses.state]).T
        self.states = random.uniform(low, high, (steps, robots, len(low))).astype(np.float32)
        span = senses.reward
        self.rewards = random.uniform(span.low, span.high, (steps, robots)).astype(np.float32)
        # Saturated and silent signals occur in a life more often than any other.
        self.states[::7], self.states[1::7] = low, high
        self.rewards[::5] = span.low

    def feed(self, agent: Agent, first: int, last: int, learning: bool = True) -> np.ndarray:
        """Returns the motor values of some steps, shape (steps, B, 2)."""
        motors = []
        for state, reward in zip(self.states[first:last], self.rewards[first:last], strict=True):
            motors.append(np.array(agent.act(state, learning)))
            if learning:
                agent.learn(reward)
        return np.array(motors)


def checks(experiment: Experiment, condition: Condition) -> Iterator[Check]:
    """Checks an agent on streams of signals, without a simulation.

    Args:
      experiment: Experiment with the agent's settings and signals.
      condition: Task, and the agent's name as runs record it.

    Raises:
      InputError: the agent cannot be made, or breaks the interface.
      RunError: the agent fails or exits.
    """
    task = experiment.arena_task(condition.task)

    def made(seed: int = 1) -> Agent:
        agent = make_agent(experiment, condition, ROBOTS, seed)
        agent.reset()
        return agent

    stream = Stream(task, ROBOTS, _STEPS)
    agent = made()
    born = _copied(agent.weights())
    motors, broken = _lived(stream, agent)
    largest = float(np.abs(motors).max())
    yield Check(
        "motor values lie in [-0.5, 0.5]",
        bool(np.isfinite(motors).all()) and largest <= _LIMIT,
        f"largest {largest:.3g}; values beyond are clipped",
    )
    if not motors.any():
        yield Check("it moves", None, "all motor values are 0: a robot that stands still has no L")
    if broken:
        says = f"{broken}; the other checks were skipped"  # they compare numbers
        yield Check("weights stay finite", False, says)
        return
    yield Check("weights stay finite", True, f"in {_STEPS} steps")
    yield _seeds(stream, motors, made)
    yield from _weights(stream, agent, born)
    yield _resumes(stream, motors, made)
    yield _robots_are_apart(task, made)
    yield _placement(stream, made)
    yield _taken_over(stream, agent, made)
    if several := {
        n: one for n, one in settings_of(factory_of(condition.proposer)).items() if one.each
    }:
        yield _settings_of_each(stream, experiment, condition, several)
    yield from _costs(experiment, condition)


def _copied(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: array.copy() for name, array in arrays.items()}


def _lived(stream: Stream, agent: Agent) -> tuple[np.ndarray, str]:
    """Returns the motor values of all steps, and which weight was first not finite, or ""."""
    broken, motors = _not_finite(agent, "at birth"), []
    for step in range(_STEPS):
        motors.append(stream.feed(agent, step, step + 1))
        broken = broken or _not_finite(agent, f"after {step + 1} steps")
    return np.concatenate(motors), broken


def _not_finite(agent: Agent, when: str) -> str:
    """Returns which weight of which robot is not finite now; "" if all are."""
    for name, array in agent.weights().items():
        if not (finite := np.isfinite(array)).all():
            return f"{name} of robot {np.argwhere(~finite)[0][0]} is not finite {when}"
    return ""


def _differing(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> list[str]:
    """Returns the names of arrays that are not bit-equal."""
    return [
        name
        for name in {**first, **second}
        if name not in first
        or name not in second
        or not np.array_equal(first[name], second[name], equal_nan=True)
    ]


def _seeds(stream: Stream, motors: np.ndarray, made: Callable[..., Agent]) -> Check:
    again = stream.feed(made(), 0, _STEPS)
    other = stream.feed(made(2), 0, _STEPS)
    same = np.array_equal(again, motors)
    says = "equal actions again" if same else "the same seed gives other actions: draw from it only"
    if same and np.array_equal(other, motors):
        says += "; another seed changes nothing"
    return Check("the seed decides everything", same, says)


def _weights(stream: Stream, agent: Agent, born: dict[str, np.ndarray]) -> Iterator[Check]:
    before = _copied(agent.weights())
    if not before:
        yield Check("training changes weights", None, "it keeps no weights")
        return
    changed = _differing(born, before)
    yield Check("training changes weights", bool(changed), ", ".join(changed[:3]) or "none changed")
    stream.feed(agent, 0, 50, learning=False)
    changed = _differing(before, agent.weights())
    yield Check(
        "tests change no weights", not changed, ", ".join(changed[:3]) or "none changed in 50 steps"
    )


def _resumes(stream: Stream, motors: np.ndarray, made: Callable[..., Agent]) -> Check:
    """Restores several checkpoints: what one misses may matter at some steps only."""
    name, first, states = "a restored checkpoint continues bit-exactly", made(), {}
    for before, step in itertools.pairwise((0, *_CHECKPOINTS)):
        stream.feed(first, before, step)
        states[step] = _copied(first.state())
    stream.feed(first, _CHECKPOINTS[-1], _STEPS)
    for step, state in states.items():
        second = made(3)
        try:
            second.load_state(state)
        except (ValueError, KeyError) as error:
            return Check(name, False, f"load_state refuses what state returned: {error}")
        rest = stream.feed(second, step, _STEPS)
        if not np.array_equal(rest, motors[step:]):
            later = int((rest != motors[step:]).any(axis=(1, 2)).argmax())
            says = f"other actions {later} steps later, in an agent of another seed"
        elif changed := _differing(first.state(), second.state()):
            says = f"equal actions, but {', '.join(changed[:3])} differ in the end"
        else:
            continue
        return Check(name, False, f"checkpoint after step {step}: {says}: state() misses something")
    return Check(name, True, f"{len(states)} checkpoints, to the end of {_STEPS} steps")


def _robots_are_apart(task: str, made: Callable[..., Agent]) -> Check:
    """Changes the stream of all robots but the first."""
    alone, other = (Stream(task, ROBOTS, 100) for _ in range(2))
    other.states[:, 1:], other.rewards[:, 1:] = other.states[::-1, 1:], other.rewards[::-1, 1:]
    first, second = (one.feed(made(), 0, 100)[:, 0] for one in (alone, other))
    equal = np.allclose(first, second, atol=1e-4)
    says = "the first robot acts as before" if equal else "other robots' signals change its actions"
    return Check("robots share nothing but random numbers", equal, says)


def _placement(stream: Stream, made: Callable[..., Agent]) -> Check:
    name = "nothing is learned across a placement"
    found = []
    for reward in (stream.rewards.min(), stream.rewards.max()):
        agent = made()
        stream.feed(agent, 0, 20)
        agent.reset()
        agent.act(stream.states[20], True)
        agent.learn(np.full(ROBOTS, reward))
        found.append(_copied(agent.weights()))
    if not found[0]:
        return Check(name, None, "it keeps no weights")
    changed = _differing(*found)
    says = "the first reward after reset changes no weights"
    return Check(name, not changed, f"changed: {', '.join(changed[:3])}" if changed else says)


def _taken_over(stream: Stream, agent: Agent, made: Callable[..., Agent]) -> Check:
    name = "kept weights drive it again, for films"
    other = made(3)
    try:
        other.load_weights(_copied(agent.weights()))
    except NotImplementedError:
        return Check(name, None, "it has no load_weights")
    except (ValueError, KeyError) as error:
        return Check(name, False, f"load_weights refuses what weights returned: {error}")

    def tested(one: Agent) -> np.ndarray:
        one.reset()
        return stream.feed(one, 0, 50, learning=False)

    ours = tested(agent)
    if np.allclose(ours, tested(other), atol=1e-5):
        return Check(name, True, "equal actions in 50 steps of a test")
    if np.allclose(ours, tested(agent), atol=1e-5):
        return Check(name, False, "other actions in a test: weights() misses something")
    return Check(name, None, "other actions: tests are random, or weights() misses something")


def _settings_of_each(
    stream: Stream, experiment: Experiment, condition: Condition, several: Mapping[str, Setting]
) -> Check:
    """Gives one value of each setting to all robots, then to each, then the first another one."""
    name = "robots may differ in their settings"
    others = tuple(word for word in experiment.settings if word.partition("=")[0] not in several)

    def lived(*shares: float) -> np.ndarray:
        """Returns the actions with these shares of each range, of all robots or of each."""
        words = tuple(
            f"{own}={','.join(str(one.at(share)) for share in shares)}"
            for own, one in several.items()
        )
        changed = dataclasses.replace(experiment, settings=(*others, *words))
        agent = make_agent(changed, condition, ROBOTS, 1)
        agent.reset()
        return stream.feed(agent, 0, 100)

    together = lived(0.5)
    try:
        alone = lived(*[0.5] * ROBOTS)
    except (InputError, RunError) as error:
        return Check(name, False, f"it fails with an array, which each=True allows: {error}")
    try:
        differing = lived(1.0, *[0.5] * (ROBOTS - 1))
    except (InputError, RunError) as error:
        return Check(name, False, f"it fails if one robot has the highest values: {error}")
    if not np.allclose(together, alone, atol=1e-3):
        return Check(name, False, "the same value for each robot gives other actions")
    if not np.allclose(alone[:, 1:], differing[:, 1:], atol=1e-3):
        return Check(name, False, "another value of one robot changes the actions of others")
    return Check(name, True, ", ".join(several))


def _costs(experiment: Experiment, condition: Condition) -> Iterator[Check]:
    found = costs(experiment, condition)
    yield Check(
        "time",
        None,
        f"{found.microseconds:.1f} us a robot-step with {TIMED[0]} robots, the paper's brain "
        f"{found.papers:.1f} ({found.microseconds / found.papers:.1f} times)",
    )
    yield Check("memory", None, f"{found.bytes / 1024:.1f} KiB a robot in a checkpoint")


def _microseconds(stream: Stream, agent: Agent) -> float:
    """Returns the median time of a robot-step over parts of a stream, in [us]."""
    agent.reset()
    steps, robots = stream.rewards.shape
    ends = np.linspace(0, steps, _PARTS + 1).astype(int)
    stream.feed(agent, 0, ends[1])
    spent = []
    for first, last in itertools.pairwise(ends[1:].tolist()):
        begun = time.perf_counter()
        stream.feed(agent, first, last)
        spent.append((time.perf_counter() - begun) / (last - first))
    return float(np.median(spent)) / robots * 1e6


class Costs(NamedTuple):
    """What an agent costs, without the simulation.

    Attributes:
      microseconds: Time of a robot-step.
      papers: That of the paper's creative brain, measured right after.
      bytes: Size of a robot in a checkpoint.
    """

    microseconds: float
    papers: float
    bytes: float


def costs(experiment: Experiment, condition: Condition) -> Costs:
    """Measures time and memory of an agent or brain, in training on a stream of signals.

    Raises:
      InputError: the agent cannot be made.
      RunError: the agent fails or exits.
    """
    robots, steps = TIMED
    stream = Stream(experiment.arena_task(condition.task), robots, steps)
    papers = Experiment(protocol=experiment.protocol, brain=Parameters())
    learner = make_agent(experiment, condition, robots, 1)
    brain = make_agent(papers, Condition(condition.task, "creative"), robots, 1)
    spent = [_microseconds(stream, agent) for agent in (learner, brain)]
    size = sum(array.nbytes for array in learner.state().values()) / robots
    return Costs(spent[0], spent[1], size)
