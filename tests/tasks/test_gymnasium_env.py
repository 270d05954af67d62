"""The Gymnasium environments fulfil its contract, and the batch equals single environments."""

import contextlib
import subprocess
import sys
import warnings

import mujoco
import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import SyncVectorEnv  # noqa: E402

import musebot  # noqa: E402
from musebot.tasks.gymnasium_env import INFO  # noqa: E402
from musebot.tasks.suite import SUITE, TASKS  # noqa: E402

IDS = [f"musebot/{name}" for name in musebot.GYMNASIUM_TASKS]
PAPER_IDS = [i for i in IDS if ("arena", gymnasium.spec(i).kwargs["task"]) in musebot.PAPER]


@pytest.fixture(params=IDS)
def name(request):
    return request.param


def test_every_task_has_one_id():
    assert sorted(musebot.GYMNASIUM_TASKS.values()) == sorted(SUITE)
    assert all(gymnasium.spec(i).max_episode_steps == 1000 for i in IDS)


def test_gymnasium_finds_the_tasks_after_musebot_is_imported():
    for imports in ("import gymnasium, musebot", "import musebot, gymnasium", "import gymnasium"):
        prefix = "" if "musebot" in imports else "musebot:"
        code = f"{imports}; print(gymnasium.make('{prefix}musebot/SpotFinding-v0').spec.id)"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.stdout == "musebot/SpotFinding-v0\n", done.stderr


def test_the_checkers_warn_of_the_papers_action_limits_only(name):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gymnasium.make(name).unwrapped, skip_render_check=True)
        assert not caught
        with contextlib.suppress(ImportError):
            from stable_baselines3.common import env_checker

            env_checker.check_env(gymnasium.make(name).unwrapped)
    said = ["symmetric and normalized Box action space" in str(one.message) for one in caught]
    assert said == ([True] if name in PAPER_IDS and said else [])


def test_the_single_env_equals_dm_controls_and_info_holds_the_state_of_the_world(name):
    task = gymnasium.spec(name).kwargs["task"]
    places = {"robot": (0.4, 0.2, 0.3), "spot": (0.47, 0.24)}
    env, twin = gymnasium.make(name, **places).unwrapped, musebot.load("arena", task, places)
    observation, info = env.reset(seed=0)
    timestep = twin.reset()
    assert list(info) == list(INFO)
    assert not info["contact"] and info["contact_steps"] == info["in_spot_steps"] == 0
    counts = np.zeros(2)
    for _ in range(60):
        np.testing.assert_array_equal(
            observation, np.concatenate(list(timestep.observation.values())).astype(np.float32)
        )
        observation, reward, _, _, info = env.step(env.action_space.high)
        timestep = twin.step(env.action_space.high)
        assert reward == timestep.reward
        x, y, heading = twin.physics.robot_pose()
        assert (*info["position"], info["heading"]) == (x, y, heading)
        np.testing.assert_array_equal(info["spot"], twin.physics.spot_position())
        counts += info["contact"], info["in_spot"]
        assert (info["contact_steps"], info["in_spot_steps"]) == tuple(counts)
    assert (counts > 0).all()
    assert env.model is env.physics.model.ptr and env.data.qpos[0] == x
    written = mujoco.MjModel.from_xml_string(TASKS[task].spec().to_xml())
    assert written.signature == env.model.signature


