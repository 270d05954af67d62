"""Every interface refuses the same values with the same sentences, and has the same states."""

import re

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")

from dm_control.rl.control import PhysicsError  # noqa: E402

import musebot  # noqa: E402
from musebot.tasks.gymnasium_env import ArenaEnv, ArenaVectorEnv  # noqa: E402

PILLARS = "wall_avoidance_obstacles"
INTERFACES = {
    "dm_control": lambda task, **kwargs: musebot.load("arena", task, kwargs),
    "Gymnasium": lambda task, **kwargs: ArenaEnv(task, **kwargs),
    "batch": lambda task, **kwargs: ArenaVectorEnv(task, 1, **kwargs),
}
INSIDE = r"inside the arena, \|x\| <= {} and \|y\| <= {}, got \({}"
PLACES = [
    ({"robot": (5, 5, 0)}, "robot must be " + INSIDE.format("0.4975", "0.3225", r"5.0, 5.0, 0.0")),
    ({"robot": (0.5, 0, 0)}, "robot must be inside the arena"),
    ({"robot": (0, -0.33, 0)}, "robot must be inside the arena"),
    ({"spot": (5, 5)}, "spot must be " + INSIDE.format("0.525", "0.35", r"5.0, 5.0")),
    ({"spot": (0, 0.36)}, "spot must be inside the arena"),
    (
        {"robot": (0.05, -0.14, 0)},
        r"robot must be at least 0.0875 m from the centre of the obstacle at \(0.05, -0.14\)",
    ),
    ({"robot": (0, np.nan, 0)}, r"robot must be 3 finite numbers, got \(0, nan, 0\)"),
    ({"robot": (0, 0, 1j)}, r"robot must be 3 finite numbers, got \(0, 0, 1j\)"),
    ({"robot": ("a", "b", "c")}, "robot must be 3 finite numbers"),
    ({"robot": ((0, 0), 0, 0)}, "robot must be 3 finite numbers"),
    ({"robot": (0, 0)}, "robot must be 3 finite numbers"),
    ({"spot": (np.inf, 0)}, "spot must be 2 finite numbers"),
    ({"spot": 0.1}, "spot must be 2 finite numbers"),
    ({"robot": "middle"}, "robot must be one of"),
]


@pytest.fixture(params=INTERFACES)
def make(request):
    return INTERFACES[request.param]


def refusal(function, *args, **kwargs):
    """Returns the type and the sentence of the refusal of a call."""
    with pytest.raises((ValueError, TypeError, RuntimeError)) as caught:
        function(*args, **kwargs)
    return type(caught.value), str(caught.value)


def observed(result):
    """Returns the observation, for what `reset` of any interface returned."""
    if isinstance(result, tuple) and hasattr(result, "observation"):
        return np.concatenate(list(result.observation.values())).astype(np.float32)
    return np.ravel(result[0])


@pytest.mark.parametrize("places, sentence", PLACES, ids=lambda value: str(value)[:40])
def test_impossible_places_are_refused_with_one_sentence(places, sentence):
    refused = set()
    for make in INTERFACES.values():
        refused.add(refusal(make, PILLARS, **places))
        env = make(PILLARS, robot=(0.2, -0.2, 0.5))
        before = observed(env.reset())
        refused.add(refusal(env.reset, options=places))
        np.testing.assert_array_equal(before, observed(env.reset()))
    assert len(refused) == 1, refused
    [(kind, said)] = refused
    assert kind is ValueError and re.match(sentence, said), said


