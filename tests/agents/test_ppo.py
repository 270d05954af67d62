"""Policies of Stable-Baselines3's PPO are trained, kept, and drive robots without it."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from musebot.protocols import cli
from musebot.protocols.agents.base import make_agent, ppo
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.experiment import CohortKey, Experiment
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.storage import save_arrays

AGENT = "musebot.protocols.ppo:ppo"
needs_it = pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None,
    reason="needs the extra `baselines`",
)


def command(folder, *words):
    line = [sys.executable, "-m", "musebot.protocols.agents.ppo", *map(str, words)]
    return subprocess.run(line, cwd=folder, capture_output=True, text=True, timeout=300)


def newborn(task, robots, seed=0):
    """Policies with weights drawn at random."""
    random = np.random.default_rng(seed)
    sensors = {"wall_avoidance_unit": 5, "spot_finding_unit": 1}[task]
    arrays = {}
    for when in ("before", "after"):
        for layer, (outputs, inputs) in enumerate([(64, sensors), (64, 64), (2, 64)]):
            weights = random.normal(size=(robots, outputs, inputs)) / np.sqrt(inputs)
            arrays[f"{when}.{layer}.weights"] = weights.astype(np.float32)
            arrays[f"{when}.{layer}.biases"] = random.normal(size=(robots, outputs)).astype("f4")
    return ppo.Policies(task, arrays)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with three policies for either task."""
    (tmp_path / ppo.FOLDER).mkdir()
    for task in ppo.TRAINED_ON.values():
        path = tmp_path / ppo.FOLDER / f"{task}.safetensors"
        save_arrays(path, newborn(task, 3).arrays, task=task, steps=1)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@needs_it
def test_a_kept_policy_acts_as_stable_baselines_does_before_and_after_training():
    from stable_baselines3 import PPO

    from musebot.tasks.stable_baselines import ArenaVecEnv

    task, steps = "wall_avoidance_unit", ppo.ROBOTS * ppo.SETTINGS["n_steps"]
    ours = ppo.Policies(task, ppo.train(task, steps, seed=3))
    torch.set_num_threads(1)
    env = ArenaVecEnv(task, ppo.ROBOTS)
    theirs = PPO("MlpPolicy", env, seed=3, device="cpu", **ppo.SETTINGS)
    states = np.random.default_rng(0).uniform(-1, 1, (20, 1, 5)).astype(np.float32)
    for trained in (False, True):
        for state in states:
            expected = theirs.predict(state, deterministic=True)[0] / 2
            np.testing.assert_allclose(ours.act(state, trained), expected, atol=1e-6)
        theirs.learn(steps)


