"""MuJoCo Warp against C MuJoCo, on Warp's device for CPUs: states and scripts."""

import numpy as np
import pytest
import torch
from dm_control.rl.control import PhysicsError

pytest.importorskip("mujoco_warp")

from musebot.tasks import make_batch
from musebot.tasks.batch import CapacityError
from musebot.tasks.tensors import warp as engine
from musebot.tasks.tensors.warp import WarpBatch, WarpTensors
from musebot.tasks.world import World

TASKS = ("spot_finding_walls", "wall_avoidance_obstacles")


def pair(robots, task="spot_finding_walls", seed=1):
    """The same robots in both physics, at random places."""
    random = np.random.default_rng(seed)
    ours = make_batch(task, robots)
    warp = WarpBatch(ours.model, ours.rules, robots)
    poses = random.uniform((-0.4, -0.25, -np.pi), (0.4, 0.25, np.pi), (robots, 3))
    if task == "wall_avoidance_obstacles":  # west of the pillars
        poses[:, 0] = random.uniform(-0.4, -0.3, robots)
    else:  # a tenth in the corners, where two walls are touched
        corners = random.choice((-1, 1), (robots // 10, 2)) * (0.49, 0.315)
        poses[: len(corners), :2] = corners
    spots = random.uniform((-0.4, -0.25), (0.4, 0.25), (robots, 2))
    for batch in (ours, warp):
        batch.place_spot(np.arange(robots), spots)
        batch.place(np.arange(robots), poses)
    ours.set_state(warp.arrays())  # lifted by 10 nm, as in Warp
    return ours, warp


def driven(steps, robots):
    """Motor values of robots that often drive ahead, others every ten steps."""
    random = np.random.default_rng(2)
    for _ in range(steps // 10):
        motors = random.uniform(-0.5, 0.5, (robots, 2)) + random.choice((0, 0.4), (robots, 1))
        yield from [motors] * 10


def turned(ours, theirs):
    """Angles between headings, in [-pi, pi]."""
    return (ours - theirs + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("task", TASKS)
def test_a_control_step_from_a_thousand_states_is_that_of_c_mujoco(task):
    """Robots that drive at random are at walls, in corners and at pillars."""
    robots, moments = 125, range(12, 100, 12)
    ours, warp = pair(robots, task)
    touch = ours.rules.layout.touch
    rest, contacts = np.delete(np.arange(ours.sensordata.shape[1]), touch), 0
    for step, motors in enumerate(driven(100, robots)):
        if step in moments:
            warp.set_state(ours.arrays())
            warp.step(motors)
        ours.step(motors)
        if step in moments:
            # Whether a wall is touched a physics step earlier may depend on rounding.
            moved = np.abs(warp.pose[:, :2] - ours.pose[:, :2]).max(axis=1)
            turn = np.abs(turned(warp.pose[:, 2], ours.pose[:, 2]))
            print(f"moved {1e3 * moved.max():.4f} mm, turned {turn.max():.6f} rad")
            near = (moved < 5e-6) & (turn < 1e-4)
            assert near.mean() >= 0.99 and moved.max() < 1e-3 and turn.max() < 0.05
            felt = (warp.sensordata[:, touch] > 0) == (ours.sensordata[:, touch] > 0)
            assert felt.mean() >= 0.99
            seen = np.abs(warp.sensordata - ours.sensordata)[near][:, rest]
            assert (seen < 2e-4).mean() > 0.999
            contacts += int((ours.sensordata[:, touch] > 0).sum())
    assert contacts > 100 and ours.valid.all() and warp.valid.all()


def test_a_minute_of_scripts_ends_where_c_mujoco_ends():
    """Circles, turns on the spot and drives along walls, at which rounding does not grow."""
    scripts = np.array([(0.3, 0.2), (0.25, -0.25), (-0.2, -0.3), (0.5, 0.4), (0.1, 0.12)])
    robots = len(scripts)
    ours, warp = pair(robots)
    middle = np.zeros((robots, 3))
    for batch in (ours, warp):
        batch.place(np.arange(robots), middle)
    ours.set_state(warp.arrays())
    for _ in range(600):
        ours.step(scripts)
        warp.step(scripts)
    moved = np.abs(warp.pose[:, :2] - ours.pose[:, :2]).max()
    turn = np.abs(turned(warp.pose[:, 2], ours.pose[:, 2])).max()
    assert moved < 1e-3 and turn < 0.01
    # Wheels have turned hundreds of times; their angles keep their precision.
    assert np.abs(warp.arrays()["state"][:, 8:10]).max() <= np.pi + 1e-6


def test_tensors_do_what_the_batch_on_the_host_does_and_read_no_number():
    ours, warp = pair(20)
    tensors = WarpTensors(ours)
    tensors.set_state(warp.arrays())
    random = np.random.default_rng(3)
    from torch.profiler import ProfilerActivity, profile

    for _ in range(15):
        motors = random.uniform(-0.6, 0.6, (20, 2))
        warp.step(motors)
        with profile(activities=[ProfilerActivity.CPU]) as profiled:
            tensors.step(torch.from_numpy(motors))
        operations = {event.key for event in profiled.key_averages()}
        assert not operations & {"aten::item", "aten::_local_scalar_dense", "aten::nonzero"}
    for name, array in warp.arrays().items():
        np.testing.assert_array_equal(tensors.arrays()[name], array, err_msg=name)


def test_tensors_refuse_a_batch_in_another_world():
    ours, _ = pair(1)
    ours.enter(World(wheels=(-1.0, 0.0, 0.0, 1.0)))
    with pytest.raises(ValueError, match="have the default world only"):
        WarpTensors(ours)


def test_dropped_contacts_are_an_error_that_ends_an_episode_of_gymnasium(monkeypatch):
    monkeypatch.setattr(engine, "_ROWS", 4)
    ours, warp = pair(3)
    words = "dropped contacts or constraints of 3 robots, the first is robot 0"
    with pytest.raises(CapacityError, match=words):
        warp.step(np.zeros((3, 2)))
    tensors = WarpTensors(ours)
    tensors.step(torch.zeros(3, 2))
    with pytest.raises(CapacityError, match="room is for 32 contacts and 4 rows"):
        tensors.stop(np.array([], dtype=int))
    gymnasium = pytest.importorskip("gymnasium")
    batch = gymnasium.make_vec("musebot/SpotFinding-v0", num_envs=2, backend="warp")
    batch.reset(seed=1)
    for error, words in ((PhysicsError, "dropped contacts"), (RuntimeError, "reset")):
        with pytest.raises(error, match=words):
            batch.step(np.zeros((2, 2), np.float32))


def test_gymnasiums_batch_runs_in_warp():
    pytest.importorskip("gymnasium")
    import gymnasium

    warp, ours = (
        gymnasium.make_vec("musebot/SpotFindingWalls-v0", num_envs=3, backend=backend)
        for backend in ("warp", "mujoco")
    )
    random = np.random.default_rng(6)
    first, _ = warp.reset(seed=1)
    np.testing.assert_array_equal(first, ours.reset(seed=1)[0])
    for _ in range(20):
        actions = random.uniform(-0.5, 0.5, (3, 2)).astype(np.float32)
        seen, *rest = warp.step(actions)
        np.testing.assert_allclose(seen, ours.step(actions)[0], atol=0.01)
    assert isinstance(seen, np.ndarray) and rest[0].shape == (3,)
    assert torch.from_dlpack(seen).shape == seen.shape
    with pytest.raises(ValueError, match="threads are of the backend 'mujoco' only, got 2"):
        gymnasium.make_vec("musebot/SpotFinding-v0", num_envs=3, backend="warp", threads=2)
    with pytest.raises(ValueError, match="backend must be 'mujoco' or 'warp', got 'mjx'"):
        gymnasium.make_vec("musebot/SpotFinding-v0", num_envs=3, backend="mjx")