def test_unknown_options_are_refused_with_the_known_ones():
    for make in INTERFACES.values():
        env = make(PILLARS)
        kind, said = refusal(env.reset, options={"colour": "red"})
        assert kind is TypeError
        assert said == "reset takes the options ['robot', 'spot'], got ['colour']"


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding_walls"])
def test_options_place_robot_and_spot_for_one_episode(task):
    option = {"robot": (0.2, -0.1, 1.0), "spot": (0.25, 0.0)}
    seen = []
    for name, make in INTERFACES.items():
        env = make(task, robot=(-0.3, 0.1, 0.0), spot=(-0.2, 0.2))
        first = observed(env.reset())
        seen.append(observed(env.reset(options=option)))
        assert not np.array_equal(first, seen[-1])
        if name == "dm_control":
            np.testing.assert_allclose(env.physics.robot_pose(), option["robot"], atol=1e-12)
            np.testing.assert_allclose(env.physics.spot_position(), option["spot"])
        np.testing.assert_array_equal(first, observed(env.reset()))
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])


def test_a_robot_that_touches_the_wall_may_be_placed(make):
    make("wall_avoidance", robot=(0.525 - 0.0275, 0.0, 0.0)).reset()


ACTIONS = [
    (np.nan, 0.0),
    (0.0, np.inf),
    (-np.inf, 0.0),
    (0.1,),
    (0.1, 0.2, 0.3),
    0.1,
    ((0.1,), (0.2, 0.3)),
    (0.1j, 0.2),
    ("0.1", "0.2"),
    (None, 0.1),
    (True, False),
    None,
]


@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_an_action_that_is_not_two_finite_numbers_is_refused_and_changes_nothing(action):
    for name, make in INTERFACES.items():
        env, twin = (make("wall_avoidance", robot=(0, 0, 0.3)) for _ in range(2))
        env.reset()
        twin.reset()
        kind, said = refusal(env.step, [action] if name == "batch" else action)
        shape = r"\(1, 2\)" if name == "batch" else r"\(2,\)"
        assert kind is ValueError
        assert re.match(
            f"an action must be two finite motor values, real numbers of shape {shape} in all, got",
            said,
        )
        good = np.full((1, 2) if name == "batch" else 2, 0.3)
        np.testing.assert_array_equal(observed(env.step(good)), observed(twin.step(good)))


@pytest.mark.parametrize("kind", [int, float, np.float32, np.float64, np.int8])
def test_real_numbers_of_every_type_are_actions(make, kind):
    env = make("wall_avoidance_unit", robot=(0, 0, 0.3))
    env.reset()
    action = np.array([1, 0]).astype(kind)
    env.step(action[None] if isinstance(env, ArenaVectorEnv) else action)


@pytest.mark.parametrize("limit", [0, -1, np.nan, -np.inf, "3", True, [1.0], 1j])
def test_a_time_limit_that_is_not_positive_is_refused(limit):
    for kwargs in ({"task_kwargs": {"time_limit": limit}},
                   {"environment_kwargs": {"time_limit": limit}}):  # fmt: skip
        with pytest.raises(ValueError, match="time_limit must be a positive number of seconds"):
            musebot.load("arena", "spot_finding", **kwargs)


@pytest.mark.parametrize("steps", [0, -5, np.nan, 1.5, "3", True, -1.0, np.inf])
def test_a_number_of_steps_that_is_not_whole_or_positive_is_refused(steps):
    with pytest.raises(ValueError, match="max_episode_steps, if not -1, must be a whole number of"):
        ArenaVectorEnv("spot_finding", 1, max_episode_steps=steps)
    if steps is True or steps == -1:
        return  # Gymnasium, which counts the steps of a single environment, takes it for a number
    with pytest.raises((ValueError, TypeError)):
        gymnasium.make("musebot/SpotFinding-v0", max_episode_steps=steps)


@pytest.mark.parametrize("number", [0, -1, 1.5, "3", True, None])
def test_a_number_of_robots_or_threads_that_is_not_whole_is_refused(number):
    with pytest.raises(ValueError, match="num_envs must be a whole number of at least 1, got"):
        ArenaVectorEnv("spot_finding", number)
    if number != 0:
        with pytest.raises(ValueError, match="threads must be a whole number of at least 0, got"):
            ArenaVectorEnv("spot_finding", 1, threads=number)


