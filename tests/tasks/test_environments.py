"""One contract for dm_control's, Gymnasium's single and Gymnasium's vector environment."""

import copy
import dataclasses
import pickle
import re

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")

from dm_control.rl.control import PhysicsError  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

import musebot  # noqa: E402
from musebot.tasks.gymnasium_env import INFO, ArenaEnv, ArenaVectorEnv  # noqa: E402
from musebot.tasks.gymnasium_env.common import LIFE_INFO  # noqa: E402
from musebot.tasks.lives import Life, Phase  # noqa: E402
from musebot.tasks.world import World  # noqa: E402

JUMPING, PILLARS = "spot_finding_jumping", "wall_avoidance_obstacles"
ROBOTS = 3
# Places are drawn at the steps 0, 90, 180 and 200; then the world changes.
TWO_WORLDS = Life(
    "mine",
    "Mine",
    "spot_or_driving",
    (
        Phase(minutes=1 / 3, spot="random", every_minutes=0.15),
        Phase(minutes=0.01, robot="random", world=World((-1.0, 0.0, 0.0, 1.0), 90.0)),
        Phase(minutes=1, world=World(sensors=(("nose", 1.0, -1.0),), rewarded="driving")),
    ),
)


def named(task):
    """Returns the keywords of a task, or of a life, in Gymnasium's environments."""
    return {"task": "life", "life": task} if isinstance(task, Life) else {"task": task}


class DmControl:
    """A dm_control environment; the other classes have the same methods."""

    def __init__(self, task=JUMPING, seed=1, **kwargs):
        domain = "life" if isinstance(task, Life) else "arena"
        self.env = musebot.load(domain, task, {"random": seed, **kwargs})

    def reset(self, **kwargs):
        return np.concatenate([*self.env.reset(**kwargs).observation.values()]).astype(np.float32)

    def step(self, motors):
        """Steps with motor values of shape (B, 2); returns all that can be seen."""
        timestep = self.env.step(motors[0] / 0.5 * self.env.task.episode.limit)
        data = self.env.physics.data
        return [*timestep.observation.values(), timestep.reward, data.qpos, data.mocap_pos]

    def qpos(self):
        return self.env.physics.data.qpos

    def place_spot(self, x, y):
        self.env.physics.place_spot(x, y)


class Single(DmControl):
    def __init__(self, task=JUMPING, seed=1, **kwargs):
        self.env, self.seed = ArenaEnv(**named(task), **kwargs), seed

    def reset(self, **kwargs):
        return self.env.reset(seed=self.seed, **kwargs)[0]

    def step(self, motors):
        action = motors[0] / 0.5 * self.env.action_space.high
        observation, reward, _, _, info = self.env.step(action.astype(np.float32))
        return [observation, reward, *info.values()]


class Vector(Single):
    def __init__(self, task=JUMPING, seed=1, **kwargs):
        self.env, self.seed = (
            ArenaVectorEnv(**named(task), num_envs=ROBOTS, threads=2, **kwargs),
            seed,
        )

    def reset(self, **kwargs):
        return self.env.reset(seed=self.seed, **kwargs)[0][0]

    def step(self, motors):
        action = motors / 0.5 * self.env.single_action_space.high
        *results, info = self.env.step(action.astype(np.float32))
        return [*results, *info.values()]

    def qpos(self):
        return self.env._batch.arrays()["state"][0, 1:10]

    def place_spot(self, x, y):
        self.env._batch.place_spot(np.array([0]), np.array([[x, y]]))


KINDS = [DmControl, Single, Vector]


def test_a_spot_that_moves_is_drawn_at_once():
    env = musebot.load("arena", "spot_finding")
    env.reset()
    env.physics.place_spot(0.1, -0.2)
    drawn = env.physics.named.data.site_xpos["spot", ["x", "y"]]
    np.testing.assert_array_equal(drawn, [0.1, -0.2])


@pytest.fixture(params=KINDS, ids=lambda kind: kind.__name__)
def make(request):
    return request.param


