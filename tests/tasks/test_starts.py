"""Starts are fixed, a corner of the paper, or drawn for every episode."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

import musebot
from musebot.protocols.lives.schedules import UPPER_LEFT, UPPER_RIGHT
from musebot.tasks import make_batch
from musebot.tasks.starts import CORNERS, Start, random_poses, random_spots


@pytest.fixture(params=musebot.ALL_TASKS, ids="/".join)
def task(request):
    return request.param


def test_the_start_can_be_fixed(task):
    kwargs = {"robot": (0.1, 0.2, 1.0), "spot": (0.3, 0.2)}
    environment = musebot.load(*task, task_kwargs=kwargs)
    environment.reset()
    np.testing.assert_allclose(environment.physics.robot_pose(), kwargs["robot"], atol=1e-12)
    np.testing.assert_allclose(environment.physics.spot_position(), kwargs["spot"])


def test_the_start_can_be_a_corner_of_the_paper(task):
    assert CORNERS == {"upper_left": UPPER_LEFT, "upper_right": UPPER_RIGHT}
    kwargs = {"robot": "upper_left", "spot": "upper_right"}
    environment = musebot.load(*task, task_kwargs=kwargs)
    environment.reset()
    np.testing.assert_allclose(environment.physics.robot_pose(), UPPER_LEFT, atol=1e-12)
    np.testing.assert_allclose(environment.physics.spot_position(), UPPER_RIGHT[:2])


def test_every_episode_draws_a_new_start(task):
    environment = musebot.load(*task, task_kwargs={"random": 0})
    starts = set()
    for _ in range(5):
        environment.reset()
        starts.add((*environment.physics.robot_pose(), *environment.physics.spot_position()))
    assert len({start[:3] for start in starts}) == len({start[3:] for start in starts}) == 5


@pytest.mark.parametrize(
    "kwargs, message",
    [
        (
            {"robot": "middle"},
            r"robot must be one of \['upper_left', 'upper_right'\], got 'middle'",
        ),
        ({"robot": (0.0, 0.0)}, r"robot must be 3 finite numbers, got \(0.0, 0.0\)"),
        ({"spot": (0.0, np.nan)}, "spot must be 2 finite numbers"),
    ],
)
def test_an_impossible_start_is_refused(task, kwargs, message):
    with pytest.raises(ValueError, match=message):
        musebot.load(*task, task_kwargs=kwargs)


@pytest.mark.parametrize("place", ["upper_left", CORNERS["upper_left"]], ids=str)
def test_a_start_within_an_obstacle_is_refused_by_name_as_in_numbers(place):
    x, y, _ = CORNERS["upper_left"]
    size = make_batch("wall_avoidance_obstacles", 1).dimensions
    blocked = dataclasses.replace(size, obstacles=((x, y, 0.05),))
    with pytest.raises(ValueError, match="from the centre of the obstacle"):
        Start(robot=place).check(blocked)


def test_random_places_are_uniform_up_to_the_walls():
    size = make_batch("spot_finding", 1).dimensions
    random, count = np.random.default_rng(0), 5000
    clear = size.radius + 0.01
    for places, high in (
        (
            random_poses(random, size, count),
            (size.half_length - clear, size.half_width - clear, np.pi),
        ),
        (
            random_spots(random, size, count),
            (size.half_length - size.spot_radius, size.half_width - size.spot_radius),
        ),
    ):
        assert places.shape == (count, len(high))
        for column, most in zip(places.T, high, strict=True):
            assert stats.kstest(column, stats.uniform(-most, 2 * most).cdf).pvalue > 0.001
            assert 0.998 * most < np.abs(column).max() <= most


def test_random_poses_are_clear_of_obstacles_by_1_cm():
    size = make_batch("wall_avoidance_obstacles", 1).dimensions
    poses = random_poses(np.random.default_rng(0), size, 2000)
    for x, y, radius in size.obstacles:
        apart = np.hypot(poses[:, 0] - x, poses[:, 1] - y)
        assert apart.min() >= radius + size.radius + 0.01
        assert apart.min() < radius + size.radius + 0.03
