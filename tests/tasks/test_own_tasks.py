"""Tasks of one's own open in every interface."""

import importlib.util
import itertools
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

import musebot
from musebot import gymnasium_registration as registration
from musebot.models import Kinematics, add_velocity, hide_spot
from musebot.tasks import make_batch, make_kinematic_batch, suite
from musebot.tasks.lives import LIVES, Life, Phase
from musebot.tasks.spot_finding import SpotFindingRules
from musebot.tasks.tensors.robots import KinematicTensors
from musebot.tasks.wall_avoidance import DrivingRules, WallAvoidanceRules

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")

PAGE = Path(__file__).parents[2] / "docs" / "own.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


class Still(WallAvoidanceRules):
    """Rewards nothing but standing still."""


@pytest.fixture(autouse=True)
def forgotten():
    """Forgets, after each test, the tasks that it has registered."""
    tables = [suite.TASKS, musebot.SUITE._tasks, *musebot.SUITE._tags.values(), gymnasium.registry]
    tables += [musebot.GYMNASIUM_TASKS, registration.MODULES, registration.EPISODE_STEPS]
    before = [dict(table) for table in tables]
    yield
    for table, held in zip(tables, before, strict=True):
        table.clear()
        table.update(held)


@pytest.mark.parametrize(("limit", "steps"), [(0.25, 3), (3 * 0.1, 3), (2.0, 20), (np.inf, None)])
def test_a_task_opens_by_every_name_in_every_interface_with_episodes_of_one_length(limit, steps):
    listed = musebot.ALL_TASKS
    identifier = musebot.register_task("stand_still", Still, time_limit=limit)
    assert (
        identifier == "musebot/StandStill-v0" and registration.EPISODE_STEPS["stand_still"] == steps
    )
    environment = musebot.load("arena", "stand_still", {"random": 1})
    environment.reset()
    one, many = gymnasium.make(identifier), gymnasium.make_vec(identifier, num_envs=2)
    seen, _ = one.reset(seed=3)
    np.testing.assert_array_equal(many.reset(seed=3)[0][0], seen)
    takes = [lambda: environment.step(np.zeros(2)).last()]
    takes += [lambda e=e: np.all(e.step(np.zeros(e.action_space.shape))[3]) for e in (one, many)]
    if importlib.util.find_spec("stable_baselines3"):
        from musebot.tasks.stable_baselines import ArenaVecEnv

        own = f"{Still.__module__}:stand_still"
        for name in ("stand_still", "StandStill-v0", identifier, f"json:{identifier}", own):
            robots = ArenaVecEnv(name, 2)
            robots.reset()
            takes.append(lambda robots=robots: robots.step(np.zeros((2, 2)))[2].all())
        assert ArenaVecEnv("musebot:musebot/SpotFinding-v0", 2).num_envs == 2
    for take in takes:
        ends = [bool(take()) for _ in range(steps or 30)]
        assert ends == [step + 1 == steps for step in range(len(ends))]
    assert type(make_batch("stand_still", 2).rules) is Still
    assert musebot.ALL_TASKS == listed and musebot.SUITE["stand_still"].__doc__ == Still.__doc__


class Paid(SpotFindingRules):
    """Spot finding with another reward."""

    rewards = (-7.0, -6.0)

    def reward(self, sensordata):
        return super().reward(sensordata) - 7


def test_a_large_reward_is_shown_by_a_colour():
    musebot.register_task("paid", Paid)
    environment = musebot.load("arena", "paid", {"random": 1}, visualize_reward=True)
    environment.reset()
    colour = environment.physics.named.model.mat_rgba["musebot_shell"]
    assert 0 <= min(colour) and max(colour) <= 1


class Raw(WallAvoidanceRules):
    """Gives parts of the measurements themselves."""

    shapes = {**WallAvoidanceRules.shapes, "contact": (1, 0.0, 1e9)}
    rewards = (-1.0, 2.0)

    def observations(self, sensordata):
        own = super().observations(sensordata)
        return own | {"contact": sensordata[..., self.layout.touch]}

    def reward(self, sensordata):
        return sensordata[..., self.layout.distances][..., 0]


def test_what_rules_return_is_not_changed_by_later_steps():
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