def begun(make, *args, **kwargs):
    one = make(*args, **kwargs)
    one.reset()
    return one


def assert_continue_alike(first, second, steps=3, seed=0):
    random = np.random.default_rng(seed)
    for _ in range(steps):
        motors = random.uniform(-0.5, 0.5, (ROBOTS, 2))
        ours, theirs = ([np.array(v) for v in one.step(motors)] for one in (first, second))
        for mine, its in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(mine, its)


def refusal(function, *args, **kwargs):
    """Returns the type and the sentence of the refusal of a call."""
    with pytest.raises((ValueError, TypeError, RuntimeError)) as caught:
        function(*args, **kwargs)
    return type(caught.value), str(caught.value)


STILL = np.full((ROBOTS, 2), 0.1)

# Places and actions

INSIDE = r"inside the arena, \|x\| <= {} and \|y\| <= {}, got \({}"
PLACES = [
    ({"robot": (5, 5, 0)}, "robot must be " + INSIDE.format("0.4975", "0.3225", r"5.0, 5.0, 0.0")),
    ({"robot": (0, -0.33, 0)}, "robot must be inside the arena"),
    ({"spot": (0, 0.36)}, "spot must be " + INSIDE.format("0.525", "0.35", r"0.0, 0.36")),
    (
        {"robot": (0.05, -0.14, 0)},
        r"robot must be at least 0.0875 m from the centre of the obstacle at \(0.05, -0.14\)",
    ),
    *[({"robot": place}, r"robot must be finite real numbers of shape \(3,\), got")
      for place in ((0, np.nan, 0), ("a", "b", "c"), ((0, 0), 0, 0), (0, 0))],
    *[({"spot": place}, r"spot must be finite real numbers of shape \(2,\), got")
      for place in ((1j, 0), 0.1)],
    ({"robot": "middle"}, r"robot must be one of \['upper_left', 'upper_right'\], got 'middle'"),
    ({"colour": 1}, r".* takes the (options|keywords) \[.*'robot', 'spot'.*\], got \['colour'\]"),
]  # fmt: skip


def test_impossible_places_are_refused_with_one_sentence_and_change_nothing():
    ones = [make(PILLARS, robot=(0.2, -0.2, 0.5)) for make in KINDS]
    before = [one.reset() for one in ones]
    for places, sentence in PLACES:
        wanted = TypeError if "colour" in places else ValueError
        for make in KINDS:
            error, made = refusal(make, PILLARS, **places)
            assert re.match(sentence, made) and error is wanted, made
        [(error, said)] = {refusal(one.env.reset, options=places) for one in ones}
        assert error is wanted and re.match(sentence, said)
        for one, first in zip(ones, before, strict=True):
            np.testing.assert_array_equal(first, one.reset())


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding_walls"])
def test_options_place_robot_and_spot_for_one_episode(task):
    option, seen = {"robot": (0.4975, -0.1, 1.0), "spot": (0.25, 0.0)}, []
    for make in KINDS:
        one = make(task, robot=(-0.3, 0.1, 0.0), spot=(-0.2, 0.2))
        first = one.reset()
        seen.append(one.reset(options=option))
        assert not np.array_equal(first, seen[-1])
        np.testing.assert_allclose(one.qpos()[:2], option["robot"][:2], atol=1e-12)
        np.testing.assert_array_equal(first, one.reset())
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])


ACTIONS = [
    (np.nan, 0.0), (0.0, np.inf), (0.1,), (0.1, 0.2, 0.3), 0.1, ((0.1,), (0.2, 0.3)), (0.1j, 0.2),
    ("0.1", "0.2"), (None, 0.1), (True, False), None,
]  # fmt: skip


