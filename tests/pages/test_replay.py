"""Stored brains and policies in robots: single episodes, and batches."""

import dataclasses
import itertools
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import random_policy

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.pages import replay
from musebot.protocols.pages.replay import (
    Episode,
    Moment,
    Relived,
    StoredRobot,
    robots_named,
)
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.run import Run, results_of
from musebot.tasks import make_batch
from musebot.tasks.lives import STAGES, UPPER_LEFT, UPPER_RIGHT, Life, Phase
from musebot.tasks.suite import TASKS
from musebot.tasks.world import World


def lived(experiment, condition):
    """Returns a run of one cohort, and the cohort at the end of its life."""
    cohort = Cohort(experiment, CohortKey(condition, 0))
    cohort.advance(cohort.steps)
    return Run("own", experiment, results_of(experiment, {condition: cohort.lives()})), cohort


# ---- Policies ----


@pytest.mark.parametrize(
    ("task", "phase"), list(zip(TASKS, itertools.cycle(["pre", "post"]), strict=False))
)
def test_episode_is_the_one_that_gymnasium_starts_with_the_same_seed(task, phase):
    gymnasium_env = pytest.importorskip("musebot.tasks.gymnasium_env")
    policy = random_policy(task)
    steps = 2 * (TASKS[task].spot_steps or 15) + 5
    episode = Episode.of_policy(policy, phase, seed=3)
    moments = list(itertools.islice(episode.moments(), steps))
    robots = gymnasium_env.ArenaVectorEnv(task, 1)
    state, _ = robots.reset(seed=3)
    for moment in moments:
        sensed = np.concatenate([*moment.signals.values()])
        np.testing.assert_allclose(sensed, state[0], rtol=1e-6)
        np.testing.assert_array_equal(moment.pose, robots._batch.pose[0])
        np.testing.assert_array_equal(moment.spot, robots._batch.spot[0])
        motors = policy.act(state, phase == "post")
        np.testing.assert_array_equal(moment.motors, motors[0])
        state, *_ = robots.step(motors * 2 * TASKS[task].limit)
    spots = len(np.unique([moment.spot for moment in moments], axis=0))
    assert spots == (3 if TASKS[task].spot_steps else 1)
    assert episode.when == ("after training" if phase == "post" else "before training")


def test_episode_lasts_as_long_as_that_of_the_task_or_as_its_simulation_is_stable():
    episode = Episode.of_policy(random_policy("spot_finding_unit"), "post", 0)
    times = [moment.time for moment in episode.moments()]
    np.testing.assert_allclose(times, 0.1 * np.arange(1001))
    episode.batch.stop(np.array([0]))
    assert len([*episode.moments()]) == 1
    assert Episode.of_policy(random_policy("spot_finding"), "post", 0).seconds == float("inf")


def test_the_time_with_the_event_adds_up():
    batch = make_batch("wall_avoidance", 1)
    batch.place(np.array([0]), np.array([[0.49, 0.0, 0.0]]))  # close to a wall
    act, random = (lambda _: np.full((1, 2), 0.1)), np.random.default_rng(0)
    words = "wall_avoidance", "nobody", "after training", "in contact"
    moments = [*Episode(*words, batch, act, 9, random).moments()]
    events = [moment.event for moment in moments]
    assert events == [moment.contact for moment in moments] and sum(events) > 1
    seconds = [moment.event_seconds for moment in moments]
    np.testing.assert_allclose(seconds, 0.1 * np.cumsum(events))


def test_a_moment_holds_the_angle_of_the_nose_in_its_world():
    batch = make_batch("spot_finding", 1)
    assert Moment.of(batch, 0, 0, event=False, events=0).nose == 0
    batch.rules = World(nose=90.0).rules(batch.rules, batch.dimensions.nose)
    assert Moment.of(batch, 0, 0, event=False, events=0).nose == pytest.approx(np.pi / 2)


# ---- Robots of a run ----


@pytest.mark.parametrize("start", [0, 57])  # control steps
def test_a_relived_robot_does_what_it_did_in_its_life(run, start):
    condition = Condition("wall_avoidance", "creative")
    relived = Relived.at(run, condition, 1, start / 600)
    assert relived.when == f"minute {start / 600:g}"
    moments = [*relived.moments()]
    assert len(moments) == relived.cohort.steps - start + 1
    assert moments[-1].time == pytest.approx((relived.cohort.steps - start) / 10)
    for one in moments:  # none keeps the arrays of the whole cohort
        assert one.pose.base is one.spot.base is one.motors.base is None
    corner = relived.batch.dimensions.half_length - moments[0].pose[0]
    assert start or corner > 0.5  # the first moment is after the placement
    lived = run.results[condition].networks["after"]
    for name, weights in relived.cohort.agent.weights().items():
        np.testing.assert_array_equal(weights, lived[name])
    assert start or round(moments[-1].event_seconds * 10) == relived.cohort.lives().events[1].sum()
    for minute in (1.0, float("nan"), float("inf"), -0.1):
        with pytest.raises(InputError, match="the life has minutes from 0 to"):
            Relived.at(run, condition, 1, minute)


