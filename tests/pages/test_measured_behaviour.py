"""Behaviour of a run's robots, measured from stored brains."""

from __future__ import annotations

import dataclasses

import numpy as np

from musebot.protocols.analysis.behaviour import Track
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.run import ConditionResults, Run
from musebot.protocols.pages import measured_behaviour


def test_all_conditions_are_observed_and_every_tick_is_announced(run):
    ticks = []
    behaviour = measured_behaviour.observe(run, lambda: ticks.append(1))
    assert [*behaviour.spinning] == run.conditions()
    for shares in behaviour.spinning.values():
        assert shares.shape == (3, 2)
        assert ((shares >= 0) & (shares <= 1)).all()
    assert len(ticks) == measured_behaviour.ticks(run) > 0


def test_tests_before_and_after_training_are_told_apart(run, monkeypatch):
    """Robot 1 spins after training only, robot 2 comes nearer to the centre before it only."""
    condition = Condition("wall_avoidance", "fixed")
    alone = dataclasses.replace(run, results={condition: run.results[condition]})

    def hand_made(given, what, which, minutes, tick):
        assert (given, what) == (alone, condition)
        assert which == [(row, when) for when in ("before", "after") for row in range(3)]
        poses = np.zeros((21, 6, 3))
        poses[:, :, 0] = 0.4
        poses[:, 3 + 1, 2] = 0.5 * np.arange(21)  # five radians a second
        poses[:, 2, 0] -= np.linspace(0, 0.1, 21)
        return Track(poses, np.zeros((20, 6), bool), np.zeros(2), np.zeros((20, 6, 2)))

    monkeypatch.setattr(measured_behaviour, "evaluate", hand_made)
    behaviour = measured_behaviour.observe(alone)
    np.testing.assert_array_equal(behaviour.spinning[condition], [[0, 0], [0, 1], [0, 0]])
    np.testing.assert_allclose(behaviour.nearer[condition], [[0, 0], [0, 0], [0.1, 0]], atol=1e-12)


def test_newborns_start_with_the_nose_at_the_rim_and_learn(run, monkeypatch):
    condition, seen = Condition("spot_finding", "creative"), []

    def spy(batch, agent, steps, *, learning, tick):
        seen.append((batch.pose, batch.spot, learning, agent.weights()))
        return Track(np.zeros((2, 2, 3)), np.zeros((1, 2), bool), np.zeros(2), np.ones((1, 2, 2)))

    monkeypatch.setattr(measured_behaviour, "watch", spy)
    _, radius = measured_behaviour.from_the_rim(run, condition, [2, 0], lambda: None)
    ((pose, spot, learning, weights),) = seen
    size = run.experiment.batch(condition.task, 1).dimensions
    ahead = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    nose = pose[:, :2] + size.nose * ahead
    assert radius == size.spot_radius == 0.06 and learning is True
    np.testing.assert_allclose(np.linalg.norm(nose - spot, axis=1), radius, atol=1e-9)
    for name, array in run.networks(condition, "before").items():
        np.testing.assert_array_equal(weights[name], array[[2, 0]])


def test_only_robots_that_found_the_spot_start_at_it_again(run):
    condition = Condition("spot_finding", "creative")
    part = run.results[condition]
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
    results = {condition: ConditionResults(four, curves, networks)}
    found = Run("run", scaled, results)
    assert measured_behaviour.finders(found, condition) == [0, 2]
    behaviour = measured_behaviour.observe(found)
    assert len(behaviour.stays["creative"].staying) == 2


def test_invalid_robots_are_not_observed(invalid):
    behaviour = measured_behaviour.observe(invalid)
    assert behaviour.spinning == {} and behaviour.stays == {}
    assert measured_behaviour.ticks(invalid) == 0


def test_sample_is_the_first_valid_robots(run, invalid):
    condition = Condition("wall_avoidance", "fixed")
    part = run.results[condition]
    robots = [invalid.results[condition].robots[0], *part.robots[1:]]
    some = Run("run", run.experiment, {condition: dataclasses.replace(part, robots=robots)})
    assert measured_behaviour.sample(some, condition, 60) == [1, 2]
    assert measured_behaviour.sample(some, condition, 1) == [1]


def test_agents_without_a_stored_brain_are_not_observed(run):
    agent = Condition("wall_avoidance", "package.module:factory")
    part = run.results[Condition("wall_avoidance", "fixed")]
    both = dataclasses.replace(run, results={**run.results, agent: part})
    assert measured_behaviour.with_brains(both) == run.conditions()
