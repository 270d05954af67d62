"""Every task fulfils the contract of dm_control's suite, and its own rules."""

import dataclasses
import unittest

import numpy as np
import pytest
from absl.testing import absltest
from dm_control import suite
from dm_env import test_utils
from scipy import stats

import musebot
from musebot.models import add_noses, add_obstacles, add_velocity, arena_spec, hide_spot
from musebot.tasks import make_batch
from musebot.tasks.lives import CHANGING, UPPER_LEFT, UPPER_RIGHT
from musebot.tasks.starts import CORNERS, Start, random_poses, random_spots
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


def drive(task, motors, steps=1, **kwargs):
    environment = musebot.load("arena", task, {"random": 0, **kwargs})
    first = environment.reset()
    return environment, [first, *(environment.step(np.asarray(motors)) for _ in range(steps))]


# The contract of dm_control


def test_observations_rewards_and_actions_match_their_specs_and_share_no_memory(task):
    limit = 0.5 if task in musebot.PAPER else 1.0
    episodes = []
    for seed in range(6):
        environment = musebot.load(*task, {"random": seed})
        actions = environment.action_spec()
        assert (actions.shape, actions.name) == ((2,), "motors")
        assert (actions.minimum == -limit).all() and (actions.maximum == limit).all()
        timesteps = play(environment, 100, seed)
        for timestep in timesteps:
            for name, spec in environment.observation_spec().items():
                spec.validate(timestep.observation[name])
                assert spec.name == name and timestep.observation[name].ndim == 1
            if not timestep.first():
                environment.reward_spec().validate(timestep.reward)
        assert not np.shares_memory(*(next(iter(t.observation.values())) for t in timesteps[1:3]))
        episodes.append(flat(timesteps))
    for heading in (0.0, 3.0):  # two more drive straight into a wall
        episodes.append(flat(drive(task[1], np.full(2, 0.5), 80, robot=(0.0, 0.0, heading))[1]))
    assert (np.concatenate(episodes).std(axis=0) > 0).all()  # none is constant


def test_benchmarking_tasks_have_rewards_in_0_to_1_and_1000_steps_of_0_1_s(benchmarking):
    environment = musebot.load(*benchmarking, {"random": 0})
    reward = environment.reward_spec()
    assert (reward.minimum, reward.maximum) == (0.0, 1.0)
    timestep, steps = environment.reset(), 0
    environment.step(np.array([1.0, -0.5]))
    np.testing.assert_array_equal(environment.physics.control(), [0.5, -0.25])
    times = environment.control_timestep(), environment.physics.time()
    assert times == pytest.approx((0.1, 0.1))
    timestep = environment.reset()
    while not timestep.last():
        timestep = environment.step(np.array([0.3, -0.1]))
        steps += 1
    assert steps == 1000
    assert timestep.discount == 1.0  # truncated, not terminated


def test_equal_seeds_give_equal_episodes_and_others_do_not_also_in_dm_controls_suite(
    task, monkeypatch
):
    others = {name: domain for name, domain in suite._DOMAINS.items() if name != "musebot_arena"}
    monkeypatch.setattr(suite, "_DOMAINS", others)
    with pytest.raises(ValueError, match="'musebot_arena' does not exist"):
        suite.load("musebot_arena", task[1])
    musebot.register()
    musebot.register()
    theirs = suite.load("musebot_arena", task[1], task_kwargs={"random": 1})
    first, other = (flat(play(musebot.load(*task, {"random": seed}), 60)) for seed in (1, 2))
    np.testing.assert_array_equal(first, flat(play(theirs, 60)))
    assert not np.array_equal(first, other)
    with pytest.raises(ValueError, match="Level 'dancing' does not exist in domain 'musebot_"):
        suite.load("musebot_arena", "dancing")


