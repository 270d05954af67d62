"""Edits of the arena: obstacles and a larger arena."""

import dataclasses
import functools

import mujoco
import numpy as np
import pytest

from musebot.models import Dimensions, arena_spec, enlarge
from musebot.tasks import make_batch
from musebot.tasks.suite import TASKS


def test_obstacles_are_fixed_and_do_not_touch_the_wheels():
    model = TASKS["wall_avoidance_obstacles"].spec().compile()
    for number in (1, 2, 3):
        assert model.body(f"obstacle_{number}").dofnum[0] == 0
        core = model.geom(f"obstacle_{number}_core")
        wheel = model.geom("left_wheel")
        assert not (core.contype[0] & wheel.conaffinity[0]) | (
            wheel.contype[0] & core.conaffinity[0]
        )
    assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, "velocity") >= 0


@pytest.mark.parametrize("task", ["wall_avoidance", "wall_avoidance_obstacles"])
def test_enlarge_changes_the_size_of_the_arena_only(task):
    small, large = (
        Dimensions.of(TASKS[task].spec(edits=edits).compile())
        for edits in ((), (functools.partial(enlarge, factor=4 / 3),))
    )
    assert large.half_length == pytest.approx(0.70)
    assert large.half_width == pytest.approx(0.35 * 4 / 3)
    same = {"half_length": small.half_length, "half_width": small.half_width}
    assert dataclasses.replace(large, **same) == small


def enlarged(factor, task="wall_avoidance"):
    return make_batch(task, 8, edits=(functools.partial(enlarge, factor=factor),))


def test_rangefinders_see_the_walls_of_a_larger_arena():
    batch = enlarged(2.0)
    size, layout = batch.dimensions, batch.rules.layout
    for heading, walls in ((0.0, "xXYy"), (np.pi / 2, "YyXx")):
        batch.place(np.arange(8), np.tile([0.3, 0.2, heading], (8, 1)))
        away = {
            "x": size.half_length - 0.3,
            "X": size.half_length + 0.3,
            "y": size.half_width + 0.2,
            "Y": size.half_width - 0.2,
        }
        expected = [away[wall] - size.radius for wall in walls]
        np.testing.assert_allclose(batch.sensordata[0, layout.distances], expected, atol=1e-6)
    backs = mujoco.mj_name2id(batch.model, mujoco.mjtObj.mjOBJ_GEOM, "east_back")
    assert batch.model.geom_pos[backs, 0] == pytest.approx(size.half_length + 0.001)


def test_robots_reach_the_walls_of_a_larger_arena_and_stay_inside():
    batch = enlarged(4 / 3)
    size = batch.dimensions
    angles = np.arange(8) * np.pi / 4
    batch.place(np.arange(8), np.stack([0 * angles, 0 * angles, angles], axis=1))
    for _ in range(100):
        batch.step(np.full((8, 2), 0.5))
    assert batch.valid.all()
    reached = np.abs(batch.pose[:, :2])
    room = np.array([size.half_length, size.half_width]) - size.radius
    assert (reached < room + 1e-3).all()
    assert (np.abs(reached - room) < 2e-3).any(axis=1).all()
    assert batch.rules.event(batch.sensordata).all()


def test_the_drawn_walls_of_a_larger_arena_are_where_its_walls_are():
    spec = arena_spec()
    enlarge(spec, 2.0)
    model = spec.compile()
    for name, axis in (("east", 0), ("west", 0), ("north", 1), ("south", 1)):
        wall, drawn = model.geom(name).pos[axis], model.site(name)
        assert abs(drawn.pos[axis]) - drawn.size[axis] == pytest.approx(abs(wall))
        across = model.geom("north" if axis == 0 else "east").pos[1 - axis]
        assert drawn.size[1 - axis] >= across
    assert model.geom("floor").size[0] > 1.05 and model.geom("floor").size[1] > 0.70


def test_enlarge_refuses_a_factor_below_1():
    spec = arena_spec()
    before = spec.to_xml()
    for factor in (0.9, 0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="factor must be finite and at least 1, got"):
            enlarge(spec, factor)
    assert spec.to_xml() == before


def test_a_larger_arena_stays_in_the_picture_and_its_spot_in_the_corner():
    small, large = arena_spec(), arena_spec()
    enlarge(large, 2.0)
    small, large = small.compile(), large.compile()
    for name in ("overhead", "corner"):
        np.testing.assert_allclose(large.camera(name).pos, 2 * small.camera(name).pos)
    corner = np.array([Dimensions.of(small).half_length, Dimensions.of(small).half_width])
    gaps = [k * corner - m.body("spot").pos[:2] for k, m in ((1, small), (2, large))]
    np.testing.assert_allclose(gaps[0], gaps[1])
