"""Copies, unpickled copies and restored states of every interface continue bit-exactly."""

import copy
import gc
import os
import pickle
import signal
import threading
import warnings

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")

import musebot  # noqa: E402
from musebot.models import Kinematics  # noqa: E402
from musebot.tasks import make_batch, make_kinematic_batch  # noqa: E402

TASK, JUMPS, ROBOTS = "spot_finding_jumping", 200, 3  # the spot jumps every 200 control steps
ID = "musebot/SpotFindingJumping-v0"


class DmControl:
    """A dm_control environment; the other classes have the same methods."""

    def __init__(self, seed):
        self.env = musebot.load("arena", TASK, {"random": seed})
        self.env.reset()

    def state(self):
        return self.env.get_state()

    def restore(self, state):
        self.env.set_state(state)

    def step(self, step, motors):
        timestep = self.env.step(2 * motors[0])
        data = self.env.physics.data
        return [timestep.observation["nose"], timestep.reward, data.qpos, data.mocap_pos]


class Gymnasium(DmControl):
    def __init__(self, seed):
        self.env = gymnasium.make(ID, max_episode_steps=-1)
        self.env.reset(seed=seed)

    def state(self):
        return self.env.unwrapped.get_state()

    def restore(self, state):
        self.env.unwrapped.set_state(state)

    def step(self, step, motors):
        observation, reward, _, _, info = self.env.step((2 * motors[0]).astype(np.float32))
        return [observation, reward, *info.values()]


class Vector(Gymnasium):
    def __init__(self, seed):
        self.env = gymnasium.make_vec(ID, ROBOTS, threads=2, max_episode_steps=290)
        self.env.reset(seed=seed)

    def step(self, step, motors):
        *results, info = self.env.step((2 * motors).astype(np.float32))
        return [*results, *info.values()]


class MuJoCoBatch(DmControl):
    def __init__(self, seed):
        self.env = make_batch(TASK, ROBOTS, threads=2)
        random = np.random.default_rng(seed)
        self.env.place_spot(np.arange(ROBOTS), random.uniform(-0.2, 0.2, (ROBOTS, 2)))
        self.env.place(np.arange(ROBOTS), random.uniform(-0.2, 0.2, (ROBOTS, 3)))

    def step(self, step, motors):
        if step and step % JUMPS == 0:
            self.env.place_spot(np.arange(ROBOTS), np.full((ROBOTS, 2), 0.1))
        self.env.step(motors)
        return [self.env.sensordata, self.env.pose, self.env.spot, self.env.valid]


class KinematicBatch(MuJoCoBatch):
    def __init__(self, seed):
        self.env = make_kinematic_batch(TASK, ROBOTS, Kinematics(lag=0.08))
        self.env.place_spot(np.arange(ROBOTS), np.full((ROBOTS, 2), 0.2))


KINDS = [DmControl, Gymnasium, Vector, MuJoCoBatch, KinematicBatch]


def copied(one, how):
    """Returns a copy of an environment, as the given way makes it."""
    if how == "deepcopy":
        return copy.deepcopy(one)
    if how == "pickle":
        return pickle.loads(pickle.dumps(one))
    other = type(one)(seed=99)
    other.restore(pickle.loads(pickle.dumps(one.state())))
    return other


@pytest.mark.parametrize("how", ["deepcopy", "pickle", "state"])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_copy_continues_bit_exactly_across_a_jump_of_the_spot(kind, how):
    random = np.random.default_rng(0)
    motors = np.repeat(random.uniform(-0.5, 0.5, (36, ROBOTS, 2)), 10, axis=0)
    motors[100:140] = 0.5  # into a wall
    original = kind(seed=1)
    for step in range(60):
        original.step(step, motors[step])
    copies = [original, copied(original, how)]
    for step in range(60, 360):
        ours, theirs = (
            [np.array(value) for value in one.step(step, motors[step])] for one in copies
        )
        for mine, its in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(mine, its)


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_of_the_physics_shows_what_the_original_shows(how):
    environment = musebot.load("arena", "wall_avoidance", {"random": 0})
    environment.reset()
    for _ in range(5):
        environment.step(np.array([0.5, 0.4]))
    physics = environment.physics
    for twin in (how(physics), physics.copy(), how(environment).physics):
        assert not twin.legacy_step
        for name in ("sensordata", "xpos", "qacc", "qpos"):
            np.testing.assert_array_equal(getattr(twin.data, name), getattr(physics.data, name))


