"""The hand-coded robot finds the spot and stays in it."""

import numpy as np
import pytest

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.hand_coded import hand_coded
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.agents.neurocontroller import newborn
from musebot.protocols.agents.signals import senses_of
from musebot.protocols.errors import InputError
from musebot.protocols.runs.cohort import make_agent
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.tasks.starts import random_poses, random_spots


@pytest.mark.parametrize("task", ["spot_finding", "spot_finding_walls"])
def test_it_turns_without_smell_drives_where_it_smells_and_stands_inside(task):
    senses = senses_of(task)
    (nose,) = [n for n, signal in enumerate(senses.state) if signal.maximal]
    state = np.zeros((4, len(senses.state)), np.float32)
    state[:, nose] = [0.0, 1e-6, 0.909, 10 / 11]
    for learning in (False, True):
        chosen = hand_coded(4, senses, 0).act(state, learning).tolist()
        assert chosen == [[0.5, -0.5], [0.5, 0.45], [0.5, 0.45], [0, 0]]


def test_bounds_that_use_the_maximal_smell_need_a_nose_that_has_one():
    experiment = Experiment(cohort_size=2, body="kinematic", nose="printed")
    for name in ("hand_coded", "newborn"):
        with pytest.raises(InputError, match=f"{name} uses the maximal smell: .* 'inverse'"):
            make_agent(experiment, Condition("spot_finding", recorded_name(name)), 2, 0)
        make_agent(experiment, Condition("wall_avoidance", recorded_name(name)), 2, 0)
    with pytest.raises(InputError, match="the signal of a nose, or the five signals .* got 4"):
        hand_coded(2, Senses((Signal(0, 1),) * 4, Signal(0, 1)), 0)


def driven(task, body):
    """Drives 20 robots for a minute; returns events (T, B) and motor values (T, B, 2)."""
    batch = Experiment(cohort_size=20, body=body).batch(task, 20)
    random, everyone = np.random.default_rng(1), np.arange(20)
    batch.place_spot(everyone, random_spots(random, batch.dimensions, 20))
    batch.place(everyone, random_poses(random, batch.dimensions, 20))
    agent, events, motors = hand_coded(20, senses_of(task), 0), [], []
    for _ in range(600):
        motors.append(agent.act(batch.rules.state(batch.sensordata).astype(np.float32), False))
        batch.step(motors[-1])
        events.append(batch.rules.event(batch.sensordata))
    return np.array(events), np.array(motors)


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
def test_its_robots_find_every_spot_and_stay_and_touch_no_wall_without_one(body):
    inside, _ = driven("spot_finding", body)
    arrived = np.argmax(inside, axis=0)
    assert np.all(inside[-1]) and np.mean(arrived) < 150
    assert all(inside[step:, robot].mean() > 0.95 for robot, step in enumerate(arrived))
    contact, motors = driven("wall_avoidance", body)
    assert contact.mean() < 0.005 and (motors.min(axis=2) > 0).mean() > 0.5


def test_a_newborn_neither_explores_nor_learns():
    agent, other = (newborn(3, senses_of("spot_finding"), 1) for _ in range(2))
    before = {name: weights.copy() for name, weights in agent.weights().items()}
    random = np.random.default_rng(0)
    for _ in range(50):
        state = random.uniform(size=(3, 1)).astype(np.float32)
        assert np.array_equal(agent.act(state, True), other.act(state, False))
        agent.learn(np.ones(3, np.float32))
    np.testing.assert_equal(agent.weights(), before)