def test_a_reward_for_speed_is_the_speed_in_every_simulator():
    musebot.register_task("speeding", DrivingRules, edits=(hide_spot, add_velocity))
    mine, other = (make_kinematic_batch("speeding", 2, Kinematics()) for _ in range(2))
    motors, tensors = np.array([(0.5, 0.5), (0.2, 0.2)]), KinematicTensors(other)
    for robots in (make_batch("speeding", 2), mine, tensors):
        for _ in range(20):
            robots.step(motors if robots is not tensors else torch.from_numpy(motors))
        np.testing.assert_allclose(robots.rules.reward(robots.sensordata), [1, 0.4], atol=0.01)


def renamed(spec):
    """Exchanges the names of two rangefinders."""
    left, right = spec.sensor("left"), spec.sensor("right")
    left.name, right.name = "other", "left"
    left.name = "right"


def divided(spec):
    """Adds a wall of which the distance of robots is measured as of a wide cylinder."""
    body = spec.worldbody.add_body(name="obstacle_wall")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.7, 0.01, 0.025])


def changed(**changes):
    """Returns rules whose methods' results are changed, by the methods' names."""

    def method(name, change):
        return lambda self, sensed: change(getattr(WallAvoidanceRules, name)(self, sensed))

    own = {name: method(name, change) for name, change in changes.items()}
    return type("Changed", (WallAvoidanceRules,), own)


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


def edited(*edits):
    return {"edits": edits}


def block(name, place, nested=False, geom=True):
    """Returns an edit that adds an obstacle, of which the geom is somewhere in its body."""

    def edit(spec):
        body = spec.worldbody.add_body(name="outer" if nested else name, pos=[0.2, 0.1, 0])
        if nested:
            body = body.add_body(name=name, pos=[0.1, 0, 0])
        if geom:
            kind = mujoco.mjtGeom.mjGEOM_CYLINDER
            body.add_geom(name="knob", type=kind, size=[0.01, 0.03, 0])
            body.add_geom(name="block", type=kind, size=[0.04, 0.03, 0], pos=place)

    return edit


def slid(spec):
    spec.body("left_wheel").joints[0].type = mujoco.mjtJoint.mjJNT_SLIDE


def crossed(spec):
    spec.actuator("left_motor").target = spec.body("right_wheel").joints[0].name


