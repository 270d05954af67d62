"""Two noses, wall sensing and the jumping spot of the spot finding tasks."""

import numpy as np
import pytest

import musebot


def drive(task, motors, steps=1, **kwargs):
    environment = musebot.load("arena", task, task_kwargs={"random": 0, **kwargs})
    environment.reset()
    timesteps = [environment.step(np.asarray(motors)) for _ in range(steps)]
    return timesteps


@pytest.mark.parametrize("side, stronger", [(1, 0), (-1, 1)])
def test_the_nose_nearer_to_the_spot_smells_more(side, stronger):
    first = musebot.load(
        "arena",
        "spot_finding_two_noses",
        {"robot": (0.0, 0.0, 0.0), "spot": (0.25, side * 0.04)},
    ).reset()
    noses = first.observation["noses"]
    assert noses[stronger] > 1.2 * noses[1 - stronger] > 0


def test_the_reward_of_two_noses_is_their_mean():
    """Eq. 3 with r/d for each nose, of its angle and its distance to the spot's centre."""
    place = {"robot": (0.0, 0.0, 0.0), "spot": (0.25, 0.04)}
    environment = musebot.load("arena", "spot_finding_two_noses", place)
    noses = environment.reset().observation["noses"]
    assert noses[0] > 3 * noses[1] > 0
    timestep = environment.step(np.zeros(2))
    assert timestep.reward == pytest.approx((noses[0] + noses[1]) / 2, rel=0.01)


def test_both_noses_signal_equally_ahead_and_maximally_inside():
    ahead = {"robot": (0.0, 0.0, 0.0), "spot": (0.25, 0.0)}
    noses = musebot.load("arena", "spot_finding_two_noses", ahead).reset().observation["noses"]
    assert noses[0] == pytest.approx(noses[1], abs=1e-12) and noses[0] > 0
    inside = {"robot": (0.0, 0.0, 0.0), "spot": (0.02, 0.0)}
    timesteps = drive("spot_finding_two_noses", [0.0, 0.0], **inside)
    assert timesteps[-1].reward == pytest.approx(10 / 11)


def test_with_wall_sensing_the_reward_is_0_in_contact():
    kwargs = {"robot": (0.45, 0.0, 0.0), "spot": (0.49, 0.0)}
    timesteps = drive("spot_finding_walls", [1.0, 1.0], 10, **kwargs)
    assert timesteps[0].reward > 0.9 and timesteps[-1].reward == 0
    assert timesteps[-1].observation["nose"][0] > 0.9  # the nose still signals
    assert timesteps[-1].observation["contact"][0] == -1


def test_the_spot_jumps_every_20_seconds_and_rests_in_between():
    environment = musebot.load("arena", "spot_finding_jumping", task_kwargs={"random": 0})
    for _ in range(2):  # two episodes
        environment.reset()
        spots = []
        for _ in range(1000):
            environment.step(np.zeros(2))
            spots.append(tuple(environment.physics.spot_position()))
        changes = [k for k in range(1, 1000) if spots[k] != spots[k - 1]]
        assert changes == [200, 400, 600, 800]  # at the first action of the 21st second, and so on
        assert len(set(spots)) == 5
