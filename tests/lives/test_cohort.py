"""A cohort follows its schedule: its placements, when it learns, and how events are counted."""

import dataclasses

import numpy as np
import pytest

from musebot.models import Dimensions
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import BODIES, Experiment
from musebot.protocols.lives.schedules import UPPER_LEFT, UPPER_RIGHT
from musebot.tasks import make_batch

ROBOTS = 3
MINUTE = 600  # control steps


@dataclasses.dataclass(frozen=True)
class Timeline:
    """What happens in a life by sections 3.1 and 3.2, in control steps computed by hand."""

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
    """A life recorded from birth to the last test; `drive` replaces what the brain chose.

    `act`, `learn` and `step` hold what happened in each call, by name, as arrays whose first axis
    counts the calls; `at` the control step in which each was.
    """

    def __init__(self, task, drive=None, proposer="creative", **changes):
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
            motors = act(state, explore)
            if drive is not None:
                motors = drive(len(calls["act"]), state)
            calls["act"].append(
                dict(
                    explore=explore, state=state.copy(), motors=motors.copy(), pose=batch.pose,
                    sensordata=batch.sensordata.copy(), physics=batch.arrays()["state"].copy(),
                    spot=batch.spot, at=len(calls["act"]),
                )
            )  # fmt: skip
            return motors

        def watched_learn(reward):
            before = self.weights()
            error = learn(reward)
            after = self.weights()
            changed = np.any([differ(before[k], after[k]) for k in before], axis=0)
            calls["learn"].append(
                dict(
                    reward=reward.numpy().copy(), error=error.numpy().copy(), changed=changed,
                    at=len(calls["act"]) - 1,
                )
            )  # fmt: skip
            return error

        def watched_step(motors):
            step(motors)
            calls["step"].append(
                dict(
                    motors=motors.copy(), sensordata=batch.sensordata.copy(),
                    physics=batch.arrays()["state"].copy(), at=len(calls["act"]) - 1,
                )
            )  # fmt: skip

        agent.act, brain.learn, batch.step = watched_act, watched_learn, watched_step
        self.cohort.advance(10**9)
        for name, made in calls.items():
            setattr(self, name, {k: np.array([call[k] for call in made]) for k in made[0]})

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
    steps, training = [*range(life.timeline.end)], [*life.timeline.training]
    assert life.act["at"].tolist() == life.step["at"].tolist() == steps
    assert life.cohort.step == life.cohort.steps == len(steps)
    np.testing.assert_array_equal(life.step["motors"], life.act["motors"])
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
    fresh = differ(act["sensordata"][1:], step["sensordata"][:-1])
    assert (np.flatnonzero(fresh) + 1).tolist() == [*life.timeline.robot_placed[1:]]


TESTS = {
    "walls": {0: UPPER_LEFT, 60: UPPER_RIGHT, 840: UPPER_LEFT, 900: UPPER_RIGHT},
    "spots": {0: UPPER_LEFT, 900: UPPER_LEFT},
}


@pytest.mark.parametrize("which", TESTS)
def test_tests_start_at_rest_in_the_papers_places(which, request):
    life = request.getfixturevalue(which)
    for step, robot in TESTS[which].items():
        batch = make_batch(life.task, ROBOTS)
        if which == "spots":
            batch.place_spot(np.arange(ROBOTS), np.tile(UPPER_RIGHT[:2], (ROBOTS, 1)))
        batch.place(np.arange(ROBOTS), np.tile(robot, (ROBOTS, 1)))
        np.testing.assert_array_equal(life.act["physics"][step], batch.arrays()["state"])
        np.testing.assert_array_equal(life.act["sensordata"][step], batch.sensordata)
        np.testing.assert_array_equal(life.act["spot"][step], batch.spot)
        np.testing.assert_allclose(life.act["pose"][step], np.tile(robot, (ROBOTS, 1)), atol=1e-12)


