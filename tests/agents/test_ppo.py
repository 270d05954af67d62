"""Policies that PPO trained drive robots, without Stable-Baselines3."""

import numpy as np
import pytest
from helpers import random_policies

import musebot
from musebot.protocols.agents import ppo
from musebot.protocols.agents.ppo import Policies, policy_file
from musebot.protocols.agents.signals import senses_of
from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.runs.cohort import Cohort, make_agent
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.tasks.suite import TASKS

AGENT = "musebot.protocols.ppo:ppo"


def file_of(task):
    return ppo.FOLDER / task / ppo.POLICIES_FILE


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with three policies for either task."""
    monkeypatch.chdir(tmp_path)
    for task in ppo.TRAINED_ON:
        path = file_of(task)
        path.parent.mkdir(parents=True)
        save_arrays(path, random_policies(task, 3).arrays, task=task, steps=1)
    return tmp_path


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_policies_act_untrained_in_the_first_test_and_trained_from_then_on(folder, task):
    experiment = Experiment(cohort_size=3, time_scale=0.005, body="kinematic")
    whole, first, second = (
        Cohort(experiment, CohortKey(Condition(task, AGENT), 0)) for _ in range(3)
    )
    whole.advance(10**9)
    first.advance(2 * whole.steps // 3)
    second.restore(*first.checkpoint())
    second.advance(10**9)
    np.testing.assert_array_equal(whole.lives().minutes, second.lives().minutes)
    policies = random_policies(task + "_unit", 3)
    for when, weights in (("before", whole.lives().before), ("after", whole.lives().after)):
        assert len(weights) == 6
        for name, array in weights.items():
            np.testing.assert_array_equal(array, policies.arrays[f"{when}.{name}"])
    sensors = policies.arrays["after.0.weights"].shape[2]
    agent = make_agent(experiment, Condition(task, AGENT), 3, 0)
    state = np.random.default_rng(2).uniform(0, 1, (3, sensors)).astype(np.float32)
    for learning, trained in ((False, False), (True, True), (False, True)):
        np.testing.assert_array_equal(agent.act(state, learning), policies.act(state, trained))


def test_weights_that_a_run_keeps_drive_a_policy_again(folder):
    agent, other = (
        make_agent(Experiment(), Condition("spot_finding", AGENT), 2, 0) for _ in range(2)
    )
    nose = np.array([[0.1], [0.8]], np.float32)
    motors = agent.act(nose, True)
    other.load_weights(agent.weights())
    np.testing.assert_array_equal(other.act(nose, False), motors)
    short = {name: array[:1] for name, array in agent.weights().items()}
    for wrong in (short, {"0.weights": agent.weights()["0.weights"]}):
        with pytest.raises(ValueError, match="must have shape"):
            other.load_weights(wrong)


def test_policies_drive_robots_in_tasks_with_the_signals_of_their_training_only(folder):
    for task in TASKS:
        own = senses_of(task)
        if any(senses_of(one).state == own.state for one in ppo.TRAINED_ON):
            state = np.zeros((3, len(own.state)), np.float32)
            assert ppo.ppo(robots=3, senses=own, seed=0).act(state, True).shape == (3, 2)
        else:
            assert task in ("wall_avoidance_obstacles", "spot_finding_two_noses")
            with pytest.raises(InputError, match="ppo has no policies for these signals"):
                ppo.ppo(robots=3, senses=own, seed=0)


def test_missing_and_unfit_policies_are_refused(folder):
    def make(robots):
        return make_agent(Experiment(), Condition("wall_avoidance", AGENT), robots, 0)

    with pytest.raises(InputError, match="has 3 policies, too few for 4 robots"):
        make(4)
    path = file_of("wall_avoidance_unit")
    file_of("spot_finding_unit").replace(path)
    with pytest.raises(InputError, match="holds policies for spot_finding_unit"):
        make(3)
    path.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="is damaged"):
        make(3)
    path.unlink()
    with pytest.raises(InputError, match="`musebot benchmark ppo .* trains the policies"):
        make(3)


def test_a_life_continues_only_with_the_policies_with_which_it_began(folder):
    experiment = Experiment(cohort_size=2, time_scale=0.005, body="kinematic")
    key = CohortKey(Condition("wall_avoidance", AGENT), 0)
    cohort = Cohort(experiment, key)
    cohort.advance(100)
    arrays, notes = cohort.checkpoint()
    task = "wall_avoidance_unit"
    path = file_of(task)
    others = random_policies(task, 3, seed=1).arrays
    save_arrays(path, others, task=task, steps=1)
    with pytest.raises(ValueError, match="not those with which the life began"):
        Cohort(experiment, key).restore(arrays, notes)
    np.testing.assert_equal(Policies.load(path, task).arrays, others)


def test_a_file_without_policies_is_refused(tmp_path):
    path = tmp_path / "policies.safetensors"
    arrays = random_policies("spot_finding_unit", 1).arrays
    for some, notes in (
        (arrays, {"task": "flying"}),
        ({"a": np.zeros(1)}, {"task": "wall_avoidance"}),
    ):
        save_arrays(path, some, **notes)
        with pytest.raises(DamagedFileError, match="holds no policies"):
            Policies.load(path, "wall_avoidance")


def test_a_policy_comes_with_musebot_for_every_task_of_the_suite_only(monkeypatch):
    for _, task in musebot.ALL_TASKS:
        policies = Policies.load(path := policy_file(task), task)
        notes = load_arrays(path)[1]
        assert policies.robots == 1 and (notes["seed"], notes["steps"]) == (0, 327_680)
        assert path.stat().st_size < 50_000
    with pytest.raises(InputError, match="there is no task 'dancing'; there are wall_"):
        policy_file("dancing")
    monkeypatch.setitem(TASKS, "mine", TASKS["wall_avoidance"])
    words = "^musebot brings no policy for mine: `musebot benchmark ppo`"
    with pytest.raises(InputError, match=words):
        policy_file("mine")


def test_a_policys_action_is_clipped_to_its_tasks_limit_and_scaled_to_a_motor_value():
    arrays = random_policies("wall_avoidance_unit", 2).arrays
    state = np.random.default_rng(3).uniform(-1, 1, (2, 5)).astype(np.float32)
    for task, limit in (("wall_avoidance", 0.5), ("wall_avoidance_unit", 1)):
        signal = state[..., None].astype(float)
        for layer in range(3):
            weights, biases = (arrays[f"after.{layer}.{x}"] for x in ("weights", "biases"))
            signal = weights @ signal + biases[..., None]
            signal = np.tanh(signal) if layer < 2 else signal
        expected = np.clip(signal[..., 0], -limit, limit) * 0.5 / limit
        found = Policies(task, arrays).act(state, trained=True)
        np.testing.assert_allclose(found, expected, atol=1e-5)
        alone = Policies(task, arrays).one(1).act(state[1:])
        np.testing.assert_allclose(alone, expected[1:], atol=1e-5)
        assert np.abs(expected).max() <= 0.5 and np.abs(expected).min() < 0.5  # not all clipped
    with pytest.raises(InputError, match="the policies are 0 to 1, got 2"):
        Policies(task, arrays).one(2)