def test_a_life_that_differs_from_its_run_is_reported(capsys):
    experiment = Experiment(cohort_size=3, body="kinematic", time_scale=0.0075)
    run, _ = lived(experiment, condition := Condition("wall_avoidance", "fixed"))
    Relived.at(run, condition, 1, 1.1)
    assert not capsys.readouterr().err
    run.results[condition].curves[1, 0] += 1
    for robot, minute, differs in ((0, 1, False), (1, 0.9, False), (1, 1, True)):
        Relived.at(run, condition, robot, minute)
        assert ("robot 1 lives otherwise than in the run" in capsys.readouterr().err) == differs


def test_a_life_can_be_filmed_from_every_minute_before_its_end(run):
    condition = Condition("wall_avoidance", "creative")
    last = len([*Relived.at(run, condition, 1, 0).moments()]) - 1  # control steps
    for step in (0.4, last - 1, last - 0.6, last - 0.4, np.nextafter(last, 0)):
        moments = [*Relived.at(run, condition, 1, step / 600).moments()]
        assert len(moments) == last - min(round(step), last - 1) + 1


def test_robot_that_does_not_exist_is_refused_in_one_sentence(stored, invalid):
    hint = "it has wall_avoidance/fixed, .*: --proposer or --agent chooses"
    for changes, sentence in (
        ({"task": "dancing"}, f"the run has no robots of dancing/creative; {hint}"),
        ({"proposer": "muse"}, "the proposer must be one of"),
        ({"proposer": "random"}, f"the run has no robots of wall_avoidance/random; {hint}"),
        ({"robot": 3}, "are 0 to 2, got 3"),
        ({"robot": -1}, "are 0 to 2, got -1"),
        ({"phase": "training"}, "there is no phase 'training'; there are pre, post"),
        ({"seed": -1}, "the seed must lie in"),
        ({"run": invalid}, "is invalid"),
    ):
        with pytest.raises(InputError, match=sentence):
            stored(**changes).episode()


def test_episode_is_a_test_from_its_start(stored):
    moments = list(stored(task="spot_finding", robot=1, phase="pre").episode().moments())
    times = [moment.time for moment in moments]
    np.testing.assert_allclose(times, 0.1 * np.arange(1 + round(3600 * 0.002 / 0.1)))
    np.testing.assert_allclose(moments[0].pose, UPPER_LEFT, atol=1e-12)
    assert (moments[0].event, moments[0].event_seconds) == (False, 0.0)
    assert all((moment.spot == UPPER_RIGHT[:2]).all() for moment in moments)


def test_an_episode_ends_where_the_test_places_the_robot_again():
    phases = tuple(Phase(stage, 0.03, False, every_minutes=0.01) for stage in STAGES)
    life = Life("mine", "Mine", "wall_avoidance", phases, wanted=False)
    experiment = Experiment(cohort_size=1, body="kinematic", life=life)
    run, _ = lived(experiment, condition := Condition("mine", "fixed"))
    assert StoredRobot(run, condition, 0, "post").episode().seconds == pytest.approx(0.6)


def test_the_seed_decides_a_brains_noise_only(run, stored):
    """A brain with fixed ideas that explored would act by chance, too."""
    experiment = dataclasses.replace(run.experiment, brain=Parameters(epsilon=1.0))
    run = dataclasses.replace(run, experiment=experiment)

    def driven(proposer, seed):
        episode = stored(run=run, robot=1, proposer=proposer, seed=seed).episode()
        return [[*moment.pose, *moment.motors] for moment in episode.moments()]

    assert driven("creative", 0) == driven("creative", 0) != driven("creative", 1)
    assert driven("fixed", 0) == driven("fixed", 1)


@pytest.mark.parametrize(
    ("name", "signals"), [(None, "paper"), ("stream_ac", "raw"), ("hand_coded", "raw")]
)
def test_a_stored_robot_does_what_it_did_in_the_run(name, signals):
    experiment = Experiment(
        cohort_size=2, time_scale=0.002, body="kinematic", signals=signals, seed=3
    )
    condition = robots_named("spot_finding", None if name else "fixed", name)
    if name is None:
        experiment = dataclasses.replace(experiment, brain=BRAINS["steady"])
    run, cohort = lived(experiment, condition)
    robot = StoredRobot(run, condition, 1, "post")
    again, random = robot.act(), np.random.default_rng(0)
    cohort.agent.reset()
    for _ in range(20):
        nose = random.uniform(0, 10 / 11, (2, 1)).astype(np.float32)
        expected = cohort.agent.act(nose, False)[1:]
        np.testing.assert_allclose(again(nose[1:]), expected, rtol=0, atol=1e-6)
    assert robot.episode().driver == f"{name or 'fixed proposer'}, robot 1"


