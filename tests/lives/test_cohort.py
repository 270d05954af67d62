"""A cohort follows its schedule: its placements, when it learns, and how events are counted."""

import dataclasses
import itertools
import types

import numpy as np
import pytest
from helpers import LAZY_AGENT

from musebot.models import Dimensions
from musebot.protocols.agents import trust
from musebot.protocols.agents.names import RECORDED_NAMES
from musebot.protocols.errors import InputError
from musebot.protocols.lives.agent import make_agent
from musebot.protocols.lives.cohort import Cohort, check_agents, check_same_weights
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import WHEN, ConditionResults, collect
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
    def parts(self):
        return range(self.training.start), self.training, range(self.training.stop, self.end)


TIMELINES = {
    # A hundredth of 10 + 10 minutes, 24 times 5 minutes, 10 + 10 minutes.
    "wall_avoidance": Timeline(
        time_scale=0.01,
        training=range(120, 840),
        end=960,
        robot_placed=(0, 60, *range(120, 840, 30), 840, 900),
        spot_placed=(),
    ),
    # A two-hundredth of 1 hour, 4 times 1 hour, 1 hour.
    "spot_finding": Timeline(
        time_scale=0.005,
        training=range(180, 900),
        end=1080,
        robot_placed=(0, 900),
        spot_placed=(0, 180, 360, 540, 720, 900),
    ),
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


@dataclasses.dataclass
class Moment:
    """What brain and batch did in a control step."""

    explore: bool
    state: np.ndarray  # what `act` was given
    motors: np.ndarray  # what it returned
    sensordata: np.ndarray  # then
    physics: np.ndarray  # MuJoCo's state then
    pose: np.ndarray
    spot: np.ndarray
    rewards: list = dataclasses.field(default_factory=list)  # what `learn` was given
    errors: list = dataclasses.field(default_factory=list)  # what it returned
    changed: list = dataclasses.field(default_factory=list)  # whose networks it changed
    driven: list = dataclasses.field(default_factory=list)  # what `step` was given
    next_sensordata: np.ndarray | None = None  # after it
    next_physics: np.ndarray | None = None


class Watched:
    """A cohort recorded from birth to its last test; `drive` replaces what its brain chose."""

    def __init__(self, task, drive=None, proposer="creative", stride=50, **changes):
        self.task, self.timeline = task, TIMELINES[task]
        settings = {"cohort_size": ROBOTS, "time_scale": self.timeline.time_scale} | changes
        self.cohort = Cohort(Experiment(**settings), CohortKey(Condition(task, proposer), 0))
        self.moments = []
        self.newborn, self.before_training, self.after_training = self.networks(), None, None
        self._drive = drive
        agent, batch = self.cohort.agent, self.cohort.batch
        brain = agent.controller  # its `learn` returns the TD error
        self._act, self._learn, self._step = agent.act, brain.learn, batch.step
        agent.act, brain.learn, batch.step = self.act, self.learn, self.step
        while not self.cohort.finished:
            self.cohort.advance(stride)

    def networks(self):
        return {k: v.copy() for k, v in self.cohort.agent.weights().items()}

    def act(self, state, explore):
        if len(self.moments) == self.timeline.training.start:
            self.before_training = self.networks()
        if len(self.moments) == self.timeline.training.stop:
            self.after_training = self.networks()
        motors = self._act(state, explore)
        if self._drive is not None:
            motors = self._drive(len(self.moments), state)
        batch = self.cohort.batch
        self.moments.append(
            Moment(
                explore=explore,
                state=state.copy(),
                motors=motors.copy(),
                sensordata=batch.sensordata.copy(),
                physics=batch.arrays()["state"].copy(),
                pose=batch.pose,
                spot=batch.spot,
            )
        )
        return motors

    def learn(self, reward):
        before = self.networks()
        error = self._learn(reward)
        after = self.networks()
        now = self.moments[-1]
        now.rewards.append(reward.numpy().copy())
        now.errors.append(error.numpy().copy())
        now.changed.append(np.any([differ(before[k], after[k]) for k in before], axis=0))
        return error

    def step(self, motors):
        self._step(motors)
        now = self.moments[-1]
        now.driven.append(motors.copy())
        now.next_sensordata = self.cohort.batch.sensordata.copy()
        now.next_physics = self.cohort.batch.arrays()["state"].copy()

    def steps_where(self, holds):
        """Returns the control steps in which a property holds."""
        return [step for step, moment in enumerate(self.moments) if holds(moment)]

    def steps_before_which(self, differs):
        """Returns the control steps that differ from the one before by a property."""
        pairs = enumerate(itertools.pairwise(self.moments), start=1)
        return [step for step, (old, new) in pairs if differs(old, new)]


def differ(one, other):
    """Returns which robots' numbers differ."""
    return (one != other).reshape(len(one), -1).any(axis=1)


def happened(life, sensordata):
    """Returns where a robot was in contact, or had its nose within 6 cm of the spot's centre.

    `sensordata` has shape (steps, robots, nsensordata); the result has shape (steps, robots).
    """
    model = life.cohort.batch.model
    if life.task == "wall_avoidance":
        return sensordata[..., int(model.sensor("touch").adr[0])] > 0
    ahead = int(model.sensor("smell").adr[0])
    return np.hypot(sensordata[..., ahead], sensordata[..., ahead + 1]) < 0.06


def tally(events, stretches):
    """Returns the number of events in each stretch of steps, shape (robots, stretches)."""
    return np.stack([events[stretch].sum(axis=0) for stretch in stretches], axis=1)


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


def test_every_control_step_acts_once_and_drives_the_chosen_motors(life):
    assert len(life.moments) == life.timeline.end == life.cohort.steps == life.cohort.step
    assert all(len(moment.driven) == 1 for moment in life.moments)
    assert all(np.array_equal(moment.driven[0], moment.motors) for moment in life.moments)


def test_robots_explore_in_every_step_of_training_and_in_no_other(life):
    assert life.steps_where(lambda moment: moment.explore) == list(life.timeline.training)


def test_robots_learn_once_in_every_step_of_training_and_in_no_other(life):
    assert life.steps_where(lambda moment: moment.rewards) == list(life.timeline.training)
    assert all(len(moment.rewards) <= 1 for moment in life.moments)


def test_robots_act_on_what_they_sense_now(life):
    rules = life.cohort.batch.rules
    for moment in life.moments:
        expected = rules.state(moment.sensordata).astype(np.float32)
        np.testing.assert_array_equal(moment.state, expected)


def test_robots_learn_from_the_reward_observed_with_the_state_just_acted_on(life):
    # In both tasks the reward is the state's last number: the contact, or the nose.
    learning = [life.moments[step] for step in life.timeline.training]
    given = np.array([moment.rewards[0] for moment in learning])
    np.testing.assert_array_equal(given, [moment.state[:, -1] for moment in learning])
    assert all(len(set(of_one)) > 1 for of_one in given.T)


# Placements


def test_robots_are_placed_when_the_schedule_says_and_otherwise_continue_from_where_they_are(life):
    jumps = life.steps_before_which(lambda old, new: differ(old.next_physics, new.physics).any())
    assert [0, *jumps] == list(life.timeline.robot_placed)
    everyone = life.steps_before_which(lambda old, new: differ(old.next_physics, new.physics).all())
    assert everyone == jumps


def test_spots_are_moved_when_the_schedule_says_and_otherwise_stay(life):
    moves = life.steps_before_which(lambda old, new: differ(old.spot, new.spot).any())
    assert moves == list(life.timeline.spot_placed[1:])
    everyone = life.steps_before_which(lambda old, new: differ(old.spot, new.spot).all())
    assert everyone == moves


def test_sensor_data_are_continuous_between_placements(life):
    fresh = life.steps_before_which(
        lambda old, new: differ(old.next_sensordata, new.sensordata).any()
    )
    assert fresh == list(life.timeline.robot_placed[1:])


def check_fixed(life, step, robot, spot=None):
    """Checks that before a step all robots are at rest at a place, with a spot, and sense both."""
    batch = make_batch(life.task, ROBOTS)
    if spot is not None:
        batch.place_spot(np.arange(ROBOTS), np.tile(spot, (ROBOTS, 1)))
    batch.place(np.arange(ROBOTS), np.tile(robot, (ROBOTS, 1)))
    moment = life.moments[step]
    np.testing.assert_array_equal(moment.physics, batch.arrays()["state"])
    np.testing.assert_array_equal(moment.sensordata, batch.sensordata)
    np.testing.assert_array_equal(moment.spot, batch.spot)
    np.testing.assert_allclose(moment.pose, np.tile(robot, (ROBOTS, 1)), atol=1e-12)


def test_tests_of_wall_avoidance_start_in_the_upper_left_and_then_in_the_upper_right(walls):
    for step, corner in ((0, UPPER_LEFT), (60, UPPER_RIGHT), (840, UPPER_LEFT), (900, UPPER_RIGHT)):
        check_fixed(walls, step, corner)


def test_tests_of_spot_finding_start_in_the_upper_left_with_the_spot_in_the_upper_right(spots):
    for step in (0, 900):
        check_fixed(spots, step, UPPER_LEFT, UPPER_RIGHT[:2])


def test_the_test_after_training_starts_as_the_one_before(life):
    pre, _, post = life.timeline.parts
    for field in ("pose", "spot", "physics", "sensordata", "state"):
        before, after = (getattr(life.moments[part.start], field) for part in (pre, post))
        np.testing.assert_array_equal(before, after)


def check_random(drawn, bound):
    """Checks numbers of shape (placements, robots, n): within the bound, distinct, spread out."""
    numbers = drawn.reshape(-1, drawn.shape[-1])
    assert (np.abs(numbers) <= bound).all()
    assert all(len(np.unique(column)) == len(numbers) for column in numbers.T)
    assert (np.ptp(numbers, axis=0) > bound).all()  # half of what is possible


def test_training_places_robots_of_wall_avoidance_24_times_at_random(walls):
    arena = Dimensions.of(walls.cohort.batch.model)
    steps = [step for step in walls.timeline.robot_placed if step in walls.timeline.training]
    assert len(steps) == 24
    clear = [arena.half_length - arena.radius, arena.half_width - arena.radius, np.pi]
    check_random(np.array([walls.moments[step].pose for step in steps]), np.array(clear))
    at_rest = make_batch("wall_avoidance", ROBOTS)
    for moment in (walls.moments[step] for step in steps):
        at_rest.place(np.arange(ROBOTS), moment.pose)
        np.testing.assert_allclose(moment.physics, at_rest.arrays()["state"], atol=1e-12)


def test_training_moves_the_spot_4_times_at_random_and_never_the_robot(spots):
    arena = Dimensions.of(spots.cohort.batch.model)
    steps = [step for step in spots.timeline.spot_placed if step in spots.timeline.training]
    assert len(steps) == 4
    clear = [arena.half_length - arena.spot_radius, arena.half_width - arena.spot_radius]
    check_random(np.array([spots.moments[step].spot for step in steps]), np.array(clear))
    assert not set(spots.timeline.robot_placed) & set(spots.timeline.training)


# Tallies


def test_events_are_counted_after_each_step_in_the_part_and_the_minute_they_happen_in(life):
    after = happened(life, np.array([moment.next_sensordata for moment in life.moments]))
    minutes = [slice(start, start + MINUTE) for start in range(0, life.timeline.end, MINUTE)]
    lives = life.cohort.lives()
    np.testing.assert_array_equal(lives.events, tally(after, life.timeline.parts))
    np.testing.assert_array_equal(lives.minutes, tally(after, minutes))
    assert lives.valid.all()

    # No other way of counting gives the same numbers.
    pre, training, post = lives.events.T
    assert lives.events.any(axis=0).all()  # at least one robot, in every part
    assert ((pre != training) & (training != post) & (post != pre)).all()
    assert len(np.unique(lives.events, axis=0)) == ROBOTS
    before = happened(life, np.array([moment.sensordata for moment in life.moments]))
    assert (tally(before, life.timeline.parts) != lives.events).any()
    assert lives.minutes.shape == (ROBOTS, 2)


def test_an_event_that_never_ends_fills_every_part_and_every_minute():
    timeline = TIMELINES["wall_avoidance"]
    experiment = Experiment(cohort_size=2, time_scale=timeline.time_scale)
    cohort = Cohort(experiment, CohortKey(Condition("wall_avoidance", "fixed"), 0))
    rules = cohort.batch.rules
    cohort.batch.rules = types.SimpleNamespace(
        state=rules.state, reward=rules.reward, event=lambda sensordata: np.array([True, False])
    )
    cohort.advance(10**9)
    lives = cohort.lives()
    assert lives.events.tolist() == [[len(part) for part in timeline.parts], [0, 0, 0]]
    assert lives.minutes.tolist() == [[MINUTE, timeline.end - MINUTE], [0, 0]]


# Networks


def test_lives_hold_the_networks_at_birth_and_those_at_the_end_of_training(life):
    lives = life.cohort.lives()
    np.testing.assert_equal(lives.before, life.newborn)
    np.testing.assert_equal(lives.after, life.after_training)
    assert lives.before.keys() == lives.after.keys()
    for name, newborn in lives.before.items():
        assert differ(newborn, lives.after[name]).all(), name


def test_tests_change_no_network(life):
    np.testing.assert_equal(life.before_training, life.newborn)
    np.testing.assert_equal(life.networks(), life.after_training)


# Learning across a placement


def without_effect(life):
    """Returns the steps of training that changed no network; all others changed every robot's."""
    learning = {step: life.moments[step] for step in life.steps_where(lambda m: m.changed)}
    assert learning
    idle = [step for step, moment in learning.items() if not moment.changed[0].any()]
    assert all(not learning[step].errors[0].any() for step in idle)
    others = [moment for step, moment in learning.items() if step not in idle]
    assert all(moment.errors[0].all() and moment.changed[0].all() for moment in others)
    return idle


@pytest.mark.parametrize("proposer", ["fixed", "creative"])
def test_the_step_into_a_placement_changes_no_network(proposer):
    life = Watched("wall_avoidance", proposer=proposer, time_scale=0.002)
    assert without_effect(life) == list(range(24, 168, 6))


@pytest.mark.parametrize("proposer", ["fixed", "creative"])
def test_the_step_into_a_placement_is_learned_from_where_the_experiment_says_so(proposer):
    life = Watched(
        "wall_avoidance", proposer=proposer, time_scale=0.002, learn_across_placement=True
    )
    assert len(life.steps_where(lambda moment: moment.changed)) == 144
    assert without_effect(life) == []


def test_robots_learn_from_the_step_in_which_the_spot_moves(spots):
    assert without_effect(spots) == []


def test_a_robot_with_a_weight_that_is_not_finite_is_invalid_and_the_others_are_not():
    cohort = Cohort(
        Experiment(cohort_size=ROBOTS, time_scale=0.01),
        CohortKey(Condition("wall_avoidance", "fixed"), 0),
    )
    cohort.advance(100)
    cohort.agent.weights()["evaluation.output_weights"][1] = np.nan
    cohort.advance(10**9)
    assert cohort.lives().valid.tolist() == [True, False, True]


def test_weights_are_looked_at_when_a_minute_ends_and_not_before():
    cohort = Cohort(
        Experiment(cohort_size=ROBOTS, time_scale=0.01, body="kinematic"),
        CohortKey(Condition("wall_avoidance", "fixed"), 0),
    )
    cohort.advance(100)
    cohort.agent.weights()["evaluation.output_weights"][1] = np.nan
    cohort.advance(MINUTE - 101)
    assert cohort.batch.valid.tolist() == [True, True, True]
    cohort.advance(1)
    assert cohort.step == MINUTE
    assert cohort.batch.valid.tolist() == [True, False, True]


def test_a_weight_that_is_not_finite_at_the_end_of_a_short_life_is_noticed():
    cohort = Cohort(
        Experiment(cohort_size=ROBOTS, time_scale=0.004),
        CohortKey(Condition("wall_avoidance", "fixed"), 0),
    )
    assert cohort.steps < MINUTE
    cohort.advance(100)
    cohort.agent.weights()["evaluation.output_weights"][1] = np.nan
    cohort.advance(10**9)
    assert cohort.lives().valid.tolist() == [True, False, True]


def test_a_weight_that_is_not_finite_at_birth_is_noticed_at_once(monkeypatch):
    experiment = Experiment(cohort_size=ROBOTS, time_scale=0.004, body="kinematic")
    key = CohortKey(Condition("wall_avoidance", "fixed"), 0)

    def broken(*which):
        agent = make_agent(*which)
        agent.weights()["evaluation.hidden_weights"][2] = np.inf
        return agent

    monkeypatch.setattr("musebot.protocols.lives.cohort.make_agent", broken)
    cohort = Cohort(experiment, key)
    assert cohort.batch.valid.tolist() == [True, True, False]
    cohort.advance(10**9)
    results = collect(experiment, [(key, cohort.lives())])
    assert [row.valid for row in results[key.condition].robots] == [True, True, False]


# Agents of users


def test_an_agent_with_the_wrong_motor_values_is_refused(tmp_path, monkeypatch):
    (tmp_path / "one_for_all.py").write_text(LAZY_AGENT)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(trust, "_TRUSTED", {"one_for_all:Lazy"})
    condition = Condition("wall_avoidance", "one_for_all:Lazy")
    plan = Plan.of(Experiment(cohort_size=2), [condition], 2)
    with pytest.raises(InputError) as caught:
        check_agents(plan)
    sentence = "one_for_all:Lazy must return motor values of shape (2, 2), got (1, 2)"
    assert str(caught.value) == sentence


def test_conditions_of_the_papers_proposers_need_no_check_of_agents(monkeypatch):
    monkeypatch.setattr("musebot.protocols.lives.cohort.make_agent", pytest.fail)
    check_agents(Plan.of(Experiment(cohort_size=10), [Condition("spot_finding", "fixed")], 10))


def test_robots_that_keep_other_weights_than_those_of_the_run_are_not_added():
    condition = Condition("spot_finding", RECORDED_NAMES["q_learner"])
    plan = Plan.of(Experiment(cohort_size=2), [condition], 4)
    held = {
        condition: ConditionResults([], np.empty((0, 0)), {w: {"old": np.empty(0)} for w in WHEN})
    }
    with pytest.raises(InputError, match="keeps other weights than the robots of the run.*: .*old"):
        check_agents(plan, held)
    check_agents(plan, {})
    own = {"table": np.zeros((3, 4), np.float32)}
    check_same_weights(condition, own, {"table": np.ones((9, 4), np.float32)})
    for other in (np.zeros((3, 4)), np.zeros((3, 5), np.float32)):
        with pytest.raises(InputError, match="which another version simulated: table"):
            check_same_weights(condition, own, {"table": other})


@pytest.mark.parametrize("step", [-1, 961, 10**9, True, 5.0, "5", None])
def test_a_checkpoint_of_a_step_outside_the_life_is_refused(step):
    experiment = Experiment(cohort_size=2, time_scale=0.01, body="kinematic")
    cohort = Cohort(experiment, CohortKey(Condition("wall_avoidance", "fixed"), 0))
    assert cohort.steps == 960
    arrays, notes = cohort.checkpoint()
    with pytest.raises(ValueError, match=r"step must be a whole number in \[0, 960\], got"):
        cohort.restore(arrays, {**notes, "step": step})
    cohort.restore(arrays, {**notes, "step": 960})
    assert cohort.finished
    cohort.restore(arrays, notes)
    assert cohort.step == notes["step"] == 0


def test_an_agent_that_refuses_its_state_is_a_value_error(monkeypatch):
    experiment = Experiment(body="kinematic", cohort_size=ROBOTS, time_scale=0.001)
    cohort = Cohort(experiment, CohortKey(Condition("wall_avoidance", "fixed"), 0))

    def refuse(state):
        raise RuntimeError("a state of another agent")

    monkeypatch.setattr(cohort.agent, "load_state", refuse)
    with pytest.raises(ValueError, match="its agent does not continue .*a state of another agent"):
        cohort.restore(*cohort.checkpoint())
