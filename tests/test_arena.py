"""Every task keeps the contract that dm_control's users rely on."""

import numpy as np
import pytest
from dm_env import test_utils

import musebot


@pytest.fixture(params=musebot.ALL_TASKS, ids="/".join)
def task(request):
    return request.param


def play(environment, steps=30, seed=0):
    random = np.random.RandomState(seed)
    spec = environment.action_spec()
    timesteps = [environment.reset()]
    for _ in range(steps):
        timesteps.append(environment.step(random.uniform(spec.minimum, spec.maximum)))
    return timesteps


def flat(timesteps):
    return np.stack([np.concatenate(list(t.observation.values())) for t in timesteps])


def test_specs_hold(task):
    for seed in range(5):
        environment = musebot.load(*task, task_kwargs={"random": seed})
        for timestep in play(environment):
            for name, spec in environment.observation_spec().items():
                spec.validate(timestep.observation[name])
                assert timestep.observation[name].ndim == 1
            if not timestep.first():
                environment.reward_spec().validate(np.asarray(timestep.reward))


def test_actions_are_two_motors_in_half_a_unit(task):
    spec = musebot.load(*task).action_spec()
    assert spec.shape == (2,)
    assert (spec.minimum == -0.5).all() and (spec.maximum == 0.5).all()


def test_a_control_step_is_a_tenth_of_a_second(task):
    environment = musebot.load(*task)
    environment.reset()
    environment.step(np.zeros(2))
    assert environment.control_timestep() == pytest.approx(0.1)
    assert environment.physics.time() == pytest.approx(0.1)


def test_same_seed_same_life_and_another_seed_another(task):
    first, again, other = (
        flat(play(musebot.load(*task, task_kwargs={"random": seed}), 100)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_observations_share_no_memory(task):
    environment = musebot.load(*task, task_kwargs={"random": 0})
    before = environment.reset().observation
    kept = {name: value.copy() for name, value in before.items()}
    for _ in range(20):
        environment.step(np.full(2, 0.5))
    for name, value in before.items():
        np.testing.assert_array_equal(value, kept[name])


def test_no_observation_is_constant_over_all_seeds(task):
    lives = [play(musebot.load(*task, task_kwargs={"random": s}), 150, s) for s in range(8)]
    for heading in (0.0, 3.0):  # and two that drive straight on, into a wall
        environment = musebot.load(*task, task_kwargs={"robot": (0.0, 0.0, heading), "random": 0})
        environment.reset()
        lives.append([environment.step(np.full(2, 0.5)) for _ in range(40)])
    everything = np.concatenate([flat(life) for life in lives])
    assert (everything.std(axis=0) > 0).all()


def test_visualize_reward_colours_something_and_changes_nothing_else(task):
    plain, shown = (
        musebot.load(
            *task,
            task_kwargs={"random": 3, "spot": (0.3, 0.0), "robot": (0.2, 0.0, 0.0)},
            visualize_reward=flag,
        )
        for flag in (False, True)
    )
    colours = set()
    for environment in (plain, shown):
        environment.reset()
    for _ in range(60):
        first, second = plain.step(np.full(2, 0.5)), shown.step(np.full(2, 0.5))
        np.testing.assert_array_equal(flat([first]), flat([second]))
        colours.add(tuple(shown.physics.named.model.mat_rgba["musebot/shell"]))
    assert len(colours) > 1
    untouched = musebot.load(*task)
    np.testing.assert_array_equal(
        plain.physics.named.model.mat_rgba["musebot/shell"],
        untouched.physics.named.model.mat_rgba["musebot/shell"],
    )


def test_the_start_can_be_fixed(task):
    kwargs = {"robot": (0.1, -0.2, 1.0), "spot": (0.3, 0.2)}
    environment = musebot.load(*task, task_kwargs=kwargs)
    environment.reset()
    np.testing.assert_allclose(environment.physics.robot_pose(), kwargs["robot"], atol=1e-12)
    np.testing.assert_allclose(environment.physics.spot_position(), kwargs["spot"])


def test_environment_kwargs_and_time_limit_pass(task):
    environment = musebot.load(
        *task, task_kwargs={"time_limit": 1.0}, environment_kwargs={"flat_observation": True}
    )
    timesteps = play(environment, 10)
    assert timesteps[-1].last()
    assert timesteps[0].observation["observations"].ndim == 1


@pytest.mark.parametrize("action", [np.full(2, np.nan), np.zeros(3), [np.inf, 0]])
def test_a_nonsense_action_is_refused(task, action):
    environment = musebot.load(*task)
    environment.reset()
    with pytest.raises(ValueError, match="two finite motor values"):
        environment.step(action)


def test_actions_beyond_the_limits_are_clipped(task):
    lives = []
    for motor in (0.5, 3.0):
        environment = musebot.load(*task, task_kwargs={"random": 0})
        environment.reset()
        lives.append(flat([environment.step(np.full(2, motor)) for _ in range(5)]))
    np.testing.assert_array_equal(*lives)


def test_unknown_names_are_refused_naming_what_there_is():
    with pytest.raises(ValueError, match=r"domain must be one of \['arena'\], got 'moon'"):
        musebot.load("moon", "wall_avoidance")
    with pytest.raises(ValueError, match="task must be one of .*wall_avoidance.*got 'dancing'"):
        musebot.load("arena", "dancing")


class EnvironmentContract(test_utils.EnvironmentTestMixin):
    task = ""

    def make_object_under_test(self):
        return musebot.load("arena", self.task, {"random": 0, "time_limit": 2.0})

    def make_action_sequence(self):
        random = np.random.RandomState(0)
        for _ in range(200):
            yield random.uniform(-0.5, 0.5, 2)


def _contract(name):
    from absl.testing import absltest

    return type(name, (EnvironmentContract, absltest.TestCase), {"task": name})


TestWallAvoidance = _contract("wall_avoidance")
TestSpotFinding = _contract("spot_finding")