@pytest.mark.parametrize(
    "kwargs, sentence",
    [
        ({"control_timestep": 0.05}, "control_timestep must be 0.1 s, got 0.05"),
        ({"n_sub_steps": 3}, "n_sub_steps must be None, because a control step is 0.1 s, got 3"),
        ({"legacy_step": True}, "legacy_step must be False, as in the batch, got True"),
        ({"flat_observation": "no"}, "flat_observation must be True or False, got 'no'"),
    ],
)
def test_keywords_that_would_change_the_task_are_refused(kwargs, sentence):
    with pytest.raises(ValueError, match=sentence):
        musebot.load("arena", "spot_finding_jumping", environment_kwargs=kwargs)
    musebot.load("arena", "spot_finding", environment_kwargs={"control_timestep": 0.1})


def stepping(env, values=(0.1, 0.1)):
    return env.step(np.array([values] if isinstance(env, ArenaVectorEnv) else values))


def break_physics(env):
    """Makes the next step unstable."""
    if isinstance(env, ArenaVectorEnv):
        env._batch.arrays()["state"][0, 10:] = np.inf
    else:
        env.physics.data.qvel[:] = np.inf


def test_a_step_before_the_first_reset_is_refused_by_gymnasium_and_a_reset_in_dm_control():
    said = [refusal(stepping, INTERFACES[name]("spot_finding")) for name in ("Gymnasium", "batch")]
    assert said == [(RuntimeError, "reset must be called before the first step")] * 2
    assert stepping(INTERFACES["dm_control"]("spot_finding")).first()  # as dm_env requires


def test_a_step_after_a_physics_error_is_refused_until_a_reset(make):
    env = make("spot_finding", robot=(0, 0, 0), spot=(0.2, 0))
    first = observed(env.reset())
    break_physics(env)
    with pytest.raises(PhysicsError):
        stepping(env)
    for _ in range(2):
        said = "reset must be called after a PhysicsError, before the next step"
        assert refusal(stepping, env) == (RuntimeError, said)
        assert refusal(env.get_state) == (RuntimeError, said)
    np.testing.assert_array_equal(first, observed(env.reset()))
    stepping(env)


@pytest.mark.parametrize("where", ["beyond the wall", "in the air", "on its back"])
def test_a_robot_that_is_not_on_the_floor_of_the_arena_is_an_error(make, where):
    env = make("spot_finding", robot=(0, 0, 0))
    env.reset()
    batch = isinstance(env, ArenaVectorEnv)
    qpos = env._batch.arrays()["state"][0, 1:10] if batch else env.physics.data.qpos
    if where == "beyond the wall":
        qpos[0] = 0.6
    elif where == "in the air":
        qpos[2] = 5.0
    else:
        qpos[2:7] = [0.02, 0, 1, 0, 0]
    with pytest.raises(PhysicsError, match="became unstable"):
        stepping(env)


def test_nothing_works_after_close(make):
    env = make("spot_finding")
    env.reset()
    env.close()
    env.close()
    state = make("spot_finding")
    state.reset()
    calls = [lambda: stepping(env), env.get_state, lambda: env.set_state(state.get_state())]
    if hasattr(env, "render"):
        calls.append(env.render)
    if not isinstance(env, ArenaEnv):
        calls.append(env.reset)
    assert {refusal(call) for call in calls} == {(RuntimeError, "the environment is closed")}


def test_gymnasiums_environment_of_one_robot_can_be_reset_after_close():
    env, other = (ArenaEnv("spot_finding", render_mode="rgb_array") for _ in range(2))
    env.reset(seed=1)
    env.close()
    for seen, wanted in zip(env.reset(seed=2), other.reset(seed=2), strict=True):
        np.testing.assert_equal(seen, wanted)
    np.testing.assert_equal(env.step(np.ones(2)), other.step(np.ones(2)))
    env.close()
    assert refusal(env.step, np.zeros(2)) == (RuntimeError, "the environment is closed")
