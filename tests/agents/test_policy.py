"""A policy that PPO trained drives robots, without Stable-Baselines3."""

import numpy as np
import pytest
from helpers import random_policy

import musebot
from musebot.protocols.agents.policy import Policy, policy_file
from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.tasks.suite import TASKS


def test_a_file_without_a_policy_for_the_task_is_refused(tmp_path):
    path = tmp_path / "policy.safetensors"
    arrays = random_policy("spot_finding_unit").arrays
    nan = {**arrays, "before.0.biases": np.full_like(arrays["before.0.biases"], np.nan)}
    for task, some, notes, words in (
        ("wall_avoidance", arrays, {"task": "flying"}, "holds no policy"),
        ("wall_avoidance", {"a": np.zeros(1)}, {"task": "wall_avoidance"}, "holds no policy"),
        (
            "wall_avoidance",
            arrays,
            {"task": "wall_avoidance"},
            "for the signals of wall_avoidance",
        ),
        ("spot_finding", nan, {"task": "spot_finding"}, "before.0.biases must be finite"),
    ):
        save_arrays(path, some, **notes)
        with pytest.raises(DamagedFileError, match=words):
            Policy.load(path, task)
    save_arrays(path, arrays, task="spot_finding_unit")
    with pytest.raises(InputError, match="a policy for spot_finding_unit, not for spot_finding$"):
        Policy.load(path, "spot_finding")
    np.testing.assert_equal(Policy.load(path, "spot_finding_unit").arrays, arrays)


def test_a_policy_comes_with_musebot_for_every_task_of_the_suite_only(monkeypatch):
    for _, task in musebot.ALL_TASKS:
        Policy.load(path := policy_file(task), task)
        notes = load_arrays(path)[1]
        assert (notes["seed"], notes["steps"]) == (0, 327_680)
        assert path.stat().st_size < 50_000
    with pytest.raises(InputError, match="there is no task 'dancing'; there are wall_"):
        policy_file("dancing")
    monkeypatch.setitem(TASKS, "mine", TASKS["wall_avoidance"])
    words = "^musebot brings no policy for mine: `musebot benchmark ppo`"
    with pytest.raises(InputError, match=words):
        policy_file("mine")


def test_a_policys_action_is_clipped_to_its_tasks_limit_and_scaled_to_a_motor_value():
    arrays = random_policy("wall_avoidance_unit").arrays
    state = np.random.default_rng(3).uniform(-1, 1, (20, 5)).astype(np.float32)
    for task, limit in (("wall_avoidance", 0.5), ("wall_avoidance_unit", 1)):
        for when in ("before", "after"):
            signal = state.astype(float)
            for layer in range(3):
                weights, biases = (arrays[f"{when}.{layer}.{x}"] for x in ("weights", "biases"))
                signal = np.einsum("bi,oi->bo", signal, weights) + biases
                signal = np.tanh(signal) if layer < 2 else signal
            expected = np.clip(signal, -limit, limit) * 0.5 / limit
            found = Policy(task, arrays).act(state, trained=when == "after")
            np.testing.assert_allclose(found, expected, atol=1e-5)
            assert np.abs(expected).max() <= 0.5 and np.abs(expected).min() < 0.5  # some clipped
