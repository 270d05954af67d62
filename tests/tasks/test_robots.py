"""The contract of `Robots`: every simulator places, steps, stops and restores robots alike."""

import copy
import gc
import itertools
import os
import pickle
import signal
import warnings

import numpy as np
import pytest
import torch

from musebot.models import Kinematics
from musebot.tasks import load, make_batch, make_kinematic_batch
from musebot.tasks.suite import TASKS
from musebot.tasks.tensors.robots import KinematicTensors, TensorRobots
from musebot.tasks.world import World

TASK = "spot_finding_walls"
BODIES = {
    "holds": Kinematics(),
    "slips": Kinematics(felt="pushed", wall="slips", lag=0.08),
    "refuses": Kinematics(wall="refuses", felt="pushed", pieces=1, path="euler"),
    "slides": Kinematics(wall="slides", any_contact=True),
    "sticks": Kinematics(wall="sticks"),
}


def warp(robots, tensors):
    module = pytest.importorskip("musebot.tasks.tensors.warp", reason="needs the extra `warp`")
    batch = make_batch(TASK, robots)
    return module.WarpTensors(batch) if tensors else module.WarpBatch(
        batch.model, batch.rules, robots
    )  # fmt: skip


def tensors(robots, body="slips"):
    return KinematicTensors(make_kinematic_batch(TASK, robots, BODIES[body]))


SIMULATORS = {
    "MuJoCo": lambda robots: make_batch(TASK, robots),
    "MuJoCo, threads": lambda robots: make_batch(TASK, robots, threads=2),
    "kinematic, slips": lambda robots: make_kinematic_batch(TASK, robots, BODIES["slips"]),
    "kinematic, refuses": lambda robots: make_kinematic_batch(TASK, robots, BODIES["refuses"]),
    "tensors": tensors,
}
WARP = {
    "Warp": lambda robots: warp(robots, False),
    "Warp on tensors": lambda robots: warp(robots, True),
}


@pytest.fixture(params=SIMULATORS)
def make(request):
    return SIMULATORS[request.param]


@pytest.fixture(params=[*SIMULATORS, *(pytest.param(n, marks=pytest.mark.slow) for n in WARP)])
def make_any(request):
    """Warp, too, which takes seconds for each batch; test_warp.py has its other laws."""
    return (SIMULATORS | WARP)[request.param]


def drive(batch, motors):
    """Takes a step of robots of any simulator."""
    batch.step(torch.from_numpy(np.asarray(motors, float)) if is_tensor(batch) else motors)


def is_tensor(batch):
    return isinstance(batch, TensorRobots)


def seen(batch):
    """Everything that can be read of robots."""
    numbers = batch.sensordata, batch.valid, batch.pose, batch.spot
    rules = (getattr(batch.rules, name)(batch.sensordata) for name in ("state", "reward", "event"))
    return [host(one) for one in (*numbers, *rules)]


def host(values):
    """Returns a copy of numbers as an array of NumPy."""
    return np.array(values.numpy() if isinstance(values, torch.Tensor) else values)


def assert_same(first, second, which=slice(None)):
    for ours, theirs in zip(seen(first), seen(second), strict=True):
        np.testing.assert_array_equal(ours[which], theirs[which])


def settled(batch, seed=0, most=0.25):
    """Places robots and spots at random, and returns the robots."""
    random, everyone = np.random.default_rng(seed), np.arange(batch.robots)
    batch.place_spot(everyone, random.uniform(-most, most, (batch.robots, 2)))
    batch.place(everyone, random.uniform(-most, most, (batch.robots, 3)) * [1, 1, 12])
    return batch


def scripted(steps, robots, seed=0):
    """Motor values of shape (steps, B, 2): random ones beyond the limits, and drives into walls."""
    random = np.random.default_rng(seed)
    motors = random.uniform(-0.6, 0.6, (steps, robots, 2))
    for start in range(0, steps, 40):
        motors[start : start + 30] = random.choice([-0.5, 0.5], (robots, 1))
    return motors