def test_visualize_reward_changes_colours_only(task):
    start = {"random": 3, "spot": (0.3, 0.0), "robot": (0.2, 0.0, 0.0)}
    plain, shown = (musebot.load(*task, start, visualize_reward=flag) for flag in (False, True))
    colours = set()
    for environment in (plain, shown):
        environment.reset()
    for _ in range(60):
        first, second = (e.step(e.action_spec().maximum) for e in (plain, shown))
        np.testing.assert_array_equal(flat([first]), flat([second]))
        colours.add(tuple(shown.physics.named.model.mat_rgba["musebot_shell"]))
    assert len(colours) > 1
    untouched = musebot.load(*task)
    shells = [e.physics.named.model.mat_rgba["musebot_shell"].copy() for e in (untouched, plain)]
    np.testing.assert_array_equal(*shells)
    if "nose" in TASKS[task[1]].rules.shapes:  # a picture shows the reward of its own time step
        shown.reset(options={"robot": (-0.4, -0.2, np.pi), "spot": (0.4, 0.2)})  # no smell
        np.testing.assert_array_equal(
            shown.physics.named.model.mat_rgba["musebot_shell"], shells[0]
        )


def test_the_keywords_of_dm_control_work():
    task = ("arena", "spot_finding_walls")
    environment = musebot.load(*task, {"time_limit": 1.0}, {"flat_observation": True})
    timesteps = play(environment, 10)
    assert timesteps[-1].last() and not timesteps[-2].last()
    spec = environment.observation_spec()["observations"]
    for timestep in timesteps:
        spec.validate(timestep.observation["observations"])
    named = musebot.load(*task).observation_spec().values()
    for end in ("minimum", "maximum"):
        ends = [np.full(one.shape, getattr(one, end)) for one in named]
        np.testing.assert_array_equal(getattr(spec, end), np.concatenate(ends))


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("life", CHANGING, ids=lambda life: life.name)
def test_a_changed_world_has_the_specs_of_its_task(life, flat):
    tasks, kwargs = [("life", f"{life.name}@2"), ("arena", life.task)], {"flat_observation": flat}
    changed, usual = (musebot.load(*task, environment_kwargs=kwargs) for task in tasks)
    changed.reset()
    assert changed.task.world != usual.task.world
    assert changed.observation_spec() == usual.observation_spec()
    assert changed.reward_spec() == usual.reward_spec()


def test_actions_beyond_the_limits_are_clipped(task):
    episodes = []
    for times in (1, 6):
        environment = musebot.load(*task, {"random": 0})
        environment.reset()
        action = times * environment.action_spec().maximum
        episodes.append(flat([environment.step(action) for _ in range(5)]))
    np.testing.assert_array_equal(*episodes)


def test_only_a_robot_with_a_nose_has_the_keyword_nose(task):
    for nose in ("inverse", "printed"):
        if "nose" in TASKS[task[1]].keywords:
            assert musebot.load(*task, {"nose": nose}).task.rules.nose.form == nose
        else:
            with pytest.raises(TypeError, match=r"got \['nose'\]"):
                musebot.load(*task, {"nose": nose})


def test_every_element_of_the_model_has_a_name(task):
    model = musebot.load(*task).physics.model.ptr
    for kind in ("body", "jnt", "geom", "site", "cam", "light", "actuator", "sensor", "mat"):
        access = getattr(model, {"jnt": "joint"}.get(kind, kind))
        count = getattr(model, {"actuator": "nu"}.get(kind, f"n{kind}"))
        assert all(access(k).name for k in range(count)), kind
    assert model.ncam >= 2


def test_dm_envs_own_contract_holds(task):
    class Contract(test_utils.EnvironmentTestMixin, absltest.TestCase):
        def make_object_under_test(self):
            return musebot.load(*task, {"random": 0, "time_limit": 2.0})

        def make_action_sequence(self):
            spec = self.environment.action_spec()
            random = np.random.RandomState(0)
            for _ in range(60):
                yield random.uniform(spec.minimum, spec.maximum)

    found = unittest.TestResult()
    unittest.defaultTestLoader.loadTestsFromTestCase(Contract).run(found)
    assert found.testsRun > 3 and found.wasSuccessful(), found.failures + found.errors


