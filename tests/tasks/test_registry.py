"""Tasks of one's own open in every interface."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import musebot
from musebot.gymnasium_registration import EPISODE_STEPS
from musebot.tasks import make_batch, suite
from musebot.tasks.spot_finding import SpotFindingRules
from musebot.tasks.wall_avoidance import WallAvoidanceRules

PAGE = Path(__file__).parents[2] / "docs" / "own-task.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


class Still(WallAvoidanceRules):
    """Rewards nothing but standing still."""


@pytest.fixture
def forgotten():
    """Names of tasks that are forgotten after the test."""
    names = []
    yield names
    for name in names:
        suite.TASKS.pop(name, None)
        for tasks in (musebot.SUITE._tasks, *musebot.SUITE._tags.values()):
            tasks.pop(name, None)
        for identifier, task in [*musebot.GYMNASIUM_TASKS.items()]:
            if task == name:
                del musebot.GYMNASIUM_TASKS[identifier]
                musebot.gymnasium_registration.MODULES.pop(name, None)
                if gymnasium := sys.modules.get("gymnasium"):
                    gymnasium.registry.pop(f"musebot/{identifier}", None)


def test_a_registered_task_opens_in_every_interface(forgotten):
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    forgotten.append("stand_still")
    listed = musebot.ALL_TASKS
    assert musebot.register_task("stand_still", Still, time_limit=2.0) == "musebot/StandStill-v0"
    environment = musebot.load("arena", "stand_still", {"random": 1})
    steps = 0
    timestep = environment.reset()
    while not timestep.last():
        timestep = environment.step(np.zeros(2))
        steps += 1
    assert steps == 20
    one = gymnasium.make("musebot/StandStill-v0")
    many = gymnasium.make_vec("musebot/StandStill-v0", num_envs=2)
    seen, _ = one.reset(seed=3)
    rows, _ = many.reset(seed=3)
    np.testing.assert_array_equal(rows[0], seen)
    for robots in (one, many):
        ends = [np.all(robots.step(robots.action_space.sample())[3]) for _ in range(20)]
        assert ends == [False] * 19 + [True]
    assert type(make_batch("stand_still", 2).rules) is Still
    assert musebot.ALL_TASKS == listed and musebot.SUITE["stand_still"].__doc__ == Still.__doc__


@pytest.mark.parametrize(("limit", "steps"), [(0.25, 3), (3 * 0.1, 3)])
def test_an_episode_has_the_same_length_in_every_interface(limit, steps, forgotten):
    forgotten.append("short")
    musebot.register_task("short", Still, time_limit=limit)
    environment, found = musebot.load("arena", "short", {"random": 1}), 0
    timestep = environment.reset()
    while not timestep.last():
        timestep, found = environment.step(np.zeros(2)), found + 1
    assert found == EPISODE_STEPS["short"] == steps


@pytest.mark.parametrize("limit", [0.3, np.inf])
def test_an_episode_of_stable_baselines_has_that_length_by_every_name(limit, forgotten):
    baselines = pytest.importorskip("musebot.tasks.stable_baselines", reason="needs `baselines`")
    forgotten.append("short")
    musebot.register_task("short", Still, time_limit=limit)
    for name in ("short", "Short-v0", "musebot/Short-v0", "json:short", "json:musebot/Short-v0"):
        robots = baselines.ArenaVecEnv(name, 2)
        robots.reset()
        ends = [bool(robots.step(np.zeros((2, 2)))[2].all()) for _ in range(7)]
        assert ends == [limit < 1 and step % 3 == 2 for step in range(7)], name
    assert baselines.ArenaVecEnv("musebot:musebot/SpotFinding-v0", 2).num_envs == 2


class Raw(WallAvoidanceRules):
    """Gives parts of the measurements themselves."""

    shapes = {**WallAvoidanceRules.shapes, "contact": (1, 0.0, 1e9)}
    rewards = (-1.0, 2.0)

    def observations(self, sensordata):
        own = super().observations(sensordata)
        return own | {"contact": sensordata[..., self.layout.touch]}

    def reward(self, sensordata):
        return sensordata[..., self.layout.distances][..., 0]


def test_what_rules_return_is_not_changed_by_later_steps(forgotten):
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    forgotten.append("raw")
    musebot.register_task("raw", Raw)
    environment = musebot.load("arena", "raw", {"random": 1})
    first = environment.reset().observation["contact"]
    assert not np.shares_memory(first, environment.physics.readings)
    robots = gymnasium.make_vec("musebot/Raw-v0", num_envs=2)
    robots.reset(seed=1)
    rewards = robots.step(np.full((2, 2), 0.5, np.float32))[1]
    before = rewards.copy()
    robots.step(np.full((2, 2), 0.5, np.float32))
    np.testing.assert_array_equal(rewards, before)


def renamed(spec):
    """Exchanges the names of two rangefinders."""
    left, right = spec.sensor("left"), spec.sensor("right")
    left.name, right.name = "other", "left"
    left.name = "right"


def divided(spec):
    """Adds a wall of which the distance of robots is measured as of a wide cylinder."""
    body = spec.worldbody.add_body(name="obstacle_wall")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.7, 0.01, 0.025])


class Longer(WallAvoidanceRules):
    """Returns an observation that it does not declare."""

    def observations(self, sensordata):
        return super().observations(sensordata) | {"bias": np.ones((*sensordata.shape[:-1], 1))}


class Blind(WallAvoidanceRules):
    """Returns observations beyond their range."""

    def observations(self, sensordata):
        own = super().observations(sensordata)
        return own | {"distances": own["distances"] * np.nan}


class Bare(WallAvoidanceRules):
    """Returns an array of observations."""

    def observations(self, sensordata):
        return sensordata[..., self.layout.distances]


class Swapped(WallAvoidanceRules):
    """Returns observations in another order."""

    def observations(self, sensordata):
        return dict(reversed(super().observations(sensordata).items()))


class Declared(WallAvoidanceRules):
    """Declares no range of the reward."""

    rewards = (0.0, -1.0)


def rewarded(change):
    """Returns rules whose reward is changed."""

    class Changed(WallAvoidanceRules):
        def reward(self, sensordata):
            return change(super().reward(sensordata))

    return Changed


REWARDS = {
    "NaN": lambda reward: reward * np.nan,
    "infinite": lambda reward: reward - np.inf,
    "text": lambda reward: reward.astype(str),
    "an object": lambda reward: reward.astype(object),
    "complex": lambda reward: reward + 0j,
    "below its range": lambda reward: reward - 1.5,
    "above its range": lambda reward: reward + 2.5,
    "a column": lambda reward: reward[..., None],
    "one number": lambda reward: 0.0,
    "nothing": lambda reward: None,
}


class First(WallAvoidanceRules):
    """Returns the event of the first robot only."""

    def event(self, sensordata):
        return super().event(sensordata).ravel()[0]


@pytest.mark.parametrize(
    ("name", "rules", "settings", "error", "words"),
    [
        ("Mine", Still, {}, ValueError, "lower case with underscores, got 'Mine'"),
        ("spot_finding", Still, {}, ValueError, "there is a task 'spot_finding' in the suite"),
        ("mine", Still(None), {}, TypeError, "rules must be a subclass of musebot.tasks.rules"),
        ("mine", Still, {"colour": 1}, TypeError, "colour"),
        (None, Still, {}, ValueError, "lower case with underscores, got None"),
        *[("mine", Still, {name: value}, ValueError, f"{name} must be a number from .*, got ")
          for name, values in {
              "limit": (0, -1, np.nan, np.inf, None, "1", True),
              "time_limit": (0, 0.04, np.nan, None, "1"),
              "spot_seconds": (-1, 1e308, np.nan, np.inf, None, "1")}.items()
          for value in values],
        *[("mine", Still, {"model": value}, ValueError, "model must be an MJCF file, got ")
          for value in ("none.xml", "/nowhere", "/", None, 5, "x\0")],
        *[("mine", Still, {"edits": value}, ValueError, "edits must be functions")
          for value in (None, 5, (None,))],
        *[("mine", Still, {"edits": (lambda spec, t=t: setattr(spec.option, "timestep", t),)},
           ValueError, "the timestep must divide 0.1 s, into at most 10000 steps, got ")
          for t in (0, -0.01, 0.003, 1e-300, np.nan, 0.2)],
        *[("mine", rewarded(change), {}, ValueError, "the reward of Changed must be numbers from -1"
           " to 0 of shape .*, got ") for change in REWARDS.values()],
        ("mine", Declared, {}, ValueError, "Declared must declare shapes"),
        ("mine", Still, {"edits": (lambda spec: spec.delete(spec.sensor("touch")),)},
         KeyError, "touch"),
        ("mine", Still, {"edits": (lambda spec: spec.delete(spec.sensor("back")),)},
         KeyError, "back"),
        ("mine", Still, {"edits": (renamed,)},
         ValueError, "the sensors front, back, left, right must follow each other in this order"),
        ("mine", Still, {"edits": (lambda spec: spec.delete(spec.camera("overhead")),)},
         ValueError, "the arena must have a camera 'overhead', got none"),
        ("mine", Still, {"spot_seconds": 0.25}, ValueError, "spot_seconds must be a multiple of"),
        ("mine", Still, {"edits": (lambda spec: spec.delete(spec.geom("north")),)},
         ValueError, "the arena must have a geom 'north', got none"),
        ("mine", Still, {"edits": (lambda spec: spec.body("spot").add_joint(name="slide"),)},
         ValueError, "mocap body"),
        ("mine", Still, {"edits": (lambda spec: spec.worldbody.add_body(mass=1, inertia=[1, 1, 1])
                                   .add_joint(name="ball"),)},
         ValueError, "free joint and two wheels, got .*'ball'"),
        ("mine", Still, {"edits": (lambda spec: spec.delete(spec.actuator("left_motor")),)},
         ValueError, r"left_motor and right_motor, got \['right_motor'\]"),
        ("mine", Still, {"edits": (lambda spec: setattr(spec.body("spot"), "mocap", False),)},
         ValueError, "the body 'spot' must be the arena's only mocap body"),
        ("mine", Still, {"edits": (lambda spec: setattr(
            spec.body("left_wheel").joints[0], "type", mujoco.mjtJoint.mjJNT_SLIDE),)},
         ValueError, "the body 'left_wheel' must have one joint, a hinge"),
        ("mine", Still, {"edits": (lambda spec: setattr(
            spec.actuator("left_motor"), "target", spec.body("right_wheel").joints[0].name),)},
         ValueError, "left_motor must drive the joint of the body 'left_wheel'"),
        ("mine", Still, {"edits": (lambda spec: spec.actuator("right_motor").gear.fill(-0.02),)},
         ValueError, "the gear of right_motor must be positive, got -0.02"),
        ("mine", Still, {"edits": (divided,)}, ValueError, "the obstacles leave no room"),
        ("mine", Longer, {}, ValueError, r"'bias': \(2, 1\)"),
        ("mine", Blind, {}, ValueError, "distances must be numbers from 0 to 1, got array"),
        ("mine", Bare, {}, ValueError, "observations must be a dict, got array"),
        ("mine", Swapped, {}, ValueError, "observations must have the shapes"),
        ("mine", First, {}, ValueError, r"event must have the shape \(2,\), got \(\)"),
    ],
)  # fmt: skip
def test_a_wrong_task_is_refused_and_nothing_is_registered(name, rules, settings, error, words):
    before = [*suite.TASKS], [*musebot.SUITE], dict(musebot.GYMNASIUM_TASKS)
    with pytest.raises(error, match=words):
        musebot.register_task(name, rules, **settings)
    assert ([*suite.TASKS], [*musebot.SUITE], dict(musebot.GYMNASIUM_TASKS)) == before


@pytest.mark.parametrize("what", REWARDS)
def test_a_reward_that_is_not_as_declared_is_refused_in_the_step_that_gives_it(what, forgotten):
    """Rules may change after the registration, or return other rewards than in its probe."""
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    forgotten.append("changing")
    rules = rewarded(lambda reward: change(reward))
    change = np.copy
    musebot.register_task("changing", rules)
    one = gymnasium.make("musebot/Changing-v0", disable_env_checker=True)
    many = gymnasium.make_vec("musebot/Changing-v0", num_envs=2)
    for env in (one, many):
        change = np.copy
        env.reset(seed=1)
        still = np.zeros(env.action_space.shape, np.float32)
        env.step(still)
        change = REWARDS[what]
        with pytest.raises(ValueError, match="the reward of Changed must be numbers from -1 to 0"):
            env.step(still)


def test_a_name_whose_gymnasium_id_is_taken_is_refused(forgotten):
    forgotten.append("still_1")
    musebot.register_task("still_1", Still)
    with pytest.raises(ValueError, match="musebot/Still1-v0 is that of 'still_1'"):
        musebot.register_task("still1", Still)
    assert "still1" not in suite.TASKS


def test_a_task_registered_again_replaces_the_former_one(forgotten):
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    forgotten.append("changing")
    musebot.register_task("changing", Still, time_limit=2.0)
    assert musebot.register_task("changing", Paid, time_limit=3.0) == "musebot/Changing-v0"
    assert gymnasium.spec("musebot/Changing-v0").max_episode_steps == 30
    assert type(make_batch("changing", 1).rules) is Paid
    assert type(musebot.load("arena", "changing").task.rules) is Paid
    assert gymnasium.make("musebot/Changing-v0").observation_space.shape == (1,)
    assert musebot.SUITE["changing"].__doc__ == Paid.__doc__


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (":racing", "task must be NAME or MODULE:NAME, got ':racing'"),
        (".tasks:racing", "task must be NAME or MODULE:NAME, got '.tasks:racing'"),
        ("json:racing", "the module json registers no task 'racing'"),
    ],
)
def test_a_module_that_registers_no_such_task_is_refused(task, words):
    gymnasium_env = pytest.importorskip("musebot.tasks.gymnasium_env")
    with pytest.raises(ValueError, match=words):
        gymnasium_env.ArenaEnv(task)


@pytest.mark.parametrize("module", ["__main__", None])
def test_processes_import_only_modules_that_register_the_task(module, forgotten, monkeypatch):
    """A module of the suite does not, and the main program has another name there."""
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    forgotten.append("night")
    musebot.register_task("night", Still)
    known = gymnasium.spec("musebot/Night-v0").kwargs["task"]
    assert known == f"{Still.__module__}:night"
    if module:
        monkeypatch.setattr(Still, "__module__", module)
    musebot.register_task("night", Still if module else WallAvoidanceRules)
    assert gymnasium.spec("musebot/Night-v0").kwargs["task"] == "night"


_SPAWNED = """
import gymnasium