def test_robots_are_where_they_are_placed_and_rest_there(make_any):
    batch = settled(make_any(3))
    for motors in scripted(10, 3):
        drive(batch, motors)
    before, places = seen(batch), np.array([[0.2, 0.1, 1.0], [-0.3, 0.0, -2.0]])
    batch.place_spot(np.array([2]), np.array([[0.1, -0.2]]))
    batch.place(np.array([2, 0]), places)
    np.testing.assert_allclose(batch.pose[[2, 0]], places, atol=1e-9)
    assert batch.spot[2].tolist() == [0.1, -0.2]
    for ours, theirs in zip(before, seen(batch), strict=True):
        np.testing.assert_array_equal(ours[1], theirs[1])  # the other one
    drive(batch, np.zeros((3, 2)))
    np.testing.assert_allclose(batch.pose[[2, 0]], places, atol=1e-6)
    # What a robot at a wall senses does not depend on what it did before.
    wall = np.array([[0.525 - 0.0275, 0.0, 0.0]])
    batch.place(np.array([0]), wall)
    drive(batch, np.full((3, 2), 0.5))  # robot 0 pushes the wall, the others do not
    batch.place(np.arange(3), np.repeat(wall, 3, axis=0))
    fresh = host(batch.sensordata)[:, batch.rules.layout.touch]
    assert (fresh == fresh[0]).all()


def test_robots_sense_what_geometry_and_equation_3_say(make_any):
    batch = settled(make_any(40))
    size, layout = batch.dimensions, batch.rules.layout
    sensed, nose = host(batch.sensordata), host(batch.rules.state(batch.sensordata))[:, 0]
    for robot, ((x, y, heading), spot) in enumerate(zip(batch.pose, batch.spot, strict=True)):
        for reading, turn in zip(sensed[robot, layout.distances], (0, 180, 90, -90), strict=True):
            dx, dy = np.cos(heading + np.radians(turn)), np.sin(heading + np.radians(turn))
            rays = (np.copysign(0.525, dx) - x) / dx, (np.copysign(0.35, dy) - y) / dy
            assert reading == pytest.approx(min(rays) - 0.0275, abs=1e-5)
        offset = spot - [x, y] - size.nose * np.array([np.cos(heading), np.sin(heading)])
        turned = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        assert nose[robot] == pytest.approx(batch.rules.nose.signal(turned @ offset), abs=1e-4)
    assert 5 < (nose > 0).sum() < 35


def test_b_robots_do_what_b_single_ones_do(make):
    together, alone = settled(make(3)), [make(1) for _ in range(3)]
    for robot, one in enumerate(alone):
        one.place_spot(np.array([0]), together.spot[[robot]])
        one.place(np.array([0]), together.pose[[robot]])
        settle = together.get_state()
        one.set_state({name: array[[robot]] for name, array in settle.items()})
    touched = 0
    for step, motors in enumerate(scripted(60, 3)):
        drive(together, 1e30 * motors if step % 20 == 0 else motors)
        for robot, one in enumerate(alone):  # huge motor values are clipped
            command = np.copysign(0.5, motors) if step % 20 == 0 else motors
            drive(one, command[[robot]])
            for ours, theirs in zip(seen(together), seen(one), strict=True):
                np.testing.assert_array_equal(ours[robot], theirs[0])
        touched += int((host(together.sensordata)[:, together.rules.layout.touch] > 0).sum())
    assert touched > 0 and host(together.valid).all()


def copies(make, batch):
    """Yields copies of robots, made in every way."""
    state = batch.get_state()
    other = make(batch.robots)
    other.set_state(pickle.loads(pickle.dumps(state)))
    yield other
    if not is_tensor(batch):  # which are restored from states
        yield copy.deepcopy(batch)
        yield pickle.loads(pickle.dumps(batch))


def test_robots_begin_at_the_origin_with_the_spot_where_the_arena_has_it(make_any):
    batch = make_any(2)
    np.testing.assert_allclose(batch.pose, np.zeros((2, 3)), atol=1e-6)
    np.testing.assert_allclose(batch.spot, [[0.425, 0.25]] * 2, atol=1e-6)


def test_restored_robots_and_copies_continue_bit_exactly(make_any):
    batch = settled(make_any(3))
    motors = scripted(40, 3)
    for one in motors[:20]:
        drive(batch, one)
    twins = [*copies(make_any, batch)]
    for one in motors[20:]:
        for robots in (batch, *twins):
            drive(robots, one)
    for twin in twins:
        assert_same(batch, twin)