def test_an_action_that_is_not_two_finite_numbers_is_refused_and_changes_nothing(make):
    one, twin = (begun(make, "wall_avoidance", robot=(0, 0, 0.3)) for _ in range(2))
    shape = rf"\({ROBOTS}, 2\)" if make is Vector else r"\(2,\)"
    sentence = f"actions? must be (finite )?real numbers of shape {shape}, got "
    for action in ACTIONS:
        error, said = refusal(one.env.step, [action] * ROBOTS if make is Vector else action)
        assert error is ValueError and re.match(sentence, said), action
    for kind in (int, float, np.float32, np.int8):  # real numbers of every type are actions
        for other in (one, twin):
            action = np.array([1, 0]).astype(kind)
            other.env.step(np.tile(action, (ROBOTS, 1)) if make is Vector else action)
    assert_continue_alike(one, twin)


# The life of an environment


def spoil(one, how):
    """Does what ends in a PhysicsError in the next step."""
    qpos = one.qpos()
    if how == "velocity":
        qvel = one.env._batch.arrays()["state"][0, 10:] if type(one) is Vector else None
        (one.env.physics.data.qvel if qvel is None else qvel)[:] = np.inf
    elif how == "beyond the wall":
        qpos[0] = 0.6
    elif how == "in the air":
        qpos[2] = 5.0
    elif how == "on its back":
        qpos[2:7] = [0.02, 0, 1, 0, 0]
    else:
        one.place_spot(np.nan, 0.0)  # a sensor that is not finite