if __name__ == "__main__":
    import my_tasks  # not in the processes that are started

    robots = gymnasium.make_vec(
        "musebot/Racing-v0", 2, vectorization_mode="async", vector_kwargs={"context": "spawn"}
    )
    print(robots.reset(seed=1)[0].shape)
    robots.close()
"""


@pytest.mark.slow
def test_a_process_that_is_started_anew_knows_the_task(tmp_path):
    pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    (tmp_path / "my_tasks.py").write_text(EXAMPLES[0])
    (tmp_path / "use.py").write_text(_SPAWNED)
    done = subprocess.run(
        [sys.executable, "use.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "(2, 5)\n"


_BASELINES = """
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor
from musebot.tasks.stable_baselines import ArenaVecEnv

assert type(PPO("MlpPolicy", "musebot/Racing-v0", n_steps=8, batch_size=8).learn(8)) is PPO
robots = VecMonitor(ArenaVecEnv("musebot/Racing-v0", 2, max_episode_steps=4))
assert len(PPO("MlpPolicy", robots, n_steps=8, batch_size=8).learn(16).ep_info_buffer) == 4
"""


@pytest.mark.slow
def test_the_example_of_the_page_runs(tmp_path):
    pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    module, use = EXAMPLES
    # The pillar stops a robot that drives at it, and earns nothing.
    use += (
        'env = musebot.load("arena", "racing", {"robot": (-0.3, 0.0, 0.0)})\n'
        "env.reset()\n"
        "for _ in range(30): timestep = env.step(np.ones(2))\n"
        "x, y, _ = env.physics.robot_pose()\n"
        "assert timestep.reward == 0 and abs(np.hypot(x, y) - 0.1075) < 0.002, (x, y)\n"
    )
    if importlib.util.find_spec("stable_baselines3"):
        use += _BASELINES
    (tmp_path / "my_tasks.py").write_text(module)
    done = subprocess.run(
        [sys.executable, "-c", use], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("(")[1:] == ["5,) ", "8, 5) ", "8,) 1000\n"]
    assert 0 <= float(done.stdout.split()[0]) <= 1


class Paid(SpotFindingRules):
    """Spot finding with another reward."""

    rewards = (-7.0, -6.0)

    def reward(self, sensordata):
        return super().reward(sensordata) - 7


def test_another_reward_does_not_change_what_the_robot_smells():
    batch = make_batch("spot_finding", 2)
    ours, paid = (rules.of(batch.model) for rules in (SpotFindingRules, Paid))
    smell = batch.sensordata
    np.testing.assert_array_equal(paid.state(smell), ours.state(smell))
    np.testing.assert_array_equal(paid.reward(smell), ours.reward(smell) - 7)


def test_an_obstacles_geom_may_have_any_name(forgotten):
    def block(spec):
        body = spec.worldbody.add_body(name="obstacle_9", pos=[0.2, 0.1, 0])
        for name, radius in (("knob", 0.01), ("block", 0.04)):
            kind = mujoco.mjtGeom.mjGEOM_CYLINDER
            body.add_geom(name=name, type=kind, size=[radius, 0.03, 0])

    forgotten.append("one_block")
    musebot.register_task("one_block", Still, edits=(block,))
    assert make_batch("one_block", 1).dimensions.obstacles == ((0.2, 0.1, 0.04),)


@pytest.mark.parametrize("nested", [False, True])
def test_an_obstacle_that_is_not_where_its_body_is_is_refused(nested):
    def block(spec):
        body = spec.worldbody.add_body(name="outer" if nested else "obstacle_9", pos=[0.2, 0.1, 0])
        if nested:
            body = body.add_body(name="obstacle_9", pos=[0.1, 0, 0])
        size, place = [0.04, 0.03, 0], [0, 0, 0.03] if nested else [0.1, 0, 0.03]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size, pos=place)

    with pytest.raises(ValueError, match="'obstacle_9' must be a body of the world whose largest"):
        musebot.register_task("moved_block", Still, edits=(block,))
    assert "moved_block" not in suite.TASKS


def test_the_reward_is_shown_by_robots_with_a_shell_only(forgotten):
    def bare(spec):
        for one in [*spec.geoms, *spec.sites]:
            one.material = ""
        for material in list(spec.materials):
            spec.delete(material)

    forgotten.append("bare")
    musebot.register_task("bare", Still, edits=(bare,))
    musebot.load("arena", "bare").reset()
    with pytest.raises(ValueError, match="needs a robot with the material 'musebot_shell'"):
        musebot.load("arena", "bare", visualize_reward=True)


def test_an_obstacle_without_a_geom_is_refused():
    def nothing(spec):
        spec.worldbody.add_body(name="obstacle_9", pos=[0.2, 0.1, 0])

    with pytest.raises(ValueError, match="the obstacle 'obstacle_9' has no geom"):
        musebot.register_task("no_block", Still, edits=(nothing,))
    assert "no_block" not in suite.TASKS