MOVED = "the obstacle 'obstacle_9' must be a body of the world whose largest geom is at its centre"
WRONG = [
    ("Mine", Still, {}, "lower case with underscores, got 'Mine'"),
    (None, Still, {}, "lower case with underscores, got None"),
    *[(name, Still, {}, f"there is a task or life {name!r} in musebot already")
      for name in {*suite.TASKS, *LIVES, "life"}],
    ("mine", Still(None), {}, "rules must be a subclass of musebot.tasks.rules"),
    *[("mine", Still, {name: "body"}, f"register_task takes .* got \\['{name}'\\]")
      for name in ("colour", "life")],
    ("mine", Still, {"limit": 0}, r"limit must be a number in .*, got 0"),
    ("mine", Still, {"time_limit": -1}, r"time_limit must be a number in .*, got -1"),
    *[("mine", Still, {"model": value}, "model must be an MJCF file, got ")
      for value in ("none.xml", "/nowhere", "/", None, 5, "x\0")],
    *[("mine", Still, {"edits": value}, "edits must be a tuple of functions")
      for value in (None, 5, (None,))],
    *[("mine", Still, edited(lambda spec, t=t: setattr(spec.option, "timestep", t)),
       "the timestep must divide 0.1 s, into at most 10000 steps, got ")
      for t in (0, -0.01, 0.003, 1e-300, 1e-320, np.nan, 0.2)],
    *[("mine", changed(reward=change), {}, "the reward of Changed must be numbers from -1")
      for change in REWARDS.values()],
    ("mine", type("Bare", (WallAvoidanceRules,), {"rewards": (0.0, -1.0)}), {},
     "Bare must declare shapes"),
    ("mine", type("Empty", (WallAvoidanceRules,), {"shapes": {}}), {}, "Empty must declare shapes"),
    *[("mine", Still, edited(lambda spec, name=name: spec.delete(spec.sensor(name))), name)
      for name in ("touch", "back")],
    ("mine", Still, edited(renamed), "the sensors front, back, left, right must follow each other"),
    ("mine", Still, edited(lambda spec: spec.delete(spec.camera("overhead"))),
     "the arena must have a camera 'overhead', got none"),
    ("mine", Still, {"spot_seconds": 0.25}, "spot_seconds must be a multiple of"),
    ("mine", Still, edited(lambda spec: spec.delete(spec.geom("north"))),
     "geom 'north'"),
    ("mine", Still, edited(lambda spec: spec.body("spot").add_joint(name="slide")), "mocap body"),
    ("mine", Still, edited(lambda spec: spec.worldbody.add_body(mass=1, inertia=[1, 1, 1])
                           .add_joint(name="ball")), "free joint and two wheels, got .*'ball'"),
    ("mine", Still, edited(lambda spec: spec.delete(spec.actuator("left_motor"))),
     r"left_motor and right_motor, got \['right_motor'\]"),
    ("mine", Still, edited(lambda spec: setattr(spec.body("spot"), "mocap", False)),
     "the body 'spot' must be the arena's only mocap body"),
    ("mine", Still, edited(slid), "the body 'left_wheel' must have one joint, a hinge"),
    ("mine", Still, edited(crossed), "left_motor must drive the joint of the body 'left_wheel'"),
    ("mine", Still, edited(lambda spec: spec.actuator("right_motor").gear.fill(-0.02)),
     "the gear of right_motor must be positive, got -0.02"),
    ("mine", Still, edited(divided), "the obstacles leave no room"),
    ("mine", Still, edited(block("obstacle_9", [0.1, 0, 0])), MOVED),
    ("mine", Still, edited(block("obstacle_9", [0, 0, 0], nested=True)), MOVED),
    ("mine", Still, edited(block("obstacle_9", None, geom=False)), "'obstacle_9' has no geom"),
    ("mine", changed(observations=lambda o: o | {"bias": o["contact"]}), {},
     r"'bias': \(2, 1\)"),
    ("mine", changed(observations=lambda o: o | {"distances": o["distances"] * np.nan}), {},
     "distances must be numbers from 0 to 1, got array"),
    ("mine", changed(observations=lambda o: o["distances"]), {},
     "observations must be a dict, got array"),
    ("mine", changed(observations=lambda o: dict(reversed(o.items()))), {},
     "observations must have the shapes"),
    ("mine", changed(event=lambda event: event.ravel()[0]), {},
     r"event must have the shape \(2,\), got \(\)"),
]  # fmt: skip


def test_a_wrong_task_is_refused_and_nothing_is_registered():
    before = [*suite.TASKS], [*musebot.SUITE], dict(musebot.GYMNASIUM_TASKS)
    for name, rules, settings, words in WRONG:
        with pytest.raises((ValueError, TypeError, KeyError), match=words):
            musebot.register_task(name, rules, **settings)
            pytest.fail(words)
        after = [*suite.TASKS], [*musebot.SUITE], dict(musebot.GYMNASIUM_TASKS)
        assert after == before, words


def test_a_reward_that_is_not_as_declared_is_refused_in_the_step_that_gives_it():
    """Rules may change after the registration, or return other rewards than in its probe."""
    change = np.copy
    musebot.register_task("changing", changed(reward=lambda reward: change(reward)))
    one = gymnasium.make("musebot/Changing-v0", disable_env_checker=True)
    many = gymnasium.make_vec("musebot/Changing-v0", num_envs=2)
    for env, wrong in itertools.product((one, many), REWARDS.values()):
        change = np.copy
        env.reset(seed=1)
        still = np.zeros(env.action_space.shape, np.float32)
        env.step(still)
        change = wrong
        with pytest.raises(ValueError, match="the reward of Changed must be numbers from -1 to 0"):
            env.step(still)


def test_a_task_registered_again_replaces_the_former_one_and_an_id_is_of_one_task():
    musebot.register_task("changing_1", Still, time_limit=2.0)
    with pytest.raises(ValueError, match="musebot/Changing1-v0 is that of 'changing_1'"):
        musebot.register_task("changing1", Still)
    assert "changing1" not in suite.TASKS
    assert musebot.register_task("changing_1", Paid, time_limit=3.0) == "musebot/Changing1-v0"
    assert gymnasium.spec("musebot/Changing1-v0").max_episode_steps == 30
    batch, usual = (
        make_batch("changing_1", 1),
        SpotFindingRules.of(make_batch("changing_1", 1).model),
    )
    assert type(batch.rules) is Paid
    smell = np.random.default_rng(0).uniform(-0.3, 0.3, (9, *batch.sensordata.shape))
    np.testing.assert_array_equal(batch.rules.state(smell), usual.state(smell))
    np.testing.assert_array_equal(batch.rules.reward(smell), usual.reward(smell) - 7)
    assert type(musebot.load("arena", "changing_1").task.rules) is Paid
    assert gymnasium.make("musebot/Changing1-v0").observation_space.shape == (1,)
    assert musebot.SUITE["changing_1"].__doc__ == Paid.__doc__