def make_pair(name, robots, mode, **kwargs):
    batch = gymnasium.make_vec(name, robots, autoreset_mode=mode, threads=2, **kwargs)
    kwargs |= {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    single = gymnasium.make_vec(name, robots, **kwargs)
    assert isinstance(single, SyncVectorEnv) and not isinstance(batch, SyncVectorEnv)
    return batch, single


def assert_same(ours, theirs):
    assert getattr(ours, "dtype", None) == getattr(theirs, "dtype", None)
    np.testing.assert_array_equal(ours, theirs)


def assert_same_info(ours, theirs):
    assert ours.keys() == theirs.keys()
    for name, mine in ours.items():
        if isinstance(mine, dict):
            assert_same_info(mine, theirs[name])
        elif mine.dtype == object:
            for one, other in zip(mine, theirs[name], strict=True):
                assert_same(one, other)
        else:
            assert_same(mine, theirs[name])


@pytest.mark.parametrize(
    ("name", "mode"),
    [*((name, "NextStep") for name in IDS), ("musebot/SpotFinding-v0", "SameStep")],
)
def test_the_batch_equals_single_envs_bit_exactly_with_autoreset(name, mode):
    jumps = TASKS[gymnasium.spec(name).kwargs["task"]].spot_steps
    length = jumps + 30  # control steps of an episode
    kwargs = {"max_episode_steps": length}
    if name == "musebot/SpotFinding-v0":
        kwargs |= {"spot": (0.1, -0.2), "nose": "printed"}
    batch, single = make_pair(name, 5, mode, **kwargs)
    assert batch.metadata["autoreset_mode"] == single.metadata["autoreset_mode"]
    assert batch.observation_space == single.observation_space
    assert batch.action_space == single.action_space
    random, ends = np.random.default_rng(0), 0
    for seed, episodes in ((7, 1), ([3, None, 1, 4, 1], 2)):
        (first, info), (their_first, their_info) = (e.reset(seed=seed) for e in (batch, single))
        assert_same(first, their_first)
        assert_same_info(info, their_info)
        for step in range(episodes * length + 10):
            if step % 40 < 25:  # long straight drives into walls, some beyond the limits
                actions = np.tile(random.uniform(0.5, 1.2, (5, 1)), 2).astype(np.float32)
            else:
                actions = random.uniform(-1.2, 1.2, (5, 2)).astype(np.float32)
            ours, theirs = batch.step(actions), single.step(actions)
            for mine, its in zip(ours[:4], theirs[:4], strict=True):
                assert_same(mine, its)
            assert_same_info(ours[4], theirs[4])
            ends += ours[3].sum()
    assert ends == 3 * 5
    assert len(set(batch.np_random_seed)) == 4  # seed 1 is given twice
    assert batch.np_random_seed == single.np_random_seed


def test_unknown_names_and_keywords_are_refused_with_the_known_ones():
    with pytest.raises(gymnasium.error.NameNotFound, match="Dancing"):
        gymnasium.make("musebot/Dancing-v0")
    with pytest.raises(gymnasium.error.VersionNotFound, match="v9.*v0"):
        gymnasium.make("musebot/WallAvoidance-v9")
    for make in (gymnasium.make, gymnasium.make_vec):
        for kwargs, sentence in (
            ({"camera": "moon"}, r"camera must be one of \['overhead', .*\], got 'moon'"),
            ({"width": 0}, "width must be a whole number of at least 1, got 0"),
            ({"height": 1.5}, "height must be a whole number of at least 1, got 1.5"),
        ):
            with pytest.raises(ValueError, match=sentence):
                make("musebot/SpotFinding-v0", render_mode="rgb_array", **kwargs)
        with pytest.raises(TypeError, match=r"\['camera', 'height', 'robot'.*\], got \['nose'\]"):
            make("musebot/WallAvoidance-v0", nose="printed")
        for name in ("colour", "camera_name", "camera_id"):  # the last two are Gymnasium's
            words = rf"\['camera', 'height', 'nose', 'robot', 'spot', 'width'\], got \['{name}'\]"
            with pytest.raises(TypeError, match=words):
                make("musebot/SpotFinding-v0", **{name: 0})
        with pytest.raises(ValueError, match="form must be 'inverse' or 'printed'"):
            make("musebot/SpotFinding-v0", nose="long")
    with pytest.raises(ValueError, match=r"must be one of \['rgb_array'\] or None, got 'human'"):
        gymnasium.make_vec("musebot/WallAvoidance-v0", render_mode="human")
    with pytest.raises(ValueError, match="'Never' is not a valid AutoresetMode"):
        gymnasium.make_vec("musebot/WallAvoidance-v0", autoreset_mode="Never")
    batch = gymnasium.make_vec("musebot/WallAvoidance-v0", 3)
    with pytest.raises(ValueError, match="there must be 3 seeds, got 2"):
        batch.reset(seed=[1, 2])


def test_the_batch_without_autoreset_equals_single_envs_bit_exactly():
    name = "musebot/SpotFindingJumping-v0"
    batch, single = make_pair(name, 3, "Disabled", max_episode_steps=7)
    assert_same(batch.reset(seed=5)[0], single.reset(seed=5)[0])
    random, ended = np.random.default_rng(0), 0
    for step in range(40):
        actions = random.uniform(-1, 1, (3, 2)).astype(np.float32)
        ours, theirs = batch.step(actions), single.step(actions)
        for mine, its in zip(ours[:4], theirs[:4], strict=True):
            assert_same(mine, its)
        assert_same_info(ours[4], theirs[4])
        mask = ours[3].copy()
        mask[step % 3] |= step == 4  # so that episodes end at different times
        if mask.any():
            ended += mask.sum()
            seeds = [None, 3, None] if step == 4 else None
            options = {"reset_mask": mask, "robot": (0.1, 0.0, 0.2)}
            (first, info), (their_first, their_info) = (
                e.reset(seed=seeds, options=dict(options)) for e in (batch, single)
            )
            assert_same(first, their_first)
            assert_same_info(info, their_info)
            assert options.keys() == {"reset_mask", "robot"}
    assert ended > 10


def test_without_autoreset_a_robot_whose_episode_has_ended_must_be_reset():
    batch = gymnasium.make_vec(
        "musebot/SpotFinding-v0", 3, autoreset_mode="Disabled", max_episode_steps=2
    )
    everyone, actions = np.ones(3, dtype=bool), np.zeros((3, 2), np.float32)
    with pytest.raises(ValueError, match="reset_mask must be True for all robots before an episod"):
        batch.reset(options={"reset_mask": np.array([True, False, True])})
    batch.reset(seed=1, options={"reset_mask": everyone})
    batch.step(actions)
    batch.reset(options={"reset_mask": np.array([False, True, False])})
    batch.step(actions)
    with pytest.raises(RuntimeError, match=r"reset_mask of the robots \[0, 2\], whose episodes"):
        batch.step(actions)
    for mask in (everyone[:2], ~everyone, np.ones(3), [True] * 3, True):
        with pytest.raises(ValueError, match="reset_mask must be an array of 3 Booleans, one of"):
            batch.reset(options={"reset_mask": mask})
    batch.reset(options={"reset_mask": np.array([True, False, True])})
    batch.step(actions)


def test_a_batch_renders_chosen_robots(monkeypatch):
    batch = gymnasium.make_vec(
        "musebot/SpotFinding-v0", 4, render_mode="rgb_array", camera="follow", width=96, height=64
    )
    shown = []

    def render(physics, height, width, camera_id):
        shown.append((height, width, camera_id, *physics.robot_pose(), *physics.spot_position()))
        return np.full((height, width, 3), len(shown), np.uint8)

    monkeypatch.setattr("musebot.models.physics.Physics.render", render)
    _, info = batch.reset(seed=0)
    pictures = batch.render(robots=[2, 0])
    assert [picture.shape for picture in pictures] == [(64, 96, 3)] * 2
    for robot, (height, width, camera, *places) in zip((2, 0), shown, strict=True):
        assert (height, width, camera) == (64, 96, "follow")
        state = (*info["position"][robot], info["heading"][robot], *info["spot"][robot])
        np.testing.assert_allclose(places, state, atol=1e-12)
    assert len(batch.render()) == 4
    for robot in (4, -1):
        with pytest.raises(IndexError, match=rf"robot must lie in \[0, 3\], got {robot}"):
            batch.render(robots=[robot])
    assert gymnasium.make_vec("musebot/SpotFinding-v0", 2).render() is None
    batch.close()


def test_attributes_of_a_batch_are_those_of_single_envs():
    batch, single = make_pair("musebot/SpotFinding-v0", 3, "NextStep", max_episode_steps=3)
    for one in (batch, single):
        one.reset(seed=4)
    for name in ("np_random_seed", "render_mode", "action_space"):
        assert batch.get_attr(name) == single.get_attr(name)
    for _ in range(9):
        ours, theirs = (one.step(np.full((3, 2), 0.1, np.float32)) for one in (batch, single))
        assert_same(ours[0], theirs[0])
    assert_same_info(ours[4], theirs[4])
    np.testing.assert_array_equal(batch.get_attr("position"), ours[4]["position"])
    assert batch.get_attr("spec")[0].id == single.get_attr("spec")[0].id
    assert batch.get_attr("model")[0].nu == 2
    with pytest.raises(AttributeError, match=r"robots of a batch have \[.*\], got 'colour'"):
        batch.get_attr("colour")
