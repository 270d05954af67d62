"""Edits of the arena: obstacles."""

import mujoco

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