@pytest.mark.parametrize("kind", [DmControl, Gymnasium, Vector], ids=lambda kind: kind.__name__)
def test_a_state_of_another_shape_is_refused_and_changes_nothing(kind):
    one, twin = kind(seed=1), kind(seed=1)
    good = one.state()
    name = "batch" if kind is Vector else "physics"
    wrong = [{**good, "colour": 1}, {k: v for k, v in good.items() if k != name}, None, []]
    wrong.append({**good, name: {} if kind is Vector else np.zeros(3)})
    if kind is Vector:
        wrong += [{**good, "randoms": good["randoms"][:2]}, {**good, "seeds": [1]}]
    if kind is Gymnasium:
        wrong.append({**good, "counts": []})
    for state in wrong:
        with pytest.raises(ValueError, match=r"state(\[.*\])? must (have|be)"):
            one.restore(state)
    for step in range(5):
        motors = np.full((ROBOTS, 2), 0.3)
        for mine, its in zip(one.step(step, motors), twin.step(step, motors), strict=True):
            np.testing.assert_array_equal(mine, its)


def test_a_state_of_another_random_stream_is_refused():
    one = DmControl(seed=1)
    other = musebot.load("arena", TASK, {"random": np.random.default_rng(0)})
    other.reset()
    with pytest.raises(ValueError, match="state must hold the state of such a random stream"):
        one.restore(other.get_state())


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.parametrize("what", ["stepped", "deleted"])
def test_a_batch_with_threads_works_in_a_forked_process(what):
    batch = make_batch("wall_avoidance", 4, threads=2)
    motors = np.full((4, 2), 0.4)
    batch.step(motors)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of Python 3.12: there are threads
        child = os.fork()
    if child == 0:
        status = 1
        try:
            signal.alarm(60)  # the pool of the parent would be waited for, for ever
            if what == "stepped":
                batch.step(motors)
                status = int(batch.pose[0, 0] <= 0)
            else:
                del batch
                gc.collect()
                status = 0
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    batch.step(motors)
    assert batch.valid.all()


def test_environments_of_two_threads_do_not_affect_each_other():
    def drive(seed, results):
        one = DmControl(seed)
        motors = np.full((1, 2), 0.1 + 0.1 * seed)
        for step in range(50):
            results[seed] = [np.array(value) for value in one.step(step, motors)]

    alone, together = {}, {}
    for seed in (1, 2):
        drive(seed, alone)
    threads = [threading.Thread(target=drive, args=(seed, together)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed in (1, 2):
        for mine, its in zip(alone[seed], together[seed], strict=True):
            np.testing.assert_array_equal(mine, its)


class ShortDmControl(DmControl):
    """Episodes of 60 control steps, of which the tests see the ends."""

    def __init__(self, seed):
        self.env = musebot.load("arena", TASK, {"random": seed, "time_limit": 6.0})
        self.env.reset()

    def step(self, step, motors):
        timestep = self.env.step(2 * motors[0])
        return [timestep.step_type, timestep.observation["nose"], self.env.physics.data.qpos]


class ShortVector(Vector):
    def __init__(self, seed):
        self.env = gymnasium.make_vec(ID, ROBOTS, max_episode_steps=60)
        self.env.reset(seed=seed)


@pytest.mark.parametrize("at", [58, 59, 60, 61])
@pytest.mark.parametrize("kind", [ShortDmControl, ShortVector], ids=lambda kind: kind.__name__)
def test_a_restored_environment_ends_its_episodes_when_the_original_does(kind, at):
    motors = np.full((ROBOTS, 2), 0.2)
    original = kind(seed=1)
    for step in range(at):
        original.step(step, motors)
    restored = copied(original, "state")
    for step in range(at, at + 70):
        ours, theirs = (
            [np.array(value) for value in one.step(step, motors)] for one in (original, restored)
        )
        for mine, its in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(mine, its)
