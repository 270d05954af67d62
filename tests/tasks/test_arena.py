"""Every task fulfils the contract of dm_control."""

import subprocess
import sys

import numpy as np
import pytest
from dm_control.suite.wrappers import action_noise, action_scale
from dm_env import test_utils

import musebot
from musebot.tasks.suite import TASKS


@pytest.fixture(params=musebot.ALL_TASKS, ids="/".join)
def task(request):
    return request.param


@pytest.fixture(params=musebot.BENCHMARKING, ids="/".join)
def benchmarking(request):
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


def test_observations_and_rewards_match_their_specs(task):
    for seed in range(10):
        environment = musebot.load(*task, task_kwargs={"random": seed})
        for timestep in play(environment, seed=seed):
            for name, spec in environment.observation_spec().items():
                spec.validate(timestep.observation[name])
                assert spec.name == name
                assert timestep.observation[name].ndim == 1
            if not timestep.first():
                environment.reward_spec().validate(timestep.reward)


def test_actions_are_two_bounded_motors(task):
    spec = musebot.load(*task).action_spec()
    limit = 0.5 if task in musebot.PAPER else 1.0
    assert spec.shape == (2,)
    assert spec.name == "motors"
    assert (spec.minimum == -limit).all() and (spec.maximum == limit).all()


def test_benchmarking_tasks_have_rewards_in_0_to_1_and_1000_steps(benchmarking):
    environment = musebot.load(*benchmarking, task_kwargs={"random": 0})
    reward = environment.reward_spec()
    assert (reward.minimum, reward.maximum) == (0.0, 1.0)
    timestep, steps = environment.reset(), 0
    while not timestep.last():
        timestep = environment.step(np.array([0.3, -0.1]))
        steps += 1
    assert steps == 1000
    assert timestep.discount == 1.0  # truncated, not terminated


def test_a_control_step_is_0_1_seconds(task):
    environment = musebot.load(*task)
    environment.reset()
    environment.step(np.zeros(2))
    assert environment.control_timestep() == pytest.approx(0.1)
    assert environment.physics.time() == pytest.approx(0.1)


def test_equal_seeds_give_equal_episodes_and_others_do_not(task):
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


def test_no_observation_is_constant(task):
    episodes = [play(musebot.load(*task, task_kwargs={"random": s}), 150, s) for s in range(8)]
    for heading in (0.0, 3.0):  # two more drive straight into a wall
        environment = musebot.load(*task, task_kwargs={"robot": (0.0, 0.0, heading), "random": 0})
        environment.reset()
        episodes.append([environment.step(np.full(2, 0.5)) for _ in range(80)])
    everything = np.concatenate([flat(life) for life in episodes])
    assert (everything.std(axis=0) > 0).all()


def test_every_element_has_a_name_and_there_are_two_cameras(task):
    model = musebot.load(*task).physics.model.ptr
    for kind in ("body", "jnt", "geom", "site", "cam", "light", "actuator", "sensor", "mat"):
        access = getattr(model, {"jnt": "joint"}.get(kind, kind))
        names = [
            access(k).name for k in range(getattr(model, {"actuator": "nu"}.get(kind, f"n{kind}")))
        ]
        assert all(names), kind
    assert model.ncam >= 2


def test_visualize_reward_changes_colours_only(task):
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
        first, second = (e.step(e.action_spec().maximum) for e in (plain, shown))
        np.testing.assert_array_equal(flat([first]), flat([second]))
        colours.add(tuple(shown.physics.named.model.mat_rgba["musebot_shell"]))
    assert len(colours) > 1
    untouched = musebot.load(*task)
    np.testing.assert_array_equal(
        plain.physics.named.model.mat_rgba["musebot_shell"],
        untouched.physics.named.model.mat_rgba["musebot_shell"],
    )


def test_the_first_picture_of_an_episode_shows_its_own_reward():
    far = {"random": 1, "robot": (-0.4, -0.2, np.pi), "spot": (0.4, 0.2)}  # the nose smells nothing
    shown, plain = (
        musebot.load("arena", "spot_finding", far, visualize_reward=flag) for flag in (True, False)
    )
    colours = []
    for environment in (shown, plain):
        environment.reset()
        colours.append(environment.physics.named.model.mat_rgba["musebot_shell"].copy())
    np.testing.assert_array_equal(*colours)


