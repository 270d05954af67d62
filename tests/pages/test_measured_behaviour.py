"""Behaviour of a run's robots, measured from stored brains."""

import dataclasses

import numpy as np
import pytest

from musebot.controller import Parameters
from musebot.protocols.analysis.behaviour import spins
from musebot.protocols.pages import measured_behaviour
from musebot.protocols.pages.replay import evaluate
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.run import ConditionResults, Run

WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")


def test_valid_robots_with_a_brain_are_observed_before_and_after_training(run):
    part = run.results[WALLS]
    robots = [dataclasses.replace(part.robots[0], category="invalid"), *part.robots[1:]]
    results = {
        **run.results,
        WALLS: dataclasses.replace(part, robots=robots),
        Condition("wall_avoidance", "package.module:factory"): part,
    }
    run = dataclasses.replace(run, results=results)
    behaviour = measured_behaviour.observe(run)
    assert [*behaviour.spinning] == [*behaviour.nearer] == run.conditions()[:3]
    # Brains with fixed ideas have no noise: each robot does the same alone.
    minutes = measured_behaviour.SPIN_MINUTES
    for column, when in enumerate(("before", "after")):
        for place, row in enumerate((1, 2)):
            track = evaluate(run, WALLS, [(row, when)], minutes)
            share = spins(track.poses).mean()
            assert behaviour.spinning[WALLS][place, column] == share
            away = np.linalg.norm(track.poses[[0, -1], 0, :2], axis=-1)
            assert behaviour.nearer[WALLS][place, column] == pytest.approx(away[0] - away[1])


def test_without_valid_robots_nothing_is_observed(invalid):
    assert measured_behaviour.observe(invalid) == measured_behaviour.Behaviour({}, {}, {})


def test_newborns_start_with_the_nose_at_the_rim_and_learn(run):
    track, radius = measured_behaviour.from_the_rim(run, SPOT, [2, 0])
    size = run.experiment.batch(SPOT.life, 1).dimensions
    poses = track.poses[0].astype(float)
    ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    nose = poses[:, :2] + size.nose * ahead
    assert radius == size.spot_radius == 0.06
    np.testing.assert_allclose(np.linalg.norm(nose - track.spots, axis=1), radius, atol=1e-6)
    np.testing.assert_allclose(np.arctan2(*-nose.T[::-1]), poses[:, 2], atol=1e-5)  # face the spot
    assert len(track.events) == round(600 * measured_behaviour.STAY_MINUTES * 0.002)
    slow = dataclasses.replace(run.experiment, brain=Parameters(learn_rate=1e-9))
    other, _ = measured_behaviour.from_the_rim(
        dataclasses.replace(run, experiment=slow), SPOT, [2, 0]
    )
    assert (other.poses[0] == track.poses[0]).all() and (other.poses != track.poses).any()


def test_only_robots_that_found_the_spot_in_training_start_at_it_again(run):
    part = run.results[SPOT]
    four = [dataclasses.replace(part.robots[0], robot=i, category="L < 0") for i in range(4)]
    networks = {
        when: {name: np.concatenate([array, array[:1]]) for name, array in arrays.items()}
        for when, arrays in part.networks.items()
    }
    scaled = dataclasses.replace(run.experiment, time_scale=1 / 60)  # minutes 1 to 4 are training
    curves = np.zeros((4, 6))
    curves[[0, 2], 1:5] = [[0.11], [0.1]]
    curves[1, [0, 5]] = 1.0  # in the tests only
    curves[3, 1:5] = 0.09
    found = Run("run", scaled, {SPOT: ConditionResults(four, curves, networks)})
    assert measured_behaviour.finders(found, SPOT) == [0, 2]
    assert len(measured_behaviour.observe(found).stays["creative"].staying) == 2
