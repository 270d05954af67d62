"""A fingerprint of the physics, which distinguishes runs of different versions."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from ...models import Kinematics
from .experiment import Body, Experiment

_IDEAL = Kinematics()


@functools.cache
def physics_probe(body: Body = "mujoco", kinematics: Kinematics = _IDEAL) -> tuple[float, ...]:
    """Drives a robot into a wall and returns its pose and sensor readings there.

    A changed mass, friction or timestep changes these numbers; a changed colour does not. With
    non-default kinematics, robots also drive along a wall at several angles.
    """
    experiment = Experiment(body=body, kinematics=kinematics)
    batch = experiment.batch("spot_finding", 1)
    if body == "kinematic":  # as in the first stored fingerprints
        batch.place_spot(np.array([0]), np.zeros((1, 2)))
    batch.place(np.array([0]), np.array([[0.42, 0.05, 0.3]]))
    for motors in ((0.5, 0.4), (0.5, 0.5), (-0.2, 0.5), (0.1, -0.5)):
        for _ in range(4):
            batch.step(np.array([motors]))
    numbers = *batch.pose[0].tolist(), *batch.sensordata[0].tolist()
    if kinematics == _IDEAL:
        return numbers
    angles = np.radians(np.arange(5, 90, 10))
    grazing = experiment.batch("spot_finding", len(angles))
    east = np.full(len(angles), grazing.dimensions.half_length - grazing.dimensions.radius)
    grazing.place(np.arange(len(angles)), np.column_stack([east, 0 * east, angles]))
    for motor in (0.5, 0.3):
        for _ in range(4):
            grazing.step(np.full((len(angles), 2), motor))
    return (*numbers, *grazing.pose.ravel().tolist())


def is_physics_of(probe: Sequence[float], experiment: Experiment) -> bool:
    """Returns whether a stored probe equals this version's `physics_probe` of an experiment."""
    ours = physics_probe(experiment.body, experiment.kinematics)
    return np.shape(ours) == np.shape(probe) and bool(np.allclose(probe, ours, rtol=0, atol=1e-6))