def test_films_name_the_event_of_the_life():
    worlds = World(), World(rewarded="driving")
    for task, world, event in (
        ("wall_avoidance", worlds[0], "in contact"),
        ("spot_or_driving", worlds[0], "in the spot"),
        ("spot_or_driving", worlds[1], "at the goal"),
    ):
        phases = tuple(Phase(stage, 0.01, False, world=world) for stage in STAGES)
        life = Life("mine", "Mine", task, phases, wanted=task != "wall_avoidance")
        experiment = Experiment(cohort_size=1, body="kinematic", life=life)
        run, _ = lived(experiment, condition := Condition("mine", "fixed"))
        robot = StoredRobot(run, condition, 0, "post")
        assert robot.episode().event == Relived.at(run, condition, 0, 0.0).event == event


def test_a_robot_of_other_dimensions_is_not_filmed_as_the_ordinary_one(run, stored):
    for name in ("radius", "wheel_base"):
        kinematics = Kinematics(**{name: 0.05})
        experiment = dataclasses.replace(run.experiment, body="kinematic", kinematics=kinematics)
        with pytest.raises(InputError, match=f"films draw the ordinary robot; .* {name}=0.05"):
            stored(run=dataclasses.replace(run, experiment=experiment)).episode()


def test_an_agent_that_cannot_take_over_weights_is_named(run):
    condition = robots_named("spot_finding", None, "q_learner")
    brains = run.results[Condition("spot_finding", "creative")]
    other = dataclasses.replace(run, results={condition: brains})
    with pytest.raises(InputError, match="q_learner cannot take over .* of run: .* is missing"):
        StoredRobot(other, condition, 0, "post").act()
    with pytest.raises(InputError, match="a proposer or an agent, not both"):
        robots_named("spot_finding", "fixed", "avg")


# ---- Batches ----


def test_batch_of_brains_does_what_each_brain_does_alone(run):
    # The fixed proposer has no noise, so that every brain's path is bit-exact.
    condition = Condition("wall_avoidance", "fixed")
    rows = [(0, "before", "pre"), (2, "after", "post"), (1, "before", "pre")]
    track = replay.evaluate(run, condition, [(row, when) for row, when, _ in rows], 99.0)
    assert len(track.events) == 12  # of the first of two phases
    for index, (row, _, phase) in enumerate(rows):
        alone = StoredRobot(run, condition, row, phase).episode().moments()
        moments = [*itertools.islice(alone, 13)]
        poses = np.array([moment.pose for moment in moments], dtype=np.float32)
        np.testing.assert_array_equal(track.poses[:, index], poses)
        events = [moment.event for moment in moments[1:]]
        np.testing.assert_array_equal(track.events[:, index], events)


@pytest.mark.parametrize("learning", [True, False])
def test_a_track_records_poses_events_and_the_spot_in_the_frame_of_the_nose(learning):
    batch, both = make_batch("spot_finding", 2), np.arange(2)
    agent = Mock(act=Mock(return_value=np.full((2, 2), 0.1)))
    batch.place_spot(both, np.array([[0.3, 0.2], [0.3, 0.2]]))
    batch.place(both, np.array([[0.1, -0.1, 0.5], [0.26, 0.2, 0.0]]))  # the second in the spot
    track = replay.watch(batch, agent, 3, learning=learning)
    assert [call.args[1] for call in agent.act.mock_calls] == [learning] * 3
    assert agent.learn.call_count == 3 * learning
    assert track.events.tolist() == [[False, True]] * 3
    np.testing.assert_array_equal(track.spots, [[0.3, 0.2]] * len(track.spots))
    np.testing.assert_allclose(track.poses[0], [[0.1, -0.1, 0.5], [0.26, 0.2, 0.0]], atol=1e-6)
    np.testing.assert_allclose(track.poses[-1], batch.pose, atol=1e-6)
    for (x, y, heading), found in zip(track.poses[-1].astype(float), track.nose[-1], strict=True):
        ahead = np.array([np.cos(heading), np.sin(heading)])
        away = np.array([0.3, 0.2]) - [x, y] - batch.dimensions.nose * ahead
        expected = [away @ ahead, away @ [-ahead[1], ahead[0]]]
        np.testing.assert_allclose(found, expected, atol=5e-4)  # sensed a substep before
