"""Simulates robots with stored brains or a policy: one in an episode, or many in a batch.

A run does not store the random streams of its robots. Their motion therefore differs from that in
the run, unless nothing is random.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...tasks import CONTROL_TIMESTEP, Robots, make_batch
from ...tasks.lives import Phase, control_steps, place
from ...tasks.spot_finding import SpotFindingRules
from ...tasks.starts import Start, random_spots
from ...tasks.suite import TASKS
from ...tasks.world import WorldRules
from ..agents.base import Agent
from ..agents.factory import trust
from ..agents.names import recorded_name, short_name
from ..analysis.behaviour import Track
from ..errors import InputError, check_name
from ..progress import tracked
from ..runs.cohort import Cohort, compiled_life, make_agent
from ..runs.conditions import CohortKey, Condition
from ..runs.device import decide
from ..runs.experiment import Experiment
from ..runs.run import ConditionResults, Run, When
from ..terminal import notice

if TYPE_CHECKING:
    from ..agents.policy import Policy

SEED = 0  # default seed of random streams, which a run does not store

Act = Callable[[np.ndarray], np.ndarray]
"""Returns motor values in [-0.5, 0.5], shape (B, 2), for observations, float32, shape (B, S)."""

# For each of the two tests, the stored brain that drove the robot: before or after training.
BRAINS_OF_TESTS: dict[str, When] = {"pre": "before", "post": "after"}
_ALONE = np.array([0])  # index of the robot in a batch of one
BEFORE = "before training"


# ---- One robot in an episode ----


@dataclasses.dataclass(frozen=True)
class Moment:
    """A robot at the start of a control step."""

    time: float  # simulated time since the start of the episode, in [s]
    pose: np.ndarray  # x, y in [m] and heading in [rad], shape (3,)
    spot: np.ndarray  # x, y of the spot's centre in [m], shape (2,)
    signals: dict[str, np.ndarray]  # latest sensor signals by name, each of shape (signals,)
    motors: np.ndarray  # motor values that the driver commands, left motor first, shape (2,)
    contact: bool
    event: bool  # whether the measured event, such as contact, happens; False at first
    event_seconds: float  # time with the event since the start of the episode, in [s]
    nose: float = 0.0  # angle by which the world turns the nose, in [rad], counterclockwise

    @classmethod
    def of(cls, batch: Robots, row: int, step: int, event: bool, events: int) -> Moment:
        """Returns the moment of robot `row`; its motor values are not known yet, and 0."""
        sensed = batch.sensordata[row].copy()
        return cls(
            step * CONTROL_TIMESTEP,
            batch.pose[row].copy(),
            batch.spot[row].copy(),
            batch.rules.observations(sensed),
            np.zeros(2),
            bool((sensed[batch.rules.layout.touch] > 0).any()),
            event,
            events * CONTROL_TIMESTEP,
            math.radians(batch.rules.world.nose) if isinstance(batch.rules, WorldRules) else 0.0,
        )


@dataclasses.dataclass(frozen=True)
class Episode:
    """A robot at its start pose, and the driver that acts from there."""

    task: str  # name of a task of the domain "arena"
    driver: str  # proposer, agent or policy, in words
    when: str  # "before training" or "after training"
    event: str  # measured event, in words
    batch: Robots  # batch of one robot
    act: Act
    steps: float  # control steps; infinity for an episode without end
    random: np.random.Generator  # draws the spot's places in tasks in which it jumps

    @classmethod
    def of_policy(cls, policy: Policy, phase: str, seed: int) -> Episode:
        """Returns the episode that Gymnasium's `reset(seed=seed)` starts in the policy's task.

        Raises:
          InputError: there is no such phase or seed.
        """
        when = f"{_when(phase, seed)} training"
        act, task = policy_act(policy, phase), policy.task
        batch, random = make_batch(task, 1), np.random.default_rng(seed)
        pose, spot = Start().draw(random, batch.dimensions)
        batch.place_spot(_ALONE, spot[None])
        batch.place(_ALONE, pose[None])
        steps = TASKS[task].time_limit / CONTROL_TIMESTEP
        event = "in the spot" if issubclass(TASKS[task].rules, SpotFindingRules) else "in contact"
        return cls(task, "PPO", when, event, batch, act, steps, random)

    @property
    def seconds(self) -> float:
        """Duration in simulated seconds."""
        return self.steps * CONTROL_TIMESTEP

    def moments(self) -> Iterator[Moment]:
        """Simulates the episode and yields its moments; ends early if the simulation is unstable.

        An episode can be simulated only once.
        """
        batch, rules, events, event = self.batch, self.batch.rules, 0, False
        spot_steps = TASKS[self.task].spot_steps
        for step in itertools.count():
            motors = self.act(rules.state(batch.sensordata).astype(np.float32))
            moment = Moment.of(batch, 0, step, event, events)
            yield dataclasses.replace(moment, motors=motors[0])
            if step >= self.steps:
                return
            if spot_steps and step and step % spot_steps == 0:
                batch.place_spot(_ALONE, random_spots(self.random, batch.dimensions, 1))
            batch.step(motors)
            if not batch.valid.all():
                return
            event = bool(rules.event(batch.sensordata)[0])
            events += event


def policy_act(policy: Policy, phase: str) -> Act:
    """Returns a policy's action function in the phase "pre" or "post"; InputError if none."""
    return functools.partial(policy.act, trained=_when(phase) == "after")


