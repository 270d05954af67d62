"""A policy is trained by Stable-Baselines3's PPO and kept."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import files_below

from musebot.protocols.agents.policy import Policy
from musebot.protocols.compare import ppo
from musebot.protocols.compare.jobs import Progress
from musebot.protocols.compare.ppo import POLICY_FILE, PPOTraining
from musebot.protocols.compare.study import conduct
from musebot.protocols.errors import InputError
from musebot.protocols.storage import load_arrays

TASK = "spot_finding_unit"
SHORT = {"n_steps": 16, "batch_size": 64}
ROLLOUT = ppo.ROBOTS * SHORT["n_steps"]
needs_it = pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None, reason="needs the extra `baselines`"
)


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Short rollouts."""
    monkeypatch.setattr(ppo, "SETTINGS", ppo.SETTINGS | SHORT)
    monkeypatch.setattr(ppo, "_ROLLOUT", ROLLOUT)


@needs_it
def test_a_kept_policy_acts_as_stable_baselines_does_before_and_after_training():
    from stable_baselines3 import PPO

    from musebot.tasks.stable_baselines import ArenaVecEnv

    task = "wall_avoidance_unit"
    progress = Progress(Path(), lambda: False, lambda *_: None)
    ours = Policy(task, ppo.train(task, ROLLOUT, 3, progress))
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
def test_a_finished_training_is_not_repeated_and_has_no_other_options(tmp_path, in_process):
    here, out = in_process(), tmp_path / "out"
    for _ in range(2):
        page = conduct(PPOTraining(TASK, steps=1, seed=5), out, here)
    assert "holds a policy for the task `spot_finding_unit`" in page.markdown
    assert "the seed 5 for 256 control steps" in page.markdown
    assert [job.path.name for job in here.jobs] == [POLICY_FILE]
    notes = load_arrays(out / POLICY_FILE)[1]
    settings = {"steps": 1, "seed": 5, "settings": ppo.SETTINGS, "robots": ppo.ROBOTS}
    assert notes == settings | {"task": TASK}
    Policy.load(out / POLICY_FILE, TASK)
    before = files_below(tmp_path)
    with pytest.raises(InputError, match="holds a study with steps 1, not 2"):
        conduct(PPOTraining(TASK, steps=2, seed=5), out, here)
    assert files_below(tmp_path) == before


def test_without_stable_baselines_nothing_is_made(tmp_path, in_process, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install 'musebot\\[baselines\\]'"):
        conduct(PPOTraining(TASK), tmp_path / "out", in_process())
    assert list(tmp_path.iterdir()) == []


def test_an_invalid_option_is_refused():
    ends = {"steps": (0,), "seed": (-1, 2**32), "task": ("flying",)}
    for name, values in ends.items():
        for value in values:
            with pytest.raises(InputError, match=f"{name} must .*, got |there is no {name} "):
                PPOTraining(**({"task": TASK} | {name: value})).identity()
