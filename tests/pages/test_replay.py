"""Stored brains and policies in robots: single episodes, and batches."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import Run, results_of
from musebot.protocols.lives.schedules import UPPER_LEFT, UPPER_RIGHT
from musebot.protocols.pages import replay
from musebot.protocols.pages.replay import Episode, StoredRobot, robots_named
from musebot.tasks import make_batch
from musebot.tasks.suite import TASKS

# ---- Policies ----


@pytest.mark.parametrize(
    ("task", "phase"), list(zip(TASKS, itertools.cycle(["pre", "post"]), strict=False))
)
def test_episode_is_the_one_that_gymnasium_starts_with_the_same_seed(newborn, task, phase):
    gymnasium_env = pytest.importorskip("musebot.tasks.gymnasium_env")
    policies = newborn(task)
    steps = 2 * (TASKS[task].spot_steps or 15) + 5
    episode = Episode.of_policy(policies, 1, phase, seed=3)
    moments = list(itertools.islice(episode.moments(), steps))
    robots = gymnasium_env.ArenaVectorEnv(task, 1)
    state, _ = robots.reset(seed=3)
    for moment in moments:
        sensed = np.concatenate([*moment.signals.values()])
        np.testing.assert_allclose(sensed, state[0], rtol=1e-6)
        np.testing.assert_array_equal(moment.pose, robots._batch.pose[0])
        np.testing.assert_array_equal(moment.spot, robots._batch.spot[0])
        motors = policies.one(1).act(state, phase == "post")
        np.testing.assert_array_equal(moment.motors, motors[0])
        state, *_ = robots.step(motors * 2 * TASKS[task].limit)
    spots = len(np.unique([moment.spot for moment in moments], axis=0))
    assert spots == (3 if TASKS[task].spot_steps else 1)
    assert episode.trained == (phase == "post")


def test_episode_lasts_as_long_as_that_of_the_task(newborn):
    episode = Episode.of_policy(newborn("spot_finding_unit"), 0, "post", 0)
    times = [moment.time for moment in episode.moments()]
    np.testing.assert_allclose(times, 0.1 * np.arange(1001))
    assert Episode.of_policy(newborn("spot_finding"), 0, "post", 0).seconds == float("inf")


def test_the_time_with_the_event_adds_up():
    batch, alone = make_batch("wall_avoidance", 1), np.array([0])
    batch.place(alone, np.array([[0.49, 0.0, 0.0]]))  # close to a wall
    random = np.random.default_rng(0)
    driver = ("wall_avoidance", "nobody", True, batch, lambda _: np.full((1, 2), 0.1), 9, random)
    moments = [*Episode(*driver).moments()]
    events = [moment.event for moment in moments]
    assert events == [moment.contact for moment in moments] and sum(events) > 1
    seconds = [moment.event_seconds for moment in moments]
    np.testing.assert_allclose(seconds, 0.1 * np.cumsum(events))


# ---- Robots of a run ----


def test_robot_that_does_not_exist_is_refused_in_one_sentence(stored, invalid):
    for changes, sentence in (
        ({"task": "dancing"}, "the task must be one of"),
        ({"proposer": "muse"}, "the proposer must be one of"),
        (
            {"proposer": "random"},
            "the run has no robots of wall_avoidance/random; it has wall_avoidance/fixed, .*: "
            "--proposer or --agent chooses",
        ),
        ({"robot": 3}, "are 0 to 2, got 3"),
        ({"robot": -1}, "are 0 to 2, got -1"),
        ({"phase": "training"}, "the phase must be one of pre, post, got 'training'"),
        ({"seed": -1}, "the seed must lie in"),
        ({"run": invalid}, "is invalid"),
    ):
        with pytest.raises(InputError, match=sentence):
            stored(**changes).episode()


def test_brain_of_another_shape_is_refused(run, stored):
    experiment = dataclasses.replace(run.experiment, brain=Parameters(memory_hidden=6))
    with pytest.raises(InputError, match="cannot take over the weights of .*must have shape"):
        stored(run=dataclasses.replace(run, experiment=experiment)).agent()


def test_brain_is_the_robots_own_and_does_not_learn(run, stored):
    for phase, when in (("pre", "before"), ("post", "after")):
        robot = stored(task="spot_finding", robot=1, phase=phase)
        own = {name: array[1:2] for name, array in run.networks(robot.condition, when).items()}
        act = robot.act()
        for _ in range(20):
            assert act(np.float32([[0.3]])).shape == (1, 2)
        found = act.func.__self__.controller.networks()
        np.testing.assert_equal({name: tensor.numpy() for name, tensor in found.items()}, own)


def test_episode_is_a_test_from_its_start(stored):
    moments = list(stored(task="spot_finding", robot=1, phase="pre").episode().moments())
    times = [moment.time for moment in moments]
    np.testing.assert_allclose(times, 0.1 * np.arange(1 + round(3600 * 0.002 / 0.1)))
    np.testing.assert_allclose(moments[0].pose, UPPER_LEFT, atol=1e-12)
    assert (moments[0].event, moments[0].event_seconds) == (False, 0.0)
    for moment, after in itertools.pairwise(moments):
        np.testing.assert_array_equal(moment.spot, UPPER_RIGHT[:2])
        assert after.event_seconds - moment.event_seconds == pytest.approx(0.1 * after.event)


@pytest.mark.parametrize(("proposer", "differs"), [("creative", True), ("fixed", False)])
def test_the_seed_decides_a_brains_noise_only(run, stored, proposer, differs):
    """A brain with fixed ideas that explored would act by chance, too."""
    experiment = dataclasses.replace(run.experiment, brain=Parameters(epsilon=1.0))
    run = dataclasses.replace(run, experiment=experiment)
    first, again, other = (
        [
            [*moment.pose, *moment.motors]
            for moment in stored(run=run, robot=1, proposer=proposer, seed=seed).episode().moments()
        ]
        for seed in (0, 0, 1)
    )
    assert first == again and (first != other) == differs


def lived(experiment, condition):
    """Returns a cohort at the end of its lives, and the run of it."""
    cohort = Cohort(experiment, CohortKey(condition, 0))
    cohort.advance(cohort.steps)
    results = results_of(experiment, {condition: cohort.lives()})
    return cohort, Run("own", experiment, results)


@pytest.mark.parametrize(
    ("name", "signals"),
    [("steady", "paper"), ("stream_ac", "raw"), ("hand_coded", "raw")],
)
def test_a_stored_robot_does_what_it_did_in_the_run(name, signals):
    experiment = Experiment(
        cohort_size=2, time_scale=0.002, body="kinematic", signals=signals, seed=3
    )
    condition = Condition("spot_finding", "fixed")
    if name == "steady":
        experiment = dataclasses.replace(experiment, brain=BRAINS["steady"])
    else:
        condition = robots_named("spot_finding", None, name)
    cohort, run = lived(experiment, condition)
    robot = StoredRobot(run, condition, 1, "post")
    again, random = robot.act(), np.random.default_rng(0)
    cohort.agent.reset()
    for _ in range(20):
        nose = random.uniform(0, 10 / 11, (2, 1)).astype(np.float32)
        expected = cohort.agent.act(nose, False)[1:]
        np.testing.assert_allclose(again(nose[1:]), expected, rtol=0, atol=1e-6)
    kind = "fixed proposer" if name == "steady" else name
    assert robot.episode().driver == f"{kind}, robot 1"


def test_a_robot_of_other_dimensions_is_not_filmed_as_the_ordinary_one(run, stored):
    for name in ("radius", "wheel_base"):
        kinematics = Kinematics(**{name: 0.05})
        experiment = dataclasses.replace(run.experiment, body="kinematic", kinematics=kinematics)
        with pytest.raises(InputError, match=f"films draw the ordinary robot; .* {name}=0.05"):
            stored(run=dataclasses.replace(run, experiment=experiment)).episode()


def test_an_agent_that_cannot_take_over_weights_is_named(run):
    condition = robots_named("spot_finding", None, "q_learner")
    weights = {"other": np.zeros((3, 2, 2), np.float32)}
    part = dataclasses.replace(
        run.results[Condition("spot_finding", "creative")],
        networks={"before": weights, "after": weights},
    )
    other = Run("own", run.experiment, {condition: part})
    with pytest.raises(InputError, match="q_learner cannot take over .* of own: .* is missing"):
        StoredRobot(other, condition, 0, "post").act()
    with pytest.raises(InputError, match="a proposer or an agent, not both"):
        robots_named("spot_finding", "fixed", "ppo")


# ---- Batches ----


def test_batch_of_brains_does_what_each_brain_does_alone(run):
    # The fixed proposer has no noise, so that every brain's path is bit-exact.
    condition = Condition("wall_avoidance", "fixed")
    rows = [(0, "before"), (2, "after"), (1, "before")]
    track = replay.evaluate(run, condition, rows, 0.02)
    for index, (row, when) in enumerate(rows):
        phase = {"before": "pre", "after": "post"}[when]
        moments = [
            *itertools.islice(StoredRobot(run, condition, row, phase).episode().moments(), 13)
        ]
        poses = np.array([moment.pose for moment in moments], dtype=np.float32)
        np.testing.assert_array_equal(track.poses[:, index], poses)
        events = [moment.event for moment in moments[1:]]
        np.testing.assert_array_equal(track.events[:, index], events)


class Recorder:
    """An agent that drives straight on and records its calls."""

    def __init__(self):
        self.calls = []

    def act(self, state, learning):
        self.calls.append(("act", learning))
        return np.full((len(state), 2), 0.1)

    def learn(self, reward):
        self.calls.append(("learn", reward.dtype))


@pytest.mark.parametrize("learning", [True, False])
def test_a_track_records_poses_events_and_the_spot_in_the_frame_of_the_nose(learning):
    agent, batch, both = Recorder(), make_batch("spot_finding", 2), np.arange(2)
    batch.place_spot(both, np.array([[0.3, 0.2], [0.3, 0.2]]))
    batch.place(both, np.array([[0.1, -0.1, 0.5], [0.26, 0.2, 0.0]]))  # the second in the spot
    track = replay.watch(batch, agent, 3, learning=learning)
    assert agent.calls == [("act", learning), *[("learn", np.float32)] * learning] * 3
    assert track.events.tolist() == [[False, True]] * 3
    np.testing.assert_array_equal(track.spot, [0.3, 0.2])
    np.testing.assert_allclose(track.poses[0], [[0.1, -0.1, 0.5], [0.26, 0.2, 0.0]], atol=1e-6)
    np.testing.assert_allclose(track.poses[-1], batch.pose, atol=1e-6)
    for (x, y, heading), found in zip(track.poses[-1].astype(float), track.nose[-1], strict=True):
        ahead = np.array([np.cos(heading), np.sin(heading)])
        away = np.array([0.3, 0.2]) - [x, y] - batch.dimensions.nose * ahead
        expected = [away @ ahead, away @ [-ahead[1], ahead[0]]]
        np.testing.assert_allclose(found, expected, atol=5e-4)  # sensed a substep before