def _when(phase: str, seed: int = SEED) -> When:
    """Returns which stored brain drives in a test ("pre", "post"); InputError for another name."""
    check_name("phase", phase, BRAINS_OF_TESTS)
    if not 0 <= seed < 2**63:
        raise InputError(f"the seed must lie in [0, 2^63), got {seed}")
    return BRAINS_OF_TESTS[phase]


@dataclasses.dataclass(frozen=True)
class StoredRobot:
    """A robot of a run that repeats a test with its stored brain."""

    run: Run
    condition: Condition
    robot: int  # number within the condition
    phase: str  # test to repeat: "pre" before training, or "post" after training
    seed: int = SEED  # seed of the brain's noise

    def agent(self) -> Agent:
        """Returns the robot's brain, or its agent, at the time of the test, as a batch of one.

        Raises:
          InputError: there is no such robot, its simulation was invalid, its agent is not trusted
            or cannot take over stored weights, or a value is invalid.
        """
        when = _when(self.phase, self.seed)
        self.check()
        return stored_brains(self.run, self.condition, [(self.robot, when)], self.seed)

    def act(self) -> Act:
        """Returns the function that drives the robot with frozen weights; see `agent`."""
        agent = self.agent()
        agent.reset()
        return functools.partial(agent.act, learning=False)

    def episode(self) -> Episode:
        """Returns the first phase of the test, with robot and spot at their start places.

        It ends where the test would place them again.

        Raises:
          InputError: see `agent`; or the robot has other dimensions than the model that is drawn.
        """
        act, experiment, task = self.act(), self.run.experiment, self.condition.life
        _check_drawn(experiment)
        batch, random = experiment.batch(task, 1), np.random.default_rng(self.seed)
        start = _first_phase(experiment, task, self.phase)
        place(batch, start, random)
        life = experiment.life_of(task)
        return Episode(
            life.task,
            _driver(self.condition, self.robot),
            f"{_when(self.phase)} training",
            life.event,
            batch,
            act,
            control_steps(min(start.minutes, start.every_minutes or math.inf)),
            random,
        )

    def check(self) -> None:
        """Raises InputError if there is no such robot, or its simulation was invalid."""
        robots = self.run.robots(self.condition)
        if not robots:
            known = ", ".join(map(str, self.run.conditions()))
            hint = f"{known}: --proposer or --agent chooses" if known else "none"
            raise InputError(f"the run has no robots of {self.condition}; it has {hint}")
        if not 0 <= self.robot < len(robots):
            ends = f"0 to {len(robots) - 1}"
            raise InputError(f"the robots of {self.condition} are {ends}, got {self.robot}")
        if not robots[self.robot].valid:
            raise InputError(
                f"robot {self.robot} of {self.condition} is invalid: it was stopped, because its "
                "simulation became unstable or its weights were not finite"
            )


