"""The hand-coded robot finds the spot and stays in it."""

import numpy as np
import pytest

from musebot.protocols import cli
from musebot.protocols.agents.hand_coded import hand_coded
from musebot.protocols.experiment.experiment import Experiment
from musebot.tasks.starts import random_poses, random_spots


@pytest.mark.parametrize(
    ("smell", "motors"),
    [(0.0, [0.5, -0.5]), (1e-6, [0.5, 0.45]), (0.909, [0.5, 0.45]), (10 / 11, [0, 0])],
)
def test_it_turns_without_smell_drives_where_it_smells_and_stands_inside(smell, motors):
    agent = hand_coded(2, 1, seed=0)
    for learning in (False, True):
        chosen = agent.act(np.full((2, 1), smell, np.float32), learning)
        assert chosen.tolist() == [motors, motors]


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
def test_its_robots_find_every_spot_and_stay(body):
    experiment = Experiment(cohort_size=20, body=body)
    batch = experiment.batch("spot_finding", 20)
    random, everyone = np.random.default_rng(1), np.arange(20)
    batch.place_spot(everyone, random_spots(random, batch.dimensions, 20))
    batch.place(everyone, random_poses(random, batch.dimensions, 20))
    agent = hand_coded(20, 1, seed=0)
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
        batch.step(hand_coded(1, 1, seed=0).act(state, False))
    assert 0 < states[0] < 0.05
    assert states[-1] == np.float32(10 / 11)


def test_it_is_refused_where_there_are_other_signals_than_the_noses(
    tmp_path, capsys, commands_in_process
):
    out = tmp_path / "out"
    command = ["run", str(out), "--agent", "hand_coded", "--robots", "2"]
    assert cli.main(command) == 2
    sentence = "musebot: hand_coded needs one signal, that of spot_finding, got 5\n"
    assert capsys.readouterr().err == sentence
    assert not out.exists()
    short = ["--task", "spot_finding", "--time-scale", "0.002", "--body", "kinematic"]
    assert cli.main([*command, *short]) == 0
    assert "musebot.protocols.baselines:hand_coded" in capsys.readouterr().out


def test_it_has_no_state_and_no_weights():
    agent = hand_coded(2, 1, seed=0)
    assert agent.state() == agent.weights() == {}
    agent.load_state({})
