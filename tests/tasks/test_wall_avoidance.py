"""Rewards and obstacles of the wall avoidance tasks."""

import numpy as np
import pytest

import musebot
from musebot.tasks import make_batch


def drive(task, motors, steps=1, **kwargs):
    environment = musebot.load("arena", task, task_kwargs={"random": 0, **kwargs})
    environment.reset()
    timesteps = [environment.step(np.asarray(motors)) for _ in range(steps)]
    return environment, timesteps


def observed(timesteps, name):
    return np.array([timestep.observation[name] for timestep in timesteps])


def test_the_unit_reward_is_0_in_contact_else_1():
    _, timesteps = drive("wall_avoidance_unit", [1.0, 1.0], 40, robot=(0.3, 0.0, 0.0))
    rewards = np.array([timestep.reward for timestep in timesteps])
    contact = observed(timesteps, "contact")[:, 0]
    assert set(rewards) == {0.0, 1.0}
    np.testing.assert_array_equal(rewards, 1 + contact)


def obstacles():
    return make_batch("wall_avoidance_obstacles", 1).dimensions.obstacles


@pytest.mark.parametrize("x, y, radius", obstacles())
def test_an_obstacle_is_seen_and_touched_and_blocks_the_robot(x, y, radius):
    start = (x - radius - 0.07, y, 0.0)
    environment, timesteps = drive("wall_avoidance_obstacles", [1.0, 1.0], 20, robot=start)
    distance = 0.07 - 0.0275
    first = musebot.load("arena", "wall_avoidance_obstacles", {"robot": start}).reset()
    signal = first.observation["distances"][0]
    assert signal == pytest.approx((1 + distance) ** -10, rel=1e-6)
    assert (observed(timesteps, "contact")[8:] == -1).all()
    assert (observed(timesteps, "distances")[8:, 0] > 0.97).all()  # at its surface, not inside
    rim = np.hypot(*(environment.physics.robot_pose()[:2] - [x, y])) - 0.0275
    assert rim == pytest.approx(radius, abs=0.001)


def test_the_driving_reward_is_the_speed_ahead():
    def reward(motors):
        _, timesteps = drive("wall_avoidance_obstacles", motors, 10, robot=(0.0, 0.25, 0.0))
        return timesteps[-1].reward, timesteps[-1].observation["speed"][0]

    assert reward([1.0, 1.0]) == pytest.approx((1, 1), abs=0.01)
    assert reward([0.5, 0.5]) == pytest.approx((0.5, 0.5), abs=0.01)
    assert reward([0.0, 0.0]) == pytest.approx((0, 0), abs=1e-6)
    assert reward([-1.0, -1.0]) == pytest.approx((0, -1), abs=0.01)
    assert reward([-1.0, 1.0]) == pytest.approx((0, 0), abs=0.01)


def test_pushing_an_obstacle_earns_nothing():
    x, y, radius = obstacles()[0]
    _, timesteps = drive(
        "wall_avoidance_obstacles", [1.0, 1.0], 30, robot=(x - radius - 0.04, y, 0.0)
    )
    assert timesteps[-1].reward == 0


@pytest.mark.parametrize("task", ["wall_avoidance", "wall_avoidance_obstacles"])
def test_every_force_on_the_rim_is_contact_however_small(task):
    rules = make_batch(task, 1).rules
    sensordata = np.zeros((4, 20))
    sensordata[:, rules.layout.touch] = [[0.0], [1e-12], [0.049], [1.0]]
    assert rules.event(sensordata).tolist() == [False, True, True, True]
    contact = rules.observations(sensordata)["contact"]
    np.testing.assert_array_equal(contact[:, 0], [0, -1, -1, -1])
