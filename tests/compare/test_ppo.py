"""Policies are trained by Stable-Baselines3's PPO, kept one by one, and joined."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import files_below

from musebot.protocols.agents.ppo import POLICIES_FILE, Policies, policy_arrays, read_policies
from musebot.protocols.compare import ppo
from musebot.protocols.compare.jobs import Progress
from musebot.protocols.compare.ppo import PPOTraining
from musebot.protocols.compare.study import conduct
from musebot.protocols.errors import InputError
from musebot.protocols.storage import save_arrays

TASK = "spot_finding_unit"
ROLLOUT = ppo.ROBOTS * ppo.SETTINGS["n_steps"]
needs_it = pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None, reason="needs the extra `baselines`"
)


@needs_it
def test_a_kept_policy_acts_as_stable_baselines_does_before_and_after_training():
    from stable_baselines3 import PPO

    from musebot.tasks.stable_baselines import ArenaVecEnv

    task = "wall_avoidance_unit"
    progress = Progress(Path(), lambda: False, lambda *_: None)
    ours = Policies(task, ppo.train(task, ROLLOUT, 3, progress))
    torch.set_num_threads(1)
    env = ArenaVecEnv(task, ppo.ROBOTS)
    theirs = PPO("MlpPolicy", env, seed=3, device="cpu", **ppo.SETTINGS)
    states = np.random.default_rng(0).uniform(-1, 1, (20, 1, 5)).astype(np.float32)
    for trained in (False, True):
        for state in states:
            expected = theirs.predict(state, deterministic=True)[0] / 2
            np.testing.assert_allclose(ours.act(state, trained), expected, atol=1e-6)
        theirs.learn(ROLLOUT)


@needs_it
def test_policies_added_later_equal_those_trained_together(tmp_path, in_process):
    here = in_process()
    for out, numbers in (("grown", (1, 2)), ("whole", (2,))):
        for policies in numbers:
            page = conduct(PPOTraining(TASK, policies, steps=1, seed=5), tmp_path / out, here)
    assert "2 policies for the task `spot_finding_unit`" in page.markdown
    assert "seeds 5 to 6, each for 4,096 control steps" in page.markdown
    assert [job.path.name for job in here.jobs] == [f"000{n}.safetensors" for n in (0, 1, 0, 1)]
    path = tmp_path / "grown" / POLICIES_FILE
    assert path.read_bytes() == (tmp_path / "whole" / POLICIES_FILE).read_bytes()
    task, arrays, notes = read_policies(path)
    settings = {"steps": 1, "seed": 5, "settings": ppo.SETTINGS, "robots": ppo.ROBOTS}
    assert (task, notes) == (TASK, settings)
    assert arrays["after.0.weights"].shape == (2, 64, 1)
    assert (arrays["after.0.weights"][0] != arrays["after.0.weights"][1]).any()
    before = files_below(tmp_path)
    for options, words in (
        ({"steps": 2}, "holds a study with steps 1, not 2"),
        ({"policies": 1}, "holds 2 policies, more than 1"),
    ):
        with pytest.raises(InputError, match=words):
            asked = {"policies": 2, "steps": 1, "seed": 5} | options
            conduct(PPOTraining(TASK, **asked), tmp_path / "grown", here)
    assert files_below(tmp_path) == before


@needs_it
def test_training_stops_between_rollouts_when_asked(tmp_path):
    reports = []
    (job,) = PPOTraining(TASK, 1, steps=10 * ROLLOUT)._jobs(tmp_path)
    assert job.run(lambda: len(reports) == 2, lambda *report: reports.append(report)) is False
    assert reports == [(0, ""), (ROLLOUT * 0.1, "")]
    assert not job.done()


def test_without_stable_baselines_nothing_is_made(tmp_path, in_process, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install 'musebot\\[baselines\\]'"):
        conduct(PPOTraining(TASK), tmp_path / "out", in_process())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"task": "flying"}, "the task must be one of"),
        ({"policies": 0}, "policies must be from 1 to 10000, got 0"),
        ({"steps": 0}, "steps must be from 1"),
        ({"seed": -1}, r"the seed must lie in \[0"),
        ({"seed": 2**32}, r"must lie in \[0, 4294967236\], got 4294967296"),
    ],
)
def test_an_invalid_option_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        PPOTraining(**({"task": TASK} | options)).identity()


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("after.0.weights", lambda a: a * np.nan, "after.0.weights must be finite"),
        ("before.2.biases", lambda a: a[:, :1], "before.2.biases must have shape"),
        ("after.1.weights", lambda a: a[..., :-1], "after.1.weights must have shape"),
        ("after.0.weights", lambda a: a[0], "after.0.weights must have shape"),
        ("after.0.weights", lambda a: a.astype(float), "it holds no policies"),
        ("after.0.biases", lambda a: a[0], "it holds no policies"),
        ("after.1.biases", lambda a: a[:0], "must have shape"),
    ],
)
def test_policies_of_an_impossible_shape_or_value_are_refused(name, change, words, tmp_path):
    shapes = {"0": (4, 1), "1": (4, 4), "2": (2, 4)}
    arrays = {
        n: np.ones((1, *shapes[n.split(".")[1]][: 1 if n.endswith("biases") else 2]), np.float32)
        for n in policy_arrays()
    }
    path = tmp_path / POLICIES_FILE
    save_arrays(path, arrays, task=TASK)
    assert read_policies(path)[0] == TASK
    save_arrays(path, arrays, task="wall_avoidance_unit")
    with pytest.raises(InputError, match="must have shape .* for wall_avoidance_unit"):
        read_policies(path)
    save_arrays(path, arrays | {name: change(arrays[name])}, task=TASK)
    with pytest.raises(InputError, match=words):
        read_policies(path)