def test_a_step_needs_a_reset_at_first_and_after_an_instability(make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo would write its log
    one = make("spot_finding", robot=(0, 0, 0), spot=(0.2, 0))
    if make is DmControl:
        assert one.env.step(np.zeros(2)).first()  # as dm_env requires
    else:
        said = (RuntimeError, "reset must be called before the first step")
        assert refusal(one.step, STILL) == said
    first = one.reset()
    for how in ("velocity", "beyond the wall", "in the air", "on its back", "a sensor of NaN"):
        spoil(one, how)
        with pytest.raises(PhysicsError):
            one.step(STILL)
            pytest.fail(how)
        said = "reset must be called after a PhysicsError, before the next step"
        for call in (lambda: one.step(STILL), one.env.get_state):
            assert refusal(call) == (RuntimeError, said)
        np.testing.assert_array_equal(first, one.reset())
        one.step(STILL)
    model = one.env.get_attr("model")[0] if make is Vector else one.env.physics.model.ptr
    model.site("nose").pos[0] = np.nan  # a sensor that reads NaN from the start
    with pytest.raises(PhysicsError, match="became unstable"):
        one.reset()
    assert refusal(one.step, STILL)[0] is RuntimeError


def test_nothing_works_after_close_but_a_reset_of_gymnasiums_single_environment(make):
    one, other = begun(make, "spot_finding"), begun(make, "spot_finding")
    one.env.close()
    one.env.close()
    calls = [lambda: one.step(STILL), one.env.get_state]
    calls.append(lambda: one.env.set_state(other.env.get_state()))
    calls.append(one.env.physics.render if make is DmControl else one.env.render)
    if make is not Single:
        calls.append(one.reset)
    assert {refusal(call) for call in calls} == {(RuntimeError, "the environment is closed")}
    if make is Single:  # as Gymnasium's own
        one.reset()
        assert_continue_alike(one, other)


# States and copies


def copied(make, one, how, **short):
    if how == "deepcopy":
        return copy.deepcopy(one)
    if how == "pickle":
        return pickle.loads(pickle.dumps(one))
    other = begun(make, seed=99, **short)
    other.env.set_state(pickle.loads(pickle.dumps(one.env.get_state())))
    if make is Vector:
        np.testing.assert_array_equal(other.env._reached, one.env._reached)
    return other


def test_equal_lives_take_each_others_states(make):
    whole, real = (
        Life("alike", "Alike", "spot_finding", (Phase(minutes=m, world=World(wheels=w)),))
        for m, w in ((1, (0, 1, 1, 0)), (1.0, (0.0, 1.0, 1.0, 0.0)))
    )
    one, other = begun(make, whole), begun(make, real)
    other.env.set_state(one.env.get_state())
    assert_continue_alike(one, other, 2)


def test_an_episode_has_at_least_one_step_and_takes_its_own_state():
    environment = musebot.load("arena", "wall_avoidance", {"time_limit": 1e-8})
    environment.reset()
    assert environment.step(np.zeros(2)).last()
    environment.set_state(environment.get_state())


@pytest.mark.parametrize("task", [JUMPING, TWO_WORLDS], ids=["jumping", "life"])
def test_a_copy_continues_bit_exactly_across_a_jump_or_change_and_an_end(make, task):
    short = {DmControl: {"time_limit": 20.6}, Single: {}, Vector: {"max_episode_steps": 206}}[make]
    short = {"task": task, **short}
    one = begun(make, **short)
    for step in range(208):
        one.step(np.full((ROBOTS, 2), 0.5 if step < 60 else -0.2))
        if step >= 195:  # before and after the jump, and before, at and after the end
            for how in ("deepcopy", "pickle", "state") if step % 5 == 0 else ("state",):
                assert_continue_alike(copy.deepcopy(one), copied(make, one, how, **short), 15)


def with_part(state, name, value):
    """Returns a state with another value, of which the name may be a path."""
    first, _, rest = name.partition(".")
    return {**state, first: with_part(state[first], rest, value) if rest else value}


def wrong_states(make, good):
    """Returns states that are refused, by what is wrong with them."""
    vector = make is Vector
    wrong = {name: one for name, one in zip("ABC", (None, [], {}), strict=True)}
    wrong["an unknown key"] = {**good, "colour": 1}
    for name in good:
        wrong[f"no {name}"] = {key: one for key, one in good.items() if key != name}
        wrong[f"{name} is an object"] = {**good, name: object()}
    wrong["another task"] = begun(make, "spot_finding", seed=9).env.get_state()
    wrong["another smell"] = begun(make, nose="printed", seed=9).env.get_state()
    random = good["randoms"][1] if vector else good["random"]
    broken = {**random, "state": "abc"}
    wrong["a random stream"] = (
        {**good, "randoms": [good["randoms"][0], broken, good["randoms"][2]]}
        if vector
        else {**good, "random": broken}
    )
    for what, steps in (("negative", -1), ("huge", 10**400), ("fractional", 0.5)):
        bad = np.full(ROBOTS, -1) if vector else steps
        wrong[f"{what} steps"] = {**good, "steps": bad}
    if make is DmControl:
        wrong["another kind of stream"] = begun(make, seed=np.random.default_rng(0)).env.get_state()
    physics = "batch.state" if vector else "physics"
    for number, value in ((1, np.nan), (1, 0.6), (3, 5.0), (12, np.inf)):
        array = (good["batch"]["state"] if vector else good["physics"]).copy()
        array[..., number] = value
        wrong[f"{physics} {number} {value}"] = with_part(good, physics, array)
    sensors = "batch.sensordata" if vector else "sensordata"
    wrong["a sensor"] = with_part(good, sensors, np.full_like(
        good["batch"]["sensordata"] if vector else good["sensordata"], np.nan))  # fmt: skip
    if vector:
        wrong["stopped robots"] = with_part(good, "batch.valid", np.zeros(ROBOTS, bool))
        wrong["two robots"] = {**good, "randoms": good["randoms"][:2], "seeds": good["seeds"][:2]}
        wrong["seeds of letters"] = {**good, "seeds": ["a", "b", "c"]}
        wrong["counts"] = {**good, "counts": good["counts"] + 10**6}
    elif make is Single:
        wrong["counts of NaN"] = {**good, "counts": [np.nan, 0]}
        wrong["more contacts than steps"] = {**good, "counts": [0, 99]}
        wrong["a seed of letters"] = {**good, "seed": "abc"}
    return wrong


def test_a_wrong_state_is_refused_with_one_sentence_and_changes_nothing(make):
    one, twin = begun(make), begun(make)
    for _ in range(5):
        one.step(STILL)
        twin.step(STILL)
    for what, state in wrong_states(make, begun(make, seed=9).env.get_state()).items():
        with pytest.raises(ValueError, match="state.* must "):
            one.env.set_state(state)
            pytest.fail(what)
        np.testing.assert_equal(one.env.get_state(), twin.env.get_state(), err_msg=what)
    assert_continue_alike(one, twin, steps=30)


def test_a_copy_of_the_physics_shows_what_the_original_shows():
    environment = begun(DmControl, "wall_avoidance").env
    for _ in range(5):
        environment.step(np.array([0.5, 0.4]))
    physics = environment.physics
    for how in (copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))):
        for twin in (how(physics), physics.copy(), how(environment).physics):
            for name in ("sensordata", "xpos", "qacc", "qpos"):
                np.testing.assert_array_equal(getattr(twin.data, name), getattr(physics.data, name))