# The table of tasks


def test_the_table_of_tasks_is_that_of_the_suite_and_other_names_are_refused():
    assert set(musebot.PAPER) == {("arena", "wall_avoidance"), ("arena", "spot_finding")}
    assert set(musebot.PAPER) | set(musebot.BENCHMARKING) == set(musebot.ALL_TASKS)
    assert musebot.TASKS_BY_DOMAIN == {"arena": tuple(task for _, task in musebot.ALL_TASKS)}
    assert sorted(musebot.SUITE) == sorted(name for _, name in musebot.ALL_TASKS)
    assert {*TASKS} - {*musebot.SUITE} == {"spot_or_driving"}  # of a life
    for name, factory in musebot.SUITE.items():
        definition = TASKS[name]
        assert definition.name == factory.__name__ == name
        assert factory.__doc__ == definition.rules.__doc__
        assert factory(random=1).task.episode.task == name
        spec = arena_spec()
        if name.startswith("wall"):
            hide_spot(spec)
        added = {add_noses, add_obstacles, add_velocity} & set(definition.edits)
        assert (definition.spec().to_xml() == spec.to_xml()) == (not added)
    for names in (("moon", "wall_avoidance"), ("arena", "dancing"), ([], {})):
        with pytest.raises(ValueError, match=r"must be one of \[.*\].*, got "):
            musebot.load(*names)


# Starts


def test_a_start_is_fixed_or_a_corner_of_the_paper_or_drawn_for_every_episode(task):
    assert CORNERS == {"upper_left": UPPER_LEFT, "upper_right": UPPER_RIGHT}
    for robot, spot, pose, centre in (
        ((0.1, 0.2, 1.0), (0.3, 0.2), (0.1, 0.2, 1.0), (0.3, 0.2)),
        ("upper_left", "upper_right", UPPER_LEFT, UPPER_RIGHT[:2]),
    ):
        environment, _ = drive(task[1], np.zeros(2), 0, robot=robot, spot=spot)
        np.testing.assert_allclose(environment.physics.robot_pose(), pose, atol=1e-12)
        np.testing.assert_allclose(environment.physics.spot_position(), centre)
    environment, starts = musebot.load(*task, {"random": 0}), set()
    for _ in range(5):
        environment.reset()
        starts.add((*environment.physics.robot_pose(), *environment.physics.spot_position()))
    assert len({start[:3] for start in starts}) == len({start[3:] for start in starts}) == 5


def test_random_places_are_uniform_up_to_the_walls_and_all_are_clear_of_obstacles():
    size, count = make_batch("spot_finding", 1).dimensions, 5000
    random, clear = np.random.default_rng(0), size.radius + 0.01
    half, spot = np.array([size.half_length, size.half_width]), size.spot_radius
    for places, high in (
        (random_poses(random, size, count), [*(half - clear), np.pi]),
        (random_spots(random, size, count), half - spot),
    ):
        assert places.shape == (count, len(high))
        for column, most in zip(places.T, high, strict=True):
            assert stats.kstest(column, stats.uniform(-most, 2 * most).cdf).pvalue > 0.001
            assert 0.998 * most < np.abs(column).max() <= most
    size = make_batch("wall_avoidance_obstacles", 1).dimensions
    x, y, _ = CORNERS["upper_left"]
    blocked = dataclasses.replace(size, obstacles=((x, y, 0.05),))
    for place in ("upper_left", CORNERS["upper_left"]):  # by name as in numbers
        with pytest.raises(ValueError, match="from the centre of the obstacle"):
            Start(robot=place).check(blocked)
    poses = random_poses(random, size, 2000)
    for x, y, radius in size.obstacles:
        apart = np.hypot(poses[:, 0] - x, poses[:, 1] - y).min()
        assert radius + size.radius + 0.01 <= apart < radius + size.radius + 0.03


# Rules


def observed(timesteps, name):
    return np.array([timestep.observation[name] for timestep in timesteps])


