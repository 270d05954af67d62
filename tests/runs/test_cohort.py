"""A cohort follows its schedule: its placements, when it learns, and how events are counted."""

import copy
import dataclasses

import numpy as np
import pytest

from musebot.controller import BRAINS
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import BODIES, Experiment
from musebot.tasks.lives import CHANGING, UPPER_LEFT, UPPER_RIGHT

ROBOTS = 3
MINUTE = 600  # control steps


@dataclasses.dataclass(frozen=True)
class Timeline:
    """A life by sections 3.1 and 3.2, in control steps computed by hand."""

    time_scale: float
    training: range
    end: int
    robot_placed: tuple[int, ...]
    spot_placed: tuple[int, ...]

    @property
    def stages(self):
        return range(self.training.start), self.training, range(self.training.stop, self.end)


TIMELINES = {
    # A hundredth of 10 + 10 minutes, 24 times 5 minutes, 10 + 10 minutes.
    "wall_avoidance": Timeline(
        0.01, range(120, 840), 960, (0, 60, *range(120, 840, 30), 840, 900), ()
    ),
    # A two-hundredth of 1 hour, 4 times 1 hour, 1 hour.
    "spot_finding": Timeline(0.005, range(180, 900), 1080, (0, 900), (0, 180, 360, 540, 720, 900)),
}