# Lives


def test_a_life_is_alike_in_every_interface_and_ends_once():
    short = dataclasses.replace(TWO_WORLDS, phases=TWO_WORLDS.phases[:2]).scaled(0.5)
    length, first = sum(short.steps()), Vector(short)
    singles = [Single(short, seed=1 + robot) for robot in range(ROBOTS)]
    twin = DmControl(short, seed=np.random.Generator(np.random.PCG64(1)))
    seen = [first.env.reset(seed=1)[0], [one.reset() for one in singles]]
    np.testing.assert_array_equal(*seen)
    twin.reset()
    random, phases = np.random.default_rng(0), []
    for step in range(1, length + 1):
        actions = random.uniform(-1, 1, (ROBOTS, 2)).astype(np.float32)
        ours = first.env.step(actions)
        theirs = [one.env.step(action) for one, action in zip(singles, actions, strict=True)]
        timestep = twin.env.step(actions[0])
        for mine, its in zip(ours[:4], zip(*theirs, strict=True), strict=False):
            np.testing.assert_array_equal(mine, its)
        for name in (*INFO, *LIFE_INFO):
            np.testing.assert_array_equal(ours[4][name], [its[4][name] for its in theirs])
        flat = np.concatenate([*timestep.observation.values()]).astype(np.float32)
        np.testing.assert_array_equal(flat, ours[0][0])
        assert (timestep.reward, timestep.last()) == (ours[1][0], ours[3][0])
        assert ours[3].all() == (step == length)
        phases.append((ours[4]["phase"][0], ours[4]["changed"][0]))
    assert phases == [(0, False)] * 99 + [(1, True)] + [(1, False)] * (length - 100)
    one = singles[0]
    namesake = begun(Single, dataclasses.replace(short, phases=short.phases[:1]))
    assert refusal(namesake.env.set_state, one.env.get_state())[0] is ValueError
    other = begun(Single, short, seed=9)
    other.env.set_state(one.env.get_state())  # that of the last step
    for single in (one, other):
        said = (RuntimeError, "reset must be called after the end of a life")
        assert refusal(single.step, STILL) == said
    np.testing.assert_array_equal(one.env.reset()[0], other.env.reset()[0])


def test_a_batch_whose_episodes_end_one_step_before_a_placement_equals_single_environments():
    batch = Vector(TWO_WORLDS, max_episode_steps=89)  # places are drawn at the step 90
    singles = [Single(TWO_WORLDS, seed=1 + robot) for robot in range(ROBOTS)]
    ours, theirs = batch.env.reset(seed=1), [one.env.reset(seed=one.seed) for one in singles]
    random = np.random.default_rng(0)
    for step in range(2 * 90 + 1):
        np.testing.assert_array_equal(ours[0], [its[0] for its in theirs])
        for name in INFO:
            np.testing.assert_array_equal(ours[-1][name], [its[-1][name] for its in theirs])
        actions = random.uniform(-1, 1, (ROBOTS, 2)).astype(np.float32)
        ours = batch.env.step(actions)
        if step % 90 == 89:  # the call after an episode's end starts the next
            theirs = [one.env.reset() for one in singles]
        else:
            theirs = [one.env.step(action) for one, action in zip(singles, actions, strict=True)]