@pytest.mark.parametrize(("which", "what", "times"), [("walls", "pose", 24), ("spots", "spot", 4)])
def test_training_places_robots_or_spots_at_random(which, what, times, request):
    life = request.getfixturevalue(which)
    arena = Dimensions.of(life.cohort.batch.model)
    placed = life.timeline.robot_placed if what == "pose" else life.timeline.spot_placed
    steps = [step for step in placed if step in life.timeline.training]
    drawn = life.act[what][steps]
    radius = arena.radius if what == "pose" else arena.spot_radius
    bound = np.array([arena.half_length - radius, arena.half_width - radius, np.pi])
    bound = bound[: drawn.shape[-1]]
    numbers = drawn.reshape(-1, drawn.shape[-1])
    assert len(steps) == times and (np.abs(numbers) <= bound).all()
    assert all(len(np.unique(column)) == len(numbers) for column in numbers.T)
    assert (np.ptp(numbers, axis=0) > bound).all()  # half of what is possible
    if what == "pose":
        at_rest = make_batch(life.task, ROBOTS)
        for pose, physics in zip(drawn, life.act["physics"][steps], strict=True):
            at_rest.place(np.arange(ROBOTS), pose)
            np.testing.assert_allclose(physics, at_rest.arrays()["state"], atol=1e-12)


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

    # No other way of counting gives the same numbers.
    pre, training, post = lives.events.T
    assert lives.events.any(axis=0).all()  # at least one robot, in every stage
    assert ((pre != training) & (training != post) & (post != pre)).all()
    assert len(np.unique(lives.events, axis=0)) == ROBOTS
    before = happened(life, life.act["sensordata"])
    assert (tally(before, life.timeline.stages) != lives.events).any()


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
def test_the_step_into_a_placement_of_the_robot_changes_no_network(proposer):
    changes = {"proposer": proposer, "time_scale": 0.002}
    life = Watched("wall_avoidance", **changes)
    assert without_effect(life) == [*range(24, 168, 6)]
    across = Watched("wall_avoidance", **changes, learn_across_placement=True)
    assert without_effect(across) == []


def test_robots_learn_from_the_step_in_which_the_spot_moves(spots):
    assert without_effect(spots) == []


# Weights that are not finite


def small_cohort(time_scale=0.01, proposer="fixed"):
    experiment = Experiment(cohort_size=ROBOTS, time_scale=time_scale, body="kinematic")
    return Cohort(experiment, CohortKey(Condition("wall_avoidance", proposer), 0))


def test_a_robot_with_a_weight_that_is_not_finite_is_stopped_at_the_end_of_a_minute_or_a_life():
    for time_scale, broken_at, noticed_at in (
        (0.01, 100, MINUTE), (0.01, 700, 960), (0.004, 100, 384)
    ):  # fmt: skip
        cohort = small_cohort(time_scale)
        cohort.advance(broken_at)
        cohort.agent.weights()["evaluation.output_weights"][1] = np.nan
        cohort.advance(noticed_at - 1 - broken_at)
        assert cohort.valid.tolist() == [True, True, True]
        cohort.advance(1)
        assert cohort.step == noticed_at and cohort.valid.tolist() == [True, False, True]
        cohort.agent.weights()["evaluation.output_weights"][1] = 0.0
        assert cohort.unsound().tolist() == [False, True, False]  # it is remembered
        cohort.advance(10**9)
        assert cohort.lives().valid.tolist() == [True, False, True]


def test_a_weight_that_is_not_finite_at_birth_is_noticed_at_once(monkeypatch):
    healthy = small_cohort().agent
    healthy.weights()["evaluation.hidden_weights"][2] = np.inf
    monkeypatch.setattr("musebot.protocols.lives.cohort.make_agent", lambda *of: healthy)
    assert small_cohort().valid.tolist() == [True, True, False]


# Walls


@pytest.mark.parametrize("body", BODIES)
def test_robots_of_the_walls_protocol_sense_walls_and_their_brains_have_the_inputs(body):
    experiment = Experiment(cohort_size=2, body=body, protocol="walls")
    cohort = Cohort(experiment, CohortKey(Condition("spot_finding", "fixed"), 0))
    cohort.batch.place(np.arange(2), np.array([[0.4, 0, 0], [-0.4, 0.1, 1]]))
    state = cohort.batch.rules.state(cohort.batch.sensordata)
    nose, distances, contact = np.split(state, [1, 5], axis=1)
    assert (nose == 0).all() and (distances > 0).any(axis=1).all() and (contact == 0).all()
    assert cohort.decide(False).shape == (2, 2)