@needs_it
def test_training_goes_on_where_it_stopped_and_equals_one_that_did_not(tmp_path):
    common = ["--task", "spot_finding_unit", "--steps", 1, "--processes", 1]
    for words in (["a.safetensors", "--policies", 1], ["a.safetensors", "--policies", 2]):
        done = command(tmp_path, *words, *common)
        assert done.returncode == 0, done.stderr
    command(tmp_path, "b.safetensors", "--policies", 2, *common)
    first, second = (
        ppo.Policies.load(tmp_path / f"{name}.safetensors", common[1]) for name in "ab"
    )
    assert first.robots == 2 and first.arrays["after.0.weights"].shape == (2, 64, 1)
    for name, array in first.arrays.items():
        np.testing.assert_array_equal(array, second.arrays[name])
    assert (first.arrays["after.0.weights"][0] != first.arrays["after.0.weights"][1]).any()
    kept = (tmp_path / "a.safetensors").read_bytes()
    other = command(tmp_path, "a.safetensors", *common[:2], "--steps", 2)
    assert other.returncode == 2 and "trained otherwise" in other.stderr
    assert (tmp_path / "a.safetensors").read_bytes() == kept


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["x.safetensors", "--task", "flying"], "the task must be one of"),
        (["x.safetensors", "--task", "spot_finding", "--policies", "0"], "at least 1"),
        (["x.safetensors", "--task", "spot_finding", "--seed", "-1"], "the seed must lie in [0"),
        (
            ["x.safetensors", "--task", "spot_finding", "--seed", 2**32],
            "must lie in [0, 4294967236]",
        ),
        ([".", "--task", "spot_finding"], "is a folder"),
    ],
)
def test_nonsense_is_answered_by_a_sentence(tmp_path, words, sentence):
    done = command(tmp_path, *words)
    assert done.returncode == 2
    assert sentence in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_every_policy_drives_its_own_robot():
    three = newborn("wall_avoidance_unit", 3)
    states = np.random.default_rng(1).uniform(-1, 1, (3, 5)).astype(np.float32)
    together = three.act(states)
    assert together.shape == (3, 2) and np.abs(together).max() <= 0.5
    for robot in range(3):
        alone = three.one(robot).act(states[robot : robot + 1])
        np.testing.assert_allclose(alone[0], together[robot], atol=1e-6)
    with pytest.raises(InputError, match="the policies are 0 to 2, got 3"):
        three.one(3)


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_its_robots_are_newborn_in_the_first_test_and_trained_from_training_on(folder, task):
    experiment = Experiment(cohort_size=3, time_scale=0.005, body="kinematic")
    whole, first, second = (Cohort(experiment, CohortKey(task, AGENT, 0)) for _ in range(3))
    whole.advance(10**9)
    first.advance(2 * whole.steps // 3)
    second.restore(*first.checkpoint())
    second.advance(10**9)
    np.testing.assert_array_equal(whole.lives().minutes, second.lives().minutes)
    policies = newborn(task + "_unit", 3)
    for when, weights in (("before", whole.lives().before), ("after", whole.lives().after)):
        assert len(weights) == 6
        for name, array in weights.items():
            np.testing.assert_array_equal(array, policies.arrays[f"{when}.{name}"])
    sensors = policies.arrays["after.0.weights"].shape[2]
    agent = make_agent(experiment, task, AGENT, 3, 0)
    state = np.random.default_rng(2).uniform(0, 1, (3, sensors)).astype(np.float32)
    for learning, trained in ((False, False), (True, True), (False, True)):
        np.testing.assert_array_equal(agent.act(state, learning), policies.act(state, trained))


def test_what_is_missing_is_said_before_a_life_begins(folder):
    def make(robots):
        return make_agent(Experiment(), "wall_avoidance", AGENT, robots, 0)

    with pytest.raises(InputError, match="has 3 policies, too few for 4 robots"):
        make(4)
    with pytest.raises(InputError, match=r"for \[1, 5\] signals, got 2"):
        ppo.ppo(robots=3, sensors=2, seed=0)
    path = ppo.FOLDER / "wall_avoidance_unit.safetensors"
    (ppo.FOLDER / "spot_finding_unit.safetensors").replace(path)
    with pytest.raises(InputError, match="holds policies for spot_finding_unit"):
        make(3)
    path.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="is damaged"):
        make(3)
    path.unlink()
    with pytest.raises(InputError, match="python -m musebot.protocols.agents.ppo .* trains them"):
        make(3)


def test_a_life_goes_on_with_the_policies_it_began_with_or_not_at_all(folder):
    experiment = Experiment(cohort_size=2, time_scale=0.005, body="kinematic")
    key = CohortKey("wall_avoidance", AGENT, 0)
    cohort = Cohort(experiment, key)
    cohort.advance(100)
    arrays, notes = cohort.checkpoint()
    task = "wall_avoidance_unit"
    path = ppo.FOLDER / f"{task}.safetensors"
    save_arrays(path, newborn(task, 3, seed=1).arrays, task=task, steps=1)
    with pytest.raises(ValueError, match="not those that the life began with"):
        Cohort(experiment, key).restore(arrays, notes)


def test_a_run_of_more_robots_than_policies_leaves_nothing_behind(folder, capsys):
    status = cli.main(["run", "out", "--agent", AGENT, "--robots", "4", "--time-scale", "0.001"])
    assert status == 2
    assert "has 3 policies, too few for 4 robots" in capsys.readouterr().err
    assert not (folder / "out").exists()


@needs_it
@pytest.mark.parametrize(
    ("what", "status", "sentence"),
    [("parent", 130, "goes on from here"), ("worker", 1, "a process died")],
)
def test_training_that_is_stopped_ends_at_once_and_says_so(tmp_path, what, status, sentence):
    line = [sys.executable, "-m", "musebot.protocols.agents.ppo", "a.safetensors"]
    line += ["--task", "spot_finding_unit", "--processes", "1"]  # an hour's work
    training = subprocess.Popen(line, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    try:
        worker = first_worker(training.pid)
        if what == "parent":
            training.send_signal(signal.SIGINT)
        else:
            os.kill(worker, signal.SIGKILL)
        _, said = training.communicate(timeout=60)
    finally:
        training.kill()
    assert training.returncode == status
    assert sentence in said and "Traceback" not in said
    assert not Path(f"/proc/{worker}").exists()


def first_worker(parent):
    """The process id of the child that trains, once there is one."""
    for _ in range(600):
        for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
            if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text():
                return int(child)
        time.sleep(0.1)
    raise AssertionError("nobody trains")