def test_a_life_takes_no_places_and_its_robots_begin_together():
    for make in KINDS:
        one = begun(make, TWO_WORLDS)
        for places in ({"robot": (0, 0, 0)}, {"spot": (0, 0)}):
            assert refusal(make, TWO_WORLDS, **places)[0] is TypeError
            assert refusal(one.reset, options=places)[0] is TypeError
        outside = Phase(robot=(5.0, 5.0, 0.0))
        for phase, task in (
            (outside, "spot_finding"),
            (TWO_WORLDS.phases[2], "wall_avoidance"),
            (Phase(), JUMPING),
        ):
            wrong = dataclasses.replace(TWO_WORLDS, task=task, phases=(Phase(), phase))
            assert refusal(make, wrong)[0] is ValueError
        assert refusal(make, dataclasses.replace(TWO_WORLDS, task="dancing"))[0] is ValueError
    mask = np.array([True, False, True])
    said = refusal(begun(Vector, TWO_WORLDS).env.reset, options={"reset_mask": mask})
    assert said[0] is ValueError and said[1].startswith("robots of a life begin together: all must")
    for life in ("nobody", None, 3):
        words = "life must be one of .*, or a Life, got"
        with pytest.raises(ValueError, match=words):
            musebot.load("life", life)
        with pytest.raises(ValueError, match=words):
            gymnasium.make("musebot/Life-v0", life=life)
    with pytest.raises(TypeError, match="life must be given: one of"):
        gymnasium.make("musebot/Life-v0")


def test_the_last_step_of_a_phase_counts_and_earns_in_its_own_world():
    inside, corner = (0.1, 0.0, 0.0), (-0.4, -0.2, 0.0)
    phases = (
        Phase(minutes=0.05, robot=inside, spot=inside[:2]),
        Phase(minutes=0.05, robot=corner, learning=False, world=World(rewarded="driving")),
    )
    one = Single(dataclasses.replace(TWO_WORLDS, phases=phases))
    one.reset()
    for step in range(1, 61):
        _, reward, _, _, info = one.env.step(np.zeros(2))
        assert reward == pytest.approx(10 / 11 if step <= 30 else 0, abs=1e-3)
        assert info["in_spot_steps"] == min(step, 30)
        for name, holds in (
            ("reached", step <= 30),
            ("in_spot", step < 30),
            ("learning", step < 30),
            ("changed", step == 30),
            ("placed", step == 30),
        ):
            assert info[name] == holds, (step, name)


def test_gymnasium_makes_lives_that_its_checker_accepts():
    env = gymnasium.make("musebot/Life-v0", life="senses")
    assert env.spec.max_episode_steps is None
    check_env(env.unwrapped, skip_render_check=True)
    batch = gymnasium.make_vec("musebot/Life-v0", 2, life="body")
    assert isinstance(batch.unwrapped, ArenaVectorEnv) and batch.reset(seed=1)[0].shape == (2, 1)


# Keywords


def test_numbers_out_of_range_are_refused_with_the_name_of_their_keyword():
    numbers, wholes = (0, -1, np.nan, "3", True, [1.0], 1j), (-5, 1.5, "3", True, [1])
    refused = [(DmControl, "time_limit", numbers, "must be a positive number of seconds, got")]
    for name, values, words in (
        ("max_episode_steps", (0, np.inf, -1.0), ", if not -1, must be a whole number of at least"),
        ("num_envs", (0, -1, None), " must be a whole number of at least 1, got"),
        ("threads", (-1, None), " must be a whole number of at least 0, got"),
    ):
        refused.append((ArenaVectorEnv, name, (*values, *wholes), words))
    for make, name, values, words in refused:
        for value in values:
            with pytest.raises(ValueError, match=f"{name}.*{words}"):
                make("spot_finding", **{name: value})
                pytest.fail(f"{name} {value}")


def test_keywords_that_would_change_the_task_are_refused():
    for name in ("control_timestep", "n_sub_steps", "legacy_step", "colour"):
        words = rf"takes .* \['flat_observation', 'time_limit'\], got \['{name}'\]"
        with pytest.raises(TypeError, match=words):
            musebot.load("arena", "spot_finding_jumping", environment_kwargs={name: None})
