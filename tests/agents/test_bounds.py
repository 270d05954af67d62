"""The hand-coded robot finds the spot and stays in it."""

import numpy as np
import pytest

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.bounds import hand_coded, newborn
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.agents.senses import senses_of
from musebot.protocols.errors import InputError
from musebot.protocols.lives.cohort import make_agent
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.tasks.starts import random_poses, random_spots


def test_it_turns_without_smell_drives_where_it_smells_and_stands_inside():
    agent = hand_coded(4, senses_of("spot_finding"), 0)
    smell = np.array([[0.0], [1e-6], [0.909], [10 / 11]], np.float32)
    for learning in (False, True):
        chosen = agent.act(smell, learning).tolist()
        assert chosen == [[0.5, -0.5], [0.5, 0.45], [0.5, 0.45], [0, 0]]


def test_bounds_that_use_the_maximal_smell_need_a_nose_that_has_one():
    experiment = Experiment(cohort_size=2, body="kinematic", nose="printed")
    for name in ("hand_coded", "newborn"):
        with pytest.raises(InputError, match=f"{name} uses the maximal smell: .* 'inverse'"):
            make_agent(experiment, Condition("spot_finding", recorded_name(name)), 2, 0)
        make_agent(experiment, Condition("wall_avoidance", recorded_name(name)), 2, 0)


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
def test_its_robots_find_every_spot_and_stay(body):
    experiment = Experiment(cohort_size=20, body=body)
    batch = experiment.batch("spot_finding", 20)
    random, everyone = np.random.default_rng(1), np.arange(20)
    batch.place_spot(everyone, random_spots(random, batch.dimensions, 20))
    batch.place(everyone, random_poses(random, batch.dimensions, 20))
    agent = hand_coded(20, senses_of("spot_finding"), 0)
    inside = []
    for _ in range(600):
        batch.step(agent.act(batch.rules.state(batch.sensordata).astype(np.float32), False))
        inside.append(batch.rules.event(batch.sensordata))
    arrived = np.argmax(inside, axis=0)
    assert np.all(inside[-1])
    assert np.mean(arrived) < 150
    for robot, step in enumerate(arrived):
        assert np.mean(inside[step:], axis=0)[robot] > 0.95


def test_a_robot_that_smells_the_spot_beside_a_wall_does_not_stay_at_the_wall():
    batch = Experiment(body="kinematic").batch("spot_finding", 1)
    batch.place_spot(np.array([0]), np.array([[0.0342, 0.2449]]))
    batch.place(np.array([0]), np.array([[-0.2782, 0.3225, 2 * np.pi - 5.8071]]))
    states = []
    for _ in range(100):
        state = batch.rules.state(batch.sensordata).astype(np.float32)
        states.append(state[0, 0])
        batch.step(hand_coded(1, senses_of("spot_finding"), 0).act(state, False))
    assert 0 < states[0] < 0.05
    assert states[-1] == np.float32(10 / 11)


def test_it_is_refused_where_it_has_no_policy():
    with pytest.raises(InputError, match="the signal of a nose, or the five signals .* got 4"):
        hand_coded(2, Senses((Signal(0, 1),) * 4, Signal(0, 1)), 0)


def test_it_smells_with_walls_sensed_as_without():
    senses = senses_of("spot_finding_walls")
    (nose,) = [n for n, signal in enumerate(senses.state) if signal.maximal]
    state = np.zeros((2, 6), np.float32)
    state[1, nose] = 0.5
    chosen = hand_coded(2, senses, 0).act(state, False)
    assert chosen.tolist() == [[0.5, -0.5], [0.5, 0.45]]


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
def test_it_drives_about_without_touching_a_wall(body):
    batch = Experiment(cohort_size=20, body=body).batch("wall_avoidance", 20)
    random, everyone = np.random.default_rng(1), np.arange(20)
    batch.place(everyone, random_poses(random, batch.dimensions, 20))
    agent = hand_coded(20, senses_of("wall_avoidance"), 0)
    contact, ahead = 0, 0
    for _ in range(600):
        motors = agent.act(batch.rules.state(batch.sensordata).astype(np.float32), False)
        batch.step(motors)
        contact += batch.rules.event(batch.sensordata).mean()
        ahead += (motors.min(axis=1) > 0).mean()
    assert contact / 600 < 0.005
    assert ahead / 600 > 0.5


def test_a_newborn_neither_explores_nor_learns():
    agent, other = (newborn(3, senses_of("spot_finding"), 1) for _ in range(2))
    before = {name: weights.copy() for name, weights in agent.weights().items()}
    random = np.random.default_rng(0)
    for _ in range(50):
        state = random.uniform(size=(3, 1)).astype(np.float32)
        assert np.array_equal(agent.act(state, True), other.act(state, False))
        agent.learn(np.ones(3, np.float32))
    np.testing.assert_equal(agent.weights(), before)
