"""Any agent lives through the protocols, survives checkpoints, and stands in the tables."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from musebot.protocols import cli
from musebot.protocols.agents.base import Agent, make_agent
from musebot.protocols.agents.q_learning import QLearner, hand_coded
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.experiment import CohortKey, Experiment, check_agent
from musebot.protocols.simulation.cohort import Cohort
from musebot.tasks.starts import random_poses, random_spots

Q_LEARNER = "musebot.protocols.baselines:q_learner"
HAND_CODED = "musebot.protocols.baselines:hand_coded"
GUIDE = Path(__file__).parents[2] / "docs" / "agents.md"


def test_the_guides_example_lives_and_stands_in_the_tables(tmp_path):
    [code] = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    [shell] = re.findall(r"```sh\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    (tmp_path / "my_agent.py").write_text(code)
    for line in shell.strip().splitlines():
        words = line.replace("musebot", f"{sys.executable} -m musebot", 1).split()
        words = [{"20": "4"}.get(word, word) for word in words]  # four robots, to be quick
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "my_agent:table" in done.stdout
        assert "The claims of section 4" in done.stdout  # for creative robots live beside it
    rows = (tmp_path / "runs/mine/robots.csv").read_text().splitlines()
    assert sum(",my_agent:table," in row for row in rows) == 8  # four robots, two tasks


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_an_agents_life_goes_on_from_a_checkpoint_to_the_bit(task):
    experiment = Experiment(cohort_size=3, time_scale=0.005, body="kinematic")
    whole, first, second = (Cohort(experiment, CohortKey(task, Q_LEARNER, 0)) for _ in range(3))
    whole.advance(10**9)
    first.advance(whole.steps // 2)
    second.restore(*first.checkpoint())
    second.advance(10**9)
    assert np.array_equal(whole.lives().minutes, second.lives().minutes)
    for name, weights in whole.lives().after.items():
        assert np.array_equal(weights, second.lives().after[name])


def test_a_q_learners_step_is_watkins_update_by_autograd():
    agent = QLearner(4, 2, seed=3)
    random = np.random.default_rng(0)
    states = random.normal(size=(3, 4, 2)).astype(np.float32)
    reward = random.normal(size=4).astype(np.float32)
    agent.reset()
    agent.act(states[0], True)
    agent.act(states[1], True)
    before = {k: torch.from_numpy(v.copy()).requires_grad_() for k, v in agent.weights().items()}

    def values(state):
        sums = torch.einsum("bhi,bi->bh", before["hidden_weights"], torch.from_numpy(state))
        hidden = (sums + before["hidden_biases"]).sigmoid()
        return (
            torch.einsum("boh,bh->bo", before["output_weights"], hidden) + before["output_biases"]
        )

    chosen = agent._chosen_before
    value = values(states[0])[torch.arange(4), chosen]
    best = values(states[1]).amax(dim=1).detach()
    (0.5 * (torch.from_numpy(reward) + 0.9 * best - value) ** 2).sum().backward()
    agent.learn(reward)
    for name, weights in agent.weights().items():
        assert before[name].grad.abs().max() > 0
        wanted = before[name] - QLearner.LEARN_RATE * before[name].grad
        assert torch.from_numpy(weights) == pytest.approx(wanted.detach(), abs=1e-6)


def test_a_q_learner_does_not_learn_across_a_placement():
    agent = QLearner(2, 1, seed=0)
    agent.reset()
    agent.act(np.ones((2, 1), np.float32), True)
    agent.act(np.zeros((2, 1), np.float32), True)
    agent.reset()
    agent.act(np.ones((2, 1), np.float32), True)
    before = {name: weights.copy() for name, weights in agent.weights().items()}
    agent.learn(np.ones(2, np.float32))
    assert all(np.array_equal(before[name], w) for name, w in agent.weights().items())
    agent.act(np.zeros((2, 1), np.float32), True)
    agent.learn(np.ones(2, np.float32))
    assert not all(np.array_equal(before[name], w) for name, w in agent.weights().items())


def test_a_q_learner_learns_which_action_pays():
    agent = QLearner(20, 1, seed=1)
    state = np.ones((20, 1), np.float32)
    agent.reset()
    motors = agent.act(state, True)
    for _ in range(3000):
        paid = motors.sum(axis=1).astype(np.float32)  # straight on, at full speed
        motors = agent.act(state, True)
        agent.learn(paid)
    assert agent.act(state, False).mean() > 0.4


@pytest.mark.parametrize(
    ("smell", "motors"),
    [(0.0, [0.5, -0.5]), (1e-6, [0.5, 0.45]), (0.909, [0.5, 0.45]), (10 / 11, [0, 0])],
)
def test_a_hand_coded_robot_turns_without_smell_goes_where_it_smells_and_stands_inside(
    smell, motors
):
    agent = hand_coded(2, 1, seed=0)
    for learning in (False, True):
        chosen = agent.act(np.full((2, 1), smell, np.float32), learning)
        assert chosen.tolist() == [motors, motors]


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
def test_hand_coded_robots_find_every_spot_and_stay(body):
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


def test_a_hand_coded_robot_that_smells_the_spot_aside_at_a_wall_is_not_held_there():
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


def test_a_hand_coded_robot_is_refused_where_there_is_more_than_the_nose(tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["run", str(out), "--agent", HAND_CODED, "--robots", "2"]) == 2
    sentence = "musebot: hand_coded knows one signal, that of spot_finding, got 5\n"
    assert capsys.readouterr().err == sentence
    assert not out.exists()
    short = ["--task", "spot_finding", "--time-scale", "0.002", "--body", "kinematic"]
    assert cli.main(["run", str(out), "--agent", HAND_CODED, "--robots", "2", *short]) == 0
    assert HAND_CODED in capsys.readouterr().out


@pytest.mark.parametrize("name", ["nonsense", "a.b", "a:b:c", "a b:c", ":x", "x:", "1a:b"])
def test_a_name_that_is_no_factorys_is_refused(name):
    with pytest.raises(InputError, match="must be one of fixed, random, creative, or an agent's"):
        check_agent(name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_module:x", "there is no agent no_such_module:x"),
        ("musebot.protocols.baselines:no_such", "there is no agent musebot.protocols.baselines:no"),
        ("builtins:max", "must return an Agent, got int"),
        ("math:pi", "math:pi is no factory of agents, but a float"),
    ],
)
def test_a_factory_that_is_not_there_or_makes_no_agent_is_refused(name, words):
    with pytest.raises(InputError, match=words):
        make_agent(Experiment(), "wall_avoidance", name, 1, 0)


def test_a_module_that_cannot_be_imported_is_told_with_what_is_wrong(tmp_path, monkeypatch):
    (tmp_path / "half_written.py").write_text("def make(:")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match="half_written cannot be imported .SyntaxError"):
        make_agent(Experiment(), "wall_avoidance", "half_written:make", 1, 0)


def test_an_agent_with_the_wrong_motors_is_refused_before_anything_is_made(tmp_path, monkeypatch):
    (tmp_path / "one_for_all.py").write_text(
        "import numpy as np\n"
        "from musebot.protocols.agents.q_learning import QLearner\n"
        "class Lazy(QLearner):\n"
        "    def act(self, state, learning):\n"
        "        return np.zeros((1, 2))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    out = tmp_path / "out"
    assert cli.main(["run", str(out), "--proposer", "one_for_all:Lazy", "--robots", "2"]) == 2
    assert not out.exists()


def test_the_guides_example_goes_on_from_a_checkpoint_to_the_bit(tmp_path, monkeypatch):
    [code] = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    (tmp_path / "guide_agent.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    experiment = Experiment(cohort_size=3, time_scale=0.005, body="kinematic")
    key = CohortKey("wall_avoidance", "guide_agent:table", 0)
    whole = Cohort(experiment, key)
    whole.advance(10**9)
    for stop in range(61, 90, 7):  # in training, where chance plays a part
        first, second = Cohort(experiment, key), Cohort(experiment, key)
        first.advance(stop)
        second.restore(*first.checkpoint())
        second.advance(10**9)
        assert np.array_equal(whole.lives().after["values"], second.lives().after["values"])


def test_an_agent_without_weights_leaves_none(monkeypatch):
    class Still(Agent):
        def reset(self):
            pass

        def act(self, state, learning):
            return np.zeros((len(state), 2))

        def learn(self, reward):
            pass

        def state(self):
            return {}

        def load_state(self, arrays):
            pass

    monkeypatch.setitem(sys.modules, "still", type(sys)("still"))
    sys.modules["still"].make = lambda robots, sensors, seed: Still()
    experiment = Experiment(cohort_size=2, time_scale=0.002)
    cohort = Cohort(experiment, CohortKey("wall_avoidance", "still:make", 0))
    cohort.advance(10**9)
    lives = cohort.lives()
    assert lives.after == {}
    assert lives.valid.all()