def test_environment_kwargs_and_time_limit_are_applied(task):
    environment = musebot.load(
        *task, task_kwargs={"time_limit": 1.0}, environment_kwargs={"flat_observation": True}
    )
    timesteps = play(environment, 10)
    assert timesteps[-1].last() and not timesteps[-2].last()
    spec = environment.observation_spec()["observations"]
    for timestep in timesteps:
        spec.validate(timestep.observation["observations"])


def test_the_action_wrappers_of_dm_control_work(task):
    noisy = action_noise.Wrapper(musebot.load(*task, task_kwargs={"random": 0}), scale=0.1)
    plain = musebot.load(*task, task_kwargs={"random": 0})
    assert not np.array_equal(flat(play(noisy)), flat(play(plain)))
    plain, scaled = (musebot.load(*task, task_kwargs={"random": 0}) for _ in range(2))
    scaled = action_scale.Wrapper(scaled, minimum=np.full(2, -2.0), maximum=np.full(2, 2.0))
    np.testing.assert_allclose(flat(play(scaled)), flat(play(plain)), rtol=1e-6, atol=1e-9)


DRAW = """
import numpy as np, musebot
from dm_control.suite.wrappers import pixels
for task in musebot.ALL_TASKS:
    kwargs = {"width": 64, "height": 48, "camera_id": "overhead"}
    environment = pixels.Wrapper(
        musebot.load(*task, task_kwargs={"random": 0}, visualize_reward=True), render_kwargs=kwargs
    )
    first = environment.reset().observation["pixels"]
    for _ in range(5):
        last = environment.step(environment.action_spec().maximum).observation["pixels"]
    assert first.shape == (48, 64, 3) and first.std() > 0 and (first != last).any(), task
print("drawn")
"""


@pytest.mark.slow
def test_the_pixel_wrapper_of_dm_control_works(egl, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    done = subprocess.run([sys.executable, "-c", DRAW], capture_output=True, text=True)
    assert done.stdout == "drawn\n", done.stderr


@pytest.mark.parametrize("action", [np.full(2, np.nan), np.zeros(3), [np.inf, 0]])
def test_an_action_that_is_not_two_finite_numbers_is_refused(task, action):
    environment = musebot.load(*task)
    environment.reset()
    with pytest.raises(ValueError, match="two finite motor values.*got"):
        environment.step(action)


def test_actions_beyond_the_limits_are_clipped(task):
    episodes = []
    for times in (1, 6):
        environment = musebot.load(*task, task_kwargs={"random": 0})
        environment.reset()
        action = times * environment.action_spec().maximum
        episodes.append(flat([environment.step(action) for _ in range(5)]))
    np.testing.assert_array_equal(*episodes)


def test_action_1_is_motor_value_0_5(benchmarking):
    environment = musebot.load(*benchmarking)
    environment.reset()
    environment.step(np.array([1.0, -0.5]))
    np.testing.assert_array_equal(environment.physics.control(), [0.5, -0.25])


def test_unknown_keywords_are_refused_with_the_known_ones(task):
    with pytest.raises(TypeError, match=r"'robot', 'spot', 'time_limit'\], got \['colour'\]"):
        musebot.load(*task, task_kwargs={"colour": "red"})
    with pytest.raises(TypeError, match=r"'flat_observation', .*\], got \['speed'\]"):
        musebot.load(*task, environment_kwargs={"speed": 2})


@pytest.mark.parametrize("kwargs", [{"nose": "inverse"}, {"nose": "printed"}])
def test_only_a_robot_with_a_nose_accepts_the_keyword_nose(task, kwargs):
    if "nose" in TASKS[task[1]].keywords:
        musebot.load(*task, task_kwargs=kwargs)
    else:
        with pytest.raises(TypeError, match=r"got \['nose'\]"):
            musebot.load(*task, task_kwargs=kwargs)


def _contract(domain, name):
    from absl.testing import absltest

    class Contract(test_utils.EnvironmentTestMixin, absltest.TestCase):
        def make_object_under_test(self):
            return musebot.load(domain, name, {"random": 0, "time_limit": 2.0})

        def make_action_sequence(self):
            spec = musebot.load(domain, name).action_spec()
            random = np.random.RandomState(0)
            for _ in range(200):
                yield random.uniform(spec.minimum, spec.maximum)

    Contract.__name__ = Contract.__qualname__ = "Test" + name.title().replace("_", "")
    return Contract


for _task in musebot.ALL_TASKS:
    _class = _contract(*_task)
    globals()[_class.__name__] = _class
del _class