def test_an_obstacle_is_seen_and_touched_and_blocks_the_robot_which_earns_nothing():
    for x, y, radius in make_batch("wall_avoidance_obstacles", 1).dimensions.obstacles:
        start = (x - radius - 0.07, y, 0.0)
        environment, timesteps = drive("wall_avoidance_obstacles", [1.0, 1.0], 20, robot=start)
        ahead = observed(timesteps, "distances")[:, 0]
        assert ahead[0] == pytest.approx((1 + 0.07 - 0.0275) ** -10, rel=1e-6)
        assert (observed(timesteps, "contact")[9:] == -1).all()
        assert (ahead[9:] > 0.97).all()  # at its surface, not inside
        assert all(timestep.reward == 0 for timestep in timesteps[9:])
        rim = np.hypot(*(environment.physics.robot_pose()[:2] - [x, y])) - 0.0275
        assert rim == pytest.approx(radius, abs=0.001)


def test_the_driving_reward_is_the_speed_ahead():
    for left, right in ((1, 1), (0.5, 0.5), (0, 0), (-1, -1), (-1, 1)):
        speed, start = (left + right) / 2, (0.0, 0.25, 0.0)
        _, timesteps = drive("wall_avoidance_obstacles", (left, right), 10, robot=start)
        assert timesteps[-1].reward == pytest.approx(max(speed, 0), abs=0.01)
        assert timesteps[-1].observation["speed"] == pytest.approx(speed, abs=0.01)


def test_the_nose_nearer_to_the_spot_smells_more_and_the_reward_is_the_mean():
    for side in (1, 0, -1):
        start = {"robot": (0.0, 0.0, 0.0), "spot": (0.25, side * 0.04)}
        _, timesteps = drive("spot_finding_two_noses", [0.0, 0.0], **start)
        left, right = timesteps[-1].observation["noses"]
        assert timesteps[-1].reward == pytest.approx((left + right) / 2, abs=1e-12)
        stronger, weaker = max(left, right), min(left, right)
        assert weaker > 0 and (stronger == left) == (side > 0) or side == 0
        assert stronger > 1.2 * weaker if side else left == pytest.approx(right, abs=1e-6)
    _, timesteps = drive("spot_finding_two_noses", [0.0, 0.0], robot=(0, 0, 0), spot=(0.02, 0.0))
    assert timesteps[-1].reward == pytest.approx(10 / 11)  # inside


@pytest.mark.parametrize("name", ["spot_finding_walls", "wall_avoidance_unit"])
def test_the_reward_is_0_in_contact_however_small_the_force(name):
    start = {"robot": (0.45, 0.0, 0.0), "spot": (0.49, 0.0)}
    _, timesteps = drive(name, [1.0, 1.0], 10, **start)
    rewards = np.array([timestep.reward for timestep in timesteps[1:]])
    touched = observed(timesteps[1:], "contact")[:, 0] == -1
    np.testing.assert_array_equal(rewards == 0, touched)
    assert rewards[0] > 0.9 and touched[-1]
    assert "unit" in name or timesteps[-1].observation["nose"][0] > 0.9  # it still signals
    rules, forces = make_batch("wall_avoidance_unit", 1).rules, np.zeros((4, 20))
    forces[:, rules.layout.touch] = [[0.0], [1e-12], [0.049], [1.0]]
    assert rules.event(forces).tolist() == [False, True, True, True]
    assert rules.reward(forces).tolist() == [1, 0, 0, 0]


def test_the_spot_jumps_every_20_seconds_and_rests_in_between():
    environment = musebot.load("arena", "spot_finding_jumping", {"random": 0})
    for _ in range(2):  # two episodes
        environment.reset()
        spots = [tuple(environment.physics.spot_position())]
        for _ in range(1000):
            environment.step(np.zeros(2))
            spots.append(tuple(environment.physics.spot_position()))
        changes = [k for k in range(1, 1001) if spots[k] != spots[k - 1]]
        assert changes == [201, 401, 601, 801]  # at the first action of the 21st second, and so on
        assert len(set(spots)) == 5