def test_a_module_that_registers_no_such_task_is_refused():
    from musebot.tasks.gymnasium_env import ArenaEnv

    for task, words in (
        (":racing", "task must be NAME or MODULE:NAME, got ':racing'"),
        (".tasks:racing", "task must be NAME or MODULE:NAME, got '.tasks:racing'"),
        ("json:racing", "the module json registers no task 'racing'"),
    ):
        with pytest.raises(ValueError, match=words):
            ArenaEnv(task)


@pytest.mark.parametrize("module", ["__main__", None])
def test_processes_import_only_modules_that_register_the_task(module, monkeypatch):
    """A module of the suite does not, and the main program has another name there."""
    musebot.register_task("night", Still)
    known = gymnasium.spec("musebot/Night-v0").kwargs["task"]
    assert known == f"{Still.__module__}:night"
    if module:
        monkeypatch.setattr(Still, "__module__", module)
    musebot.register_task("night", Still if module else WallAvoidanceRules)
    assert gymnasium.spec("musebot/Night-v0").kwargs["task"] == "night"


_BASELINES = """
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor
from musebot.tasks.stable_baselines import ArenaVecEnv

assert type(PPO("MlpPolicy", "musebot/Racing-v0", n_steps=8, batch_size=8).learn(8)) is PPO
robots = VecMonitor(ArenaVecEnv("musebot/Racing-v0", 2, max_episode_steps=4))
assert len(PPO("MlpPolicy", robots, n_steps=8, batch_size=8).learn(16).ep_info_buffer) == 4
"""


# What a process that is started anew does with the name that Gymnasium gives it.
_FRESH = """
from musebot.tasks.gymnasium_env import ArenaEnv
assert ArenaEnv("my_tasks:racing").observation_space.shape == (6,)
"""


@pytest.mark.slow
def test_the_example_of_the_page_runs_and_other_processes_find_its_task(tmp_path):
    module, use, *_ = EXAMPLES
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
    printed = []
    for code in (use, _FRESH):
        line = [sys.executable, "-c", code]
        done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        printed.append(done.stdout)
    assert printed[0].split("(")[1:] == ["6,) ", "8, 6) ", "8,) 1000\n"]
    assert 0 <= float(printed[0].split()[0]) <= 1


def test_a_life_in_a_task_of_ones_own_does_not_begin_inside_an_obstacle():
    def pillar(spec):
        body = spec.worldbody.add_body(name="obstacle_1")
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.04, 0.03, 0])

    musebot.register_task("pillar", Still, edits=(pillar,))
    from musebot.tasks.gymnasium_env import ArenaEnv

    beside, inside = (Phase(robot=robot) for robot in ((0.3, 0.0, 0.0), None))
    ArenaEnv("life", life=Life("own", "Own", "pillar", (beside,)))
    with pytest.raises(ValueError, match="robot"):
        ArenaEnv("life", life=Life("own", "Own", "pillar", (inside,)))


def test_an_obstacles_geom_may_have_any_name_and_a_robot_no_shell_to_show_its_reward():
    def bare(spec):
        for one in [*spec.geoms, *spec.sites]:
            one.material = ""
        for material in list(spec.materials):
            spec.delete(material)

    musebot.register_task("one_block", Still, edits=(block("obstacle_9", [0, 0, 0]),))
    assert make_batch("one_block", 1).dimensions.obstacles == ((0.2, 0.1, 0.04),)
    musebot.register_task("bare", Still, edits=(bare,))
    musebot.load("arena", "bare").reset()
    with pytest.raises(ValueError, match="needs a robot with the material 'musebot_shell'"):
        musebot.load("arena", "bare", visualize_reward=True)
