"""Behaviour of a run's robots, measured from stored brains."""

from __future__ import annotations

import dataclasses

import numpy as np

from musebot.protocols.experiment.conditions import Condition
from musebot.protocols.playback import measured_behaviour
from musebot.protocols.results.results import ConditionResults
from musebot.protocols.results.run import Run


def test_all_conditions_are_observed_and_every_tick_is_announced(run):
    ticks = []
    behaviour = measured_behaviour.observe(run, lambda: ticks.append(1))
    assert [*behaviour.spinning] == run.conditions()
    for shares in behaviour.spinning.values():
        assert shares.shape == (3, 2)
        assert ((shares >= 0) & (shares <= 1)).all()
    assert len(ticks) == measured_behaviour.ticks(run) > 0


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
    curves[[0, 2], 1:5] = 0.5
    curves[1, [0, 5]] = 1.0
    results = {condition: ConditionResults(four, curves, networks)}
    behaviour = measured_behaviour.observe(Run("run", scaled, results))
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