@dataclasses.dataclass(frozen=True)
class Relived:
    """A robot of a run whose life is simulated again, together with its whole cohort.

    It can be filmed like an `Episode`, but also learns in training.
    """

    task: str  # name of a task of the domain "arena"
    driver: str  # proposer or agent, in words
    event: str  # measured event, in words
    cohort: Cohort
    robot: int  # number within the condition

    @classmethod
    def at(cls, run: Run, condition: Condition, robot: int, minute: float) -> Relived:
        """Simulates the life of a robot up to `minute`, and says if it differs from the run's.

        Raises:
          InputError: there is no such robot or minute, the agent is not trusted, the robot has
            other dimensions than the model that is drawn, or its run used a GPU or MuJoCo Warp.
        """
        StoredRobot(run, condition, robot, "post").check()
        experiment = run.experiment
        _check_drawn(experiment)
        if experiment.on_tensors:
            raise InputError(
                "a life that was simulated on a GPU or in MuJoCo Warp cannot be simulated again"
            )
        life = experiment.life_of(condition.life)
        last = (total := sum(life.steps())) / control_steps(1)
        if not 0 <= minute < last:
            raise InputError(f"the life has minutes from 0 to {last:g}, got {minute:g}")
        steps = min(round(minute * control_steps(1)), total - 1)
        cohort = Cohort(experiment, CohortKey(condition, robot // experiment.cohort_size))
        for _ in tracked(range(math.ceil(minute)), f"living {minute:g} minutes"):
            cohort.advance(min(control_steps(1), steps - cohort.step))
        lived = ConditionResults.of(experiment, condition, cohort.lives()).curves
        whole = int(minute)  # minutes that can be compared
        number = robot % experiment.cohort_size
        if (lived[number, :whole] != run.results[condition].curves[robot, :whole]).any():
            notice(
                f"robot {robot} lives otherwise than in the run: this version or this processor "
                "computes or rounds differently"
            )
        return cls(life.task, _driver(condition, robot), life.event, cohort, robot)

    @property
    def when(self) -> str:
        """The present minute of the life, in words."""
        return f"minute {self.cohort.step / control_steps(1):g}"

    @property
    def batch(self) -> Robots:
        """The robots of the cohort."""
        return self.cohort.batch

    @property
    def seconds(self) -> float:
        """Remaining duration of the life, in simulated seconds."""
        return (self.cohort.steps - self.cohort.step) * CONTROL_TIMESTEP

    def moments(self) -> Iterator[Moment]:
        """Simulates the life and yields the robot's moments; see `Episode.moments`."""
        batch, row = self.batch, self.robot % self.batch.robots
        recorded, events, event = self.cohort.recorded(), 0, False
        first = self.cohort.step
        while not self.cohort.finished and self.cohort.valid[row]:
            self.cohort.enter()
            moment = Moment.of(batch, row, self.cohort.step - first, event, events)
            recorded.clear()
            self.cohort.advance(1)
            yield (moment := dataclasses.replace(moment, motors=recorded[0][row].copy()))
            event = bool(batch.rules.event(batch.sensordata)[row])
            events += event
        if self.cohort.valid[row]:
            last = Moment.of(batch, row, self.cohort.step - first, event, events)
            yield dataclasses.replace(last, motors=moment.motors)


def _check_drawn(experiment: Experiment) -> None:
    """Raises InputError if a run's robot has other dimensions than the model that is drawn."""
    for name in ("radius", "wheel_base"):
        if (value := getattr(experiment.kinematics, name)) is not None:
            raise InputError(f"films draw the ordinary robot; this run has {name}={value:g}")


def _driver(condition: Condition, robot: int) -> str:
    kind = " proposer" if condition.has_brain else ""
    return f"{short_name(condition.proposer)}{kind}, robot {robot}"


def robots_named(task: str, proposer: str | None, agent: str | None) -> Condition:
    """Returns the condition of the robots that a command names; creative ones by default.

    `agent` is a name as in `musebot run --agent`; a user's agent is trusted from now on.

    Raises:
      InputError: a name is unknown, or both an agent and a proposer are given.
    """
    if proposer and agent:
        raise InputError("a robot has a proposer or an agent, not both")
    if not agent:
        return Condition(task, proposer or "creative")
    name = recorded_name(agent)
    trust(name)
    return Condition(task, name)


# ---- Many robots in a batch ----


def stored_brains(
    run: Run, condition: Condition, which: Sequence[tuple[int, When]], seed: int = SEED
) -> Agent:
    """Returns a condition's brains, or agents, with stored weights, as one batch.

    `which` holds, for each robot, its row within the condition, and whether it has the weights
    "before" or "after" training. `seed` is that of the batch's random stream.

    Raises:
      InputError: the agent is not trusted, or cannot take over these weights.
    """
    stored = run.results[condition].networks
    weights = {
        name: np.stack([stored[when][name][row] for row, when in which]) for name in stored["after"]
    }
    agent = make_agent(run.experiment, condition, len(which), seed)
    try:
        agent.load_weights(weights)
    except (ValueError, KeyError, NotImplementedError) as error:
        name = short_name(condition.proposer)
        raise InputError(f"{name} cannot take over the weights of {run.name}: {error}") from error
    return agent


def evaluate(
    run: Run, condition: Condition, which: Sequence[tuple[int, When]], minutes: float
) -> Track:
    """Evaluates `stored_brains` for the first `minutes_of_test` of the test after training."""
    agent = stored_brains(run, condition, which)
    batch = run.experiment.batch(condition.life, len(which))
    start = _first_phase(run.experiment, condition.life, "post")
    place(batch, start, np.random.default_rng(SEED))
    steps = control_steps(minutes_of_test(run, condition.life, minutes))
    return watch(batch, agent, steps, what=str(condition))


def minutes_of_test(run: Run, task: str, most: float) -> float:
    """Returns `most` minutes, times the time scale; fewer if robots are placed again earlier."""
    start = _first_phase(run.experiment, task, "post")
    return min(most * run.experiment.time_scale, start.minutes, start.every_minutes or math.inf)


def _first_phase(experiment: Experiment, task: str, stage: str) -> Phase:
    life = experiment.life_of(task)
    if not life.tested:
        raise InputError(f"the life {task} has no test that could be repeated")
    return next(phase for phase in life.phases if phase.stage == stage)


def watch(
    batch: Robots, agent: Agent, steps: int, *, learning: bool = False, what: str = "robots"
) -> Track:
    """Simulates robots from their current poses, shows the progress, and records their track.

    The B robots must have been placed. `learning` is whether they learn and explore; `what`
    describes them in the display of progress.
    """
    poses = np.empty((steps + 1, batch.robots, 3), dtype=np.float32)
    events = np.empty((steps, batch.robots), dtype=bool)
    nose = np.empty((steps, batch.robots, 2), dtype=np.float32)
    poses[0] = batch.pose
    life, counts = compiled_life(agent, batch), np.zeros(batch.robots, dtype=np.int32)
    for step in tracked(range(steps), f"observing {what}"):
        if life is None or not life(1, learning, counts):
            batch.step(decide(agent, batch, learning))
        poses[step + 1] = batch.pose
        events[step] = batch.rules.event(batch.sensordata)
        nose[step] = batch.sensordata[:, batch.rules.layout.smell][:, :2]
    return Track(poses, events, batch.spot.copy(), nose)