REFUSED = [
    ("place", (2, [0.1, 0.1, 0.1]), "robots must be indices"),
    ("place", ([1.0], [[0.1, 0.1, 0.1]]), "robots must be indices"),
    ("place", ([3], [[0.1, 0.1, 0.1]]), r"robots must lie in \[0, 2\]"),
    ("place", ([-1], [[0.1, 0.1, 0.1]]), r"robots must lie in \[0, 2\]"),
    ("place", ([0, 1], [[0.1, 0.1, 0.1]]), r"poses must be real numbers of shape \(2, 3\)"),
    ("place", ([0], [[0.1, 0.1, 1j]]), "poses must be real numbers"),
    ("place", ([0, 1], [[0.1], [0.1, 0.2]]), "poses must be real numbers"),
    ("place_spot", ([0], [["a", "b"]]), r"spots must be real numbers of shape \(1, 2\)"),
    ("place_spot", ([0], 10**400), "spots must be real numbers"),
    ("step", (np.zeros((1, 2)),), r"motors must .*shape \(3, 2\)"),
    ("set_state", (None,), "state must have the keys .*, got NoneType"),
    ("set_state", ({},), r"state must have the keys .*, got \[\]"),
]


WRONG = ([1], "abc", [[1], [1, 2]], None, 1j)  # for an array of a state


def test_a_refused_call_changes_nothing(make):
    batch, state = settled(make(3)), settled(make(3), seed=1).get_state()
    before = batch.get_state()
    for name, given, sentence in REFUSED:
        if name == "step" and is_tensor(batch):
            given = (torch.zeros(1, 2),)
        with pytest.raises(ValueError, match=sentence):
            getattr(batch, name)(*given)
    for name, wrong in itertools.product(state, WRONG):
        with pytest.raises(ValueError, match=rf"state\['{name}'\] must be of type ndarray"):
            batch.set_state({**state, name: wrong})
    for key, array in batch.get_state().items():
        np.testing.assert_array_equal(array, before[key])


def harm(batch, how):
    """Harms robot 1 of three, and returns the motors of the next step."""
    one, motors = np.array([1]), np.full((3, 2), [0.3, 0.2])
    if how == "stop":
        batch.stop(one)
        assert not host(batch.sensordata[1]).any()
    elif how == "motors":
        motors[1] = [0.1, np.inf]
    elif how == "NaN spot":
        batch.place_spot(one, np.array([[np.nan, 0]]))
    elif isinstance(how, tuple):
        batch.place(one, np.array([how]))
    else:
        state = batch.get_state()
        array = state.get("state", state.get("poses"))
        if how == "NaN":
            array[1, -2] = np.nan
        elif "state" in state:  # the kinematic simulator has no height and no tilt
            array[1, 3:8] = [5.0, 1, 0, 0, 0] if how == "in the air" else [0.02, 0, 1, 0, 0]
        else:
            batch.stop(one)
            return motors
        batch.set_state(state)
    return motors


HARMS = ["stop", "motors", "NaN spot", "NaN", "in the air", "on its back", (np.nan, 0, 0)]