def bump(step, state):
    """Drives ahead, and back in every third stretch of time; later more slowly."""
    speed = 0.5 if step < MINUTE else 0.2
    back = (step // np.array([11, 13, 17])) % 3 == 2
    return np.where(back, -speed, speed)[:, None].repeat(2, axis=1)


def seek(step, state):
    """Turns, each robot differently, until it smells the spot, then drives; later more slowly."""
    turns = np.array([[-0.2, 0.2], [0.2, -0.2], [-0.3, 0.3]])
    return np.where(state > 0, 0.5 if step < MINUTE else 0.3, turns)


class Watched:
    """A life recorded from birth to the last test: arrays of what happened in each call."""

    def __init__(self, task, drive=None, proposer="creative", **changes):
        """Lets `drive` replace what the brain chose."""
        self.task, self.timeline = task, TIMELINES[task]
        settings = {"cohort_size": ROBOTS, "time_scale": self.timeline.time_scale} | changes
        self.cohort = Cohort(Experiment(**settings), CohortKey(Condition(task, proposer), 0))
        self.networks = [self.weights()]  # at birth, before and after training
        agent, batch = self.cohort.agent, self.cohort.batch
        brain = agent.controller  # its `learn` returns the TD error
        calls = {"act": [], "learn": [], "step": []}
        act, learn, step = agent.act, brain.learn, batch.step

        def watched_act(state, explore):
            if len(calls["act"]) in (self.timeline.training.start, self.timeline.training.stop):
                self.networks.append(self.weights())
            seen = dict(explore=explore, state=state.copy(), spot=batch.spot, pose=batch.pose)
            calls["act"].append(seen | self.world())
            motors = act(state, explore)
            return motors if drive is None else drive(len(calls["act"]) - 1, state)

        def watched_learn(reward):
            before, error = self.weights(), learn(reward)
            changed = np.any([differ(before[k], v) for k, v in self.weights().items()], axis=0)
            given = dict(reward=reward.numpy().copy(), error=error.numpy().copy(), changed=changed)
            calls["learn"].append(given | {"at": len(calls["act"]) - 1})
            return error

        def watched_step(motors):
            step(motors)
            calls["step"].append(self.world())

        agent.act, brain.learn, batch.step = watched_act, watched_learn, watched_step
        self.cohort.advance(10**9)
        for name, made in calls.items():
            setattr(self, name, {k: np.array([call[k] for call in made]) for k in made[0]})

    def world(self):
        batch = self.cohort.batch
        return dict(sensordata=batch.sensordata.copy(), physics=batch.arrays()["state"].copy())

    def weights(self):
        return {k: v.copy() for k, v in self.cohort.agent.weights().items()}


def differ(one, other):
    """Returns which rows differ, such as which robots' numbers."""
    return (one != other).reshape(len(one), -1).any(axis=1)


@pytest.fixture(scope="module")
def walls():
    return Watched("wall_avoidance", drive=bump)


@pytest.fixture(scope="module")
def spots():
    return Watched("spot_finding", drive=seek)


@pytest.fixture(params=["walls", "spots"])
def life(request):
    return request.getfixturevalue(request.param)


# Acting and learning


def test_every_control_step_acts_once_and_only_training_explores_and_learns(life):
    steps, training = life.timeline.end, [*life.timeline.training]
    assert len(life.act["state"]) == len(life.step["physics"]) == steps
    assert life.cohort.step == life.cohort.steps == steps
    assert np.flatnonzero(life.act["explore"]).tolist() == training
    assert life.learn["at"].tolist() == training


def test_robots_act_on_what_they_sense_now_and_learn_from_the_reward_observed_with_it(life):
    state = life.cohort.batch.rules.state(life.act["sensordata"]).astype(np.float32)
    np.testing.assert_array_equal(life.act["state"], state)
    # In both tasks the reward is the state's last number: the contact, or the nose.
    rewards = life.learn["reward"]
    np.testing.assert_array_equal(rewards, state[life.learn["at"], :, -1])
    assert (np.ptp(rewards, axis=0) > 0).all()


# Placements


def test_robots_and_spots_are_placed_when_the_schedule_says_and_at_no_other_time(life):
    act, step = life.act, life.step
    jumps = act["physics"][1:] != step["physics"][:-1]
    moves = act["spot"][1:] != act["spot"][:-1]
    for changed, placed in (
        (jumps, life.timeline.robot_placed),
        (moves, life.timeline.spot_placed),
    ):
        of_robots = changed.any(axis=2)  # of all at the same time
        assert [0, *(np.flatnonzero(of_robots.any(axis=1)) + 1)] == [0, *placed[1:]]
        np.testing.assert_array_equal(of_robots.any(axis=1), of_robots.all(axis=1))


TESTS = {
    "walls": {0: UPPER_LEFT, 60: UPPER_RIGHT, 840: UPPER_LEFT, 900: UPPER_RIGHT},
    "spots": {0: UPPER_LEFT, 900: UPPER_LEFT},
}


@pytest.mark.parametrize("which", TESTS)
def test_tests_start_in_the_papers_places_and_training_in_random_ones(which, request):
    life = request.getfixturevalue(which)
    for step, robot in TESTS[which].items():
        np.testing.assert_allclose(life.act["pose"][step], np.tile(robot, (ROBOTS, 1)), atol=1e-12)
        if which == "spots":
            assert life.act["spot"][step].tolist() == [[*UPPER_RIGHT[:2]]] * ROBOTS
    placed = life.timeline.robot_placed if which == "walls" else life.timeline.spot_placed
    drawn = life.act["pose" if which == "walls" else "spot"]
    drawn = drawn[[step for step in placed if step in life.timeline.training]]
    for column in drawn.reshape(-1, drawn.shape[-1]).T:
        assert len(np.unique(column)) == ROBOTS * (24 if which == "walls" else 4)


# Tallies


def happened(life, sensordata):
    """Returns where a robot was in contact, or had its nose within 6 cm of the spot's centre."""
    model = life.cohort.batch.model
    if life.task == "wall_avoidance":
        return sensordata[..., int(model.sensor("touch").adr[0])] > 0
    ahead = int(model.sensor("smell").adr[0])
    return np.hypot(sensordata[..., ahead], sensordata[..., ahead + 1]) < 0.06


def tally(events, stretches):
    """Returns the number of events in each stretch of steps, shape (robots, stretches)."""
    return np.stack([events[stretch].sum(axis=0) for stretch in stretches], axis=1)


def test_events_are_counted_after_each_step_in_the_stage_and_the_minute_they_happen_in(life):
    after = happened(life, life.step["sensordata"])
    minutes = [slice(start, start + MINUTE) for start in range(0, life.timeline.end, MINUTE)]
    lives = life.cohort.lives()
    np.testing.assert_array_equal(lives.events, tally(after, life.timeline.stages))
    np.testing.assert_array_equal(lives.minutes, tally(after, minutes))
    assert lives.valid.all()
    before = happened(life, life.act["sensordata"])  # another way of counting
    assert (tally(before, life.timeline.stages) != lives.events).any()
    assert len(np.unique(lives.events)) > ROBOTS


# Networks


def test_lives_hold_the_networks_at_birth_and_after_training_and_tests_change_none(life):
    lives, (newborn, untrained, trained) = life.cohort.lives(), life.networks
    np.testing.assert_equal([lives.before, lives.after], [newborn, trained])
    np.testing.assert_equal([untrained, life.weights()], [newborn, trained])
    assert newborn.keys() == trained.keys()
    for name in newborn:
        assert differ(newborn[name], trained[name]).all(), name


def without_effect(life):
    """Returns the steps of training that changed no network; all others changed every robot's."""
    changed, error = life.learn["changed"], life.learn["error"]
    idle = ~changed.any(axis=1)
    assert not error[idle].any() and error[~idle].all() and changed[~idle].all()
    return life.learn["at"][idle].tolist()


@pytest.mark.parametrize("proposer", ["fixed", "creative"])
def test_robots_learn_from_all_steps_but_those_into_a_placement_of_theirs(proposer, spots):
    changes = {"proposer": proposer, "time_scale": 0.002}
    life = Watched("wall_avoidance", **changes)
    assert without_effect(life) == [*range(24, 168, 6)]
    across = Watched("wall_avoidance", **changes, learn_across_placement=True)
    assert without_effect(across) == without_effect(spots) == []


# Weights that are not finite


def small_cohort(time_scale=0.01):
    experiment = Experiment(cohort_size=ROBOTS, time_scale=time_scale, body="kinematic")
    return Cohort(experiment, CohortKey(Condition("wall_avoidance", "fixed"), 0))


@pytest.mark.parametrize(
    ("time_scale", "broken_at", "noticed_at"),
    [(0.01, 100, MINUTE), (0.01, 700, 960), (0.004, 100, 384)],
)
def test_a_robot_with_a_weight_that_is_not_finite_is_stopped_at_the_end_of_a_minute_or_a_life(
    time_scale, broken_at, noticed_at
):
    cohort = small_cohort(time_scale)
    cohort.advance(broken_at)
    weights = cohort.agent.weights()["evaluation.output_weights"]
    weights[1] = np.nan
    cohort.advance(noticed_at - 1 - broken_at)
    assert cohort.valid.tolist() == [True, True, True]
    cohort.advance(1)
    assert cohort.step == noticed_at and cohort.valid.tolist() == [True, False, True]
    weights[1] = 0.0
    cohort.advance(10**9)
    assert cohort.lives().valid.tolist() == [True, False, True]


def test_a_weight_that_is_not_finite_at_birth_is_noticed_at_once(monkeypatch):
    healthy = small_cohort().agent
    healthy.weights()["evaluation.hidden_weights"][2] = np.inf
    monkeypatch.setattr("musebot.protocols.runs.cohort.make_agent", lambda *of: healthy)
    assert small_cohort().valid.tolist() == [True, True, False]


def test_an_agent_is_reset_before_its_first_step_and_when_robots_are_placed(monkeypatch):
    for life, expected in (("body", 1), ("spot_finding", 2)):
        experiment = Experiment(cohort_size=2, body="kinematic", time_scale=0.0005)
        cohort = Cohort(experiment, CohortKey(Condition(life, "creative"), 0))
        agent, steps = cohort.agent, []
        monkeypatch.setattr(agent, "reset", lambda own=cohort, steps=steps: steps.append(own.step))
        cohort.advance(10**9)
        assert steps[0] == 0 and len(steps) == expected


# Lives that change


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("life", [life.name for life in CHANGING])
def test_robots_of_a_changing_life_that_are_stopped_anywhere_continue_bit_exactly(life, body):
    experiment = Experiment(cohort_size=2, body=body, brain=BRAINS["steady"], time_scale=0.0003)
    legs = experiment.life_of(life).legs()
    change = next(leg.start for leg in legs if leg.changes_world)

    def born():
        return Cohort(experiment, CohortKey(Condition(life, "creative"), 0))

    whole = born()
    for leg in legs:
        whole.advance(leg.stop - leg.start)
        assert whole.step == leg.stop and whole.batch.world == leg.phase.world
    for stop in (change - 1, change, change + 1, legs[-1].stop - 1):
        first, second = born(), born()
        first.advance(stop)
        arrays, notes = copy.deepcopy(first.checkpoint())
        second.restore(arrays, notes)
        second.advance(10**9)
        np.testing.assert_equal(second.checkpoint(), whole.checkpoint(), err_msg=str(stop))
