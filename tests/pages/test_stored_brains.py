"""Stored robots: their brains, and the tests that they repeat."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import Run, collect
from musebot.protocols.lives.schedules import UPPER_LEFT, UPPER_RIGHT
from musebot.protocols.pages.episode import Moment
from musebot.protocols.pages.stored_brains import StoredRobot, robots_named, stored_brains


def moments_of(robot: StoredRobot) -> list[Moment]:
    return list(robot.episode().moments())


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"task": "dancing"}, "the task must be one of"),
        ({"proposer": "muse"}, "the proposer must be one of"),
        (
            {"proposer": "random"},
            "the run has no robots of wall_avoidance/random; it has "
            r"wall_avoidance/fixed, wall_avoidance/creative: --proposer or --agent chooses",
        ),
        ({"proposer": "a.module:agent"}, "the run has no robots of wall_avoidance/a.module:agent"),
        ({"robot": 3}, "are 0 to 2, got 3"),
        ({"robot": -1}, "are 0 to 2, got -1"),
        ({"phase": "training"}, "the phase must be one of"),
        ({"seed": -1}, "the seed must lie in"),
    ],
)
def test_robot_that_does_not_exist_is_refused_in_one_sentence(stored, changes, sentence):
    with pytest.raises(InputError, match=sentence):
        stored(**changes).episode()


def test_invalid_robot_is_refused(stored, invalid):
    with pytest.raises(InputError, match="is invalid"):
        stored(run=invalid).episode()


@pytest.mark.parametrize(("phase", "when"), [("pre", "before"), ("post", "after")])
def test_brain_is_the_robots_own_from_before_or_after_training(run, stored, phase, when):
    brain = stored(task="spot_finding", robot=1, phase=phase).agent()
    networks = brain.controller.networks()
    whole = run.networks(Condition("spot_finding", "creative"), when)
    assert networks.keys() == whole.keys()
    for name, tensor in networks.items():
        np.testing.assert_array_equal(tensor.numpy(), whole[name][1:2])


def test_brain_beyond_the_paper_does_what_it_did_in_the_run(run):
    experiment = dataclasses.replace(run.experiment, brain=BRAINS["steady"])
    condition = Condition("spot_finding", "fixed")
    key = CohortKey(condition, 0)
    cohort = Cohort(experiment, key)
    cohort.advance(cohort.steps)
    other = Run("steady", experiment, collect(experiment, [(key, cohort.lives())]))
    again = stored_brains(other, condition, [(i, "after") for i in range(3)], 0)
    random = np.random.default_rng(0)
    for _ in range(20):
        nose = random.uniform(0, 10 / 11, (3, 1)).astype(np.float32)
        np.testing.assert_array_equal(again.act(nose, False), cohort.agent.act(nose, False))


def test_brain_of_another_shape_is_refused(run, stored):
    experiment = dataclasses.replace(run.experiment, brain=Parameters(memory_hidden=6))
    with pytest.raises(InputError, match="cannot take over the weights of .*must have shape"):
        stored(run=dataclasses.replace(run, experiment=experiment)).agent()


def test_episode_lasts_a_test_from_its_start(stored):
    moments = moments_of(stored(task="spot_finding", robot=1))
    times = [moment.time for moment in moments]
    np.testing.assert_allclose(times, 0.1 * np.arange(1 + round(3600 * 0.002 / 0.1)))
    np.testing.assert_allclose(moments[0].pose, UPPER_LEFT, atol=1e-12)
    assert (moments[0].event, moments[0].event_seconds) == (False, 0.0)
    for moment, after in zip(moments[:-1], moments[1:], strict=True):
        assert after.event_seconds - moment.event_seconds == pytest.approx(0.1 * after.event)


def test_spot_is_where_the_test_places_it(stored):
    for moment in moments_of(stored(task="spot_finding", robot=1, phase="pre")):
        np.testing.assert_array_equal(moment.spot, UPPER_RIGHT[:2])


def test_an_episode_neither_learns_nor_explores(stored, monkeypatch):
    brain, explored = stored(robot=1).agent(), []
    before = {name: tensor.clone() for name, tensor in brain.controller.networks().items()}
    act = brain.controller.act

    def watched(state, explore):
        explored.append(explore)
        return act(state, explore)

    monkeypatch.setattr(brain.controller, "act", watched)
    monkeypatch.setattr(StoredRobot, "agent", lambda self: brain)
    assert len(moments_of(stored(robot=1))) > 1
    assert explored and not any(explored)
    for name, tensor in brain.controller.networks().items():
        np.testing.assert_array_equal(tensor, before[name])


def path(robot: StoredRobot) -> np.ndarray:
    return np.array([[*moment.pose, *moment.motors] for moment in moments_of(robot)])


def test_same_seed_gives_the_same_episode_and_another_seed_another(stored):
    np.testing.assert_array_equal(path(stored(robot=1)), path(stored(robot=1)))
    assert not np.array_equal(path(stored(robot=1)), path(stored(robot=1, seed=1)))


def test_fixed_proposer_has_no_noise_that_depends_on_the_seed(stored):
    first, second = (path(stored(robot=1, proposer="fixed", seed=seed)) for seed in (0, 1))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("signals", ["paper", "raw"])
@pytest.mark.parametrize("name", ["stream_ac", "sarsa_lambda", "hand_coded"])
def test_a_learner_does_what_it_did_in_the_run(name, signals):
    experiment = Experiment(
        cohort_size=2, time_scale=0.002, body="kinematic", signals=signals, seed=3
    )
    condition = robots_named("spot_finding", None, name)
    cohort = Cohort(experiment, CohortKey(condition, 0))
    cohort.advance(cohort.steps)
    run = Run("own", experiment, collect(experiment, [(CohortKey(condition, 0), cohort.lives())]))
    again = StoredRobot(run, condition, 1, "post").act()
    cohort.agent.reset()
    random = np.random.default_rng(0)
    for _ in range(20):
        nose = random.uniform(0, 10 / 11, (2, 1)).astype(np.float32)
        expected = cohort.agent.act(nose, False)[1:]
        np.testing.assert_allclose(again(nose[1:]), expected, rtol=0, atol=1e-6)
    assert StoredRobot(run, condition, 0, "pre").episode().driver == f"{name}, robot 0"


@pytest.mark.parametrize("name", ["radius", "wheel_base"])
def test_a_robot_of_other_dimensions_is_not_filmed_as_the_ordinary_one(name):
    kinematics = Kinematics(**{name: 0.05})
    experiment = Experiment(
        cohort_size=1, time_scale=0.001, body="kinematic", kinematics=kinematics, seed=3
    )
    condition = Condition("spot_finding", "creative")
    cohort = Cohort(experiment, CohortKey(condition, 0))
    cohort.advance(cohort.steps)
    run = Run("own", experiment, collect(experiment, [(CohortKey(condition, 0), cohort.lives())]))
    with pytest.raises(
        InputError, match=f"films draw the ordinary robot; this run has {name}=0.05"
    ):
        StoredRobot(run, condition, 0, "post").episode()


def test_an_agent_that_cannot_take_over_weights_is_named(run):
    condition = Condition("spot_finding", robots_named("spot_finding", None, "q_learner").proposer)
    weights = {"other": np.zeros((3, 2, 2), np.float32)}
    part = dataclasses.replace(
        run.results[Condition("spot_finding", "creative")],
        networks={"before": weights, "after": weights},
    )
    other = Run("own", run.experiment, {condition: part})
    with pytest.raises(
        InputError, match="q_learner cannot take over the weights of own: .* is missing"
    ):
        StoredRobot(other, condition, 0, "post").act()
    with pytest.raises(InputError, match="a proposer or an agent, not both"):
        robots_named("spot_finding", "fixed", "ppo")