def test_a_stopped_robot_senses_zeros_and_the_others_go_on(make_any, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo would write its log
    batch, twin = (settled(make_any(3)) for _ in range(2))
    start, motors = batch.get_state(), np.full((3, 2), [0.3, 0.2])
    for how in (*HARMS, (0.0, 0.4, 0.0)):
        batch.set_state(start)
        twin.set_state(start)
        bad = harm(batch, how)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for step in range(3):
                drive(batch, bad if step == 0 else motors)
                drive(twin, motors)
                assert host(batch.valid).tolist() == [True, False, True], how
                assert not host(batch.sensordata[1]).any()
                assert_same(batch, twin, [0, 2])
        batch.place(np.arange(3), batch.pose)  # it stays stopped
        assert not host(batch.sensordata[1]).any() and host(batch.sensordata[0]).any()
        assert np.isfinite(batch.pose).all() and host(twin.sensordata[1]).any()


# MuJoCo


def test_a_change_of_the_model_counts_in_each_physics_step():
    environment, batch = load("arena", "wall_avoidance"), make_batch("wall_avoidance", 2)
    environment.reset(options={"robot": (0.0, 0.0, 0.0)})
    for model in (environment.physics.model, batch.model):
        model.actuator_gainprm[:] *= 0.5
    flags = batch.model.opt.disableflags
    for _ in range(15):
        environment.step(np.array([0.5, 0.5]))
        batch.step(np.full((2, 2), 0.5))
    assert 0.1 < batch.pose[0, 0] < 0.2  # 0.28 m with the whole gain
    np.testing.assert_array_equal(batch.pose, [environment.physics.robot_pose()] * 2)
    assert batch.model.opt.disableflags == flags


def test_values_out_of_range_are_refused():
    speed = r"motor_speed must be a number in \[0.001, 10\] m/s"
    speeds = (0, -1, 10.1, np.nan, np.inf, 10**400, "fast", True, 1j)
    for name, values, words in (
        ("robots", (0,), "robots must be a whole number of at least 1, got 0"),
        ("threads", (-1,), "threads must be a whole number of at least 0, got -1"),
        ("task_name", ("dancing", ["dancing"]), "task must be one of .*got"),
        ("motor_speed", speeds, speed),
    ):
        for value in values:
            with pytest.raises(ValueError, match=words):
                make_batch(**{"task_name": "wall_avoidance", "robots": 1, name: value})


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_batches_with_threads_can_be_stepped_and_deleted_in_a_forked_process():
    batch, other = (make_batch("wall_avoidance", 4, threads=2) for _ in range(2))
    motors = np.full((4, 2), 0.4)
    for one in (batch, other):
        one.step(motors)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of Python 3.12: there are threads
        child = os.fork()
    if child == 0:
        status = 1
        try:
            signal.alarm(60)  # the pool of the parent would be waited for, for ever
            del other
            gc.collect()
            batch.step(motors)
            status = int(batch.pose[0, 0] <= 0)
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    other.step(motors)
    assert other.valid.all()


# Tensors


@pytest.mark.parametrize("task", TASKS)
def test_the_rules_of_every_task_give_of_tensors_what_they_give_of_arrays(task):
    batch, random = make_batch(task, 50), np.random.default_rng(0)
    measured = random.uniform(-0.3, 0.3, batch.sensordata.shape)
    for function in (batch.rules.state, batch.rules.reward, batch.rules.event):
        ours, theirs = function(torch.from_numpy(measured)), function(measured)
        np.testing.assert_allclose(ours.numpy(), theirs, atol=1e-12)
        blind = function(torch.from_numpy(measured).to("meta"))  # no numbers to copy to the host
        assert (str(blind.device), blind.shape) == ("meta", theirs.shape)


@pytest.mark.parametrize(
    ("body", "task"),
    [*((body, TASK) for body in BODIES), ("slips", "wall_avoidance"), ("slips", "spot_finding")],
)
def test_robots_on_tensors_do_what_the_numpy_robots_do_and_read_no_number(body, task):
    numpy = settled(make_kinematic_batch(task, 20, BODIES[body]))
    host = settled(make_kinematic_batch(task, 20, BODIES[body]))
    ours, contacts = KinematicTensors(host), 0
    for motors in scripted(80, 20).astype(np.float32):
        numpy.step(motors)
        ours.step(torch.from_numpy(motors))
        for mine, its in zip(seen(ours), seen(numpy), strict=True):
            np.testing.assert_allclose(mine, its, atol=1e-6)
        contacts += int(numpy.arrays()["touch"].sum())
    assert contacts > 20 and numpy.valid.all()
    with torch.device("meta"):  # it has shapes, but no numbers that could be read
        blind = KinematicTensors(make_kinematic_batch(task, 3, BODIES[body]))
    blind.enter(World())
    with pytest.raises(ValueError, match="robots on tensors have the default world only"):
        blind.enter(World(nose=90.0))
    blind.step(torch.zeros(3, 2, device="meta"))
    assert str(blind.rules.state(blind.sensordata).device) == "meta"
    assert blind.rules.reward(blind.sensordata).shape == (3,)
    assert blind.rules.event(blind.sensordata).dtype == torch.bool
