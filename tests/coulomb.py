"""An oracle of the body: a rigid planar robot on two tyres that obey Coulomb's law.

It shares neither code nor method with MuJoCo: contacts are impulses of rigid bodies, friction is
projected onto the disk of Coulomb's law, and the loads of the wheels follow from statics.
"""

import dataclasses

import numpy as np

GRAVITY = 9.81


@dataclasses.dataclass(frozen=True)
class PlanarRobot:
    """The robot of models/robot.xml as a planar body; SI units.

    Attributes:
      mass: Mass of the whole robot.
      inertia: Its moment about the vertical axis.
      wheel_mass: Inertia of a wheel with its motor over the square of the wheel's radius.
      base: Distance between the wheels.
      radius: Radius of the rim.
      stall: Force of a stalled motor for each unit of its motor value.
      drag: Loss of a motor's force for each m/s of the wheel's speed.
      friction: Coefficient of a tyre.
      push: Height at which a wall pushes.
      centre: Height of the centre of mass.
      castor: Distance of each castor from the axle.
      held: Load of both castors at rest together.
    """

    mass: float
    inertia: float
    wheel_mass: float
    base: float
    radius: float
    stall: float
    drag: float
    friction: float
    push: float
    centre: float
    castor: float
    held: float

    def loads(self, pitch, roll):
        """Returns the loads of the left and the right wheel, shape (K, 2).

        The moments, shape (K,), tip the robot forwards and to the left. Beyond what both castors
        hold at rest, one castor takes a forward or backward moment alone.
        """
        castors = np.maximum(np.abs(pitch) / self.castor, self.held)
        each = (self.mass * GRAVITY - castors) / 2
        return np.stack([each + roll / self.base, each - roll / self.base], axis=1).clip(min=0)


def closed_form(robot, load, angle, motor):
    """Returns the steady speed along a wall with equal motors and equal loads, without lean.

    The angle is that from head-on, in [rad]: Coulomb's law, the motors' line and the balance of
    forces along the heading.
    """
    speed = robot.stall * motor / robot.drag
    slip = speed - robot.friction * load * np.cos(angle) / robot.drag
    return np.maximum(slip, 0) * np.sin(angle)


def drive(robot, motors, start, seconds, half, lean, timestep=1e-4):
    """Drives K robots, each alone between four walls without friction.

    Args:
      robot: The planar robot.
      motors: Constant motor values, left and right, shape (K, 2).
      start: x, y in [m] and heading in [rad], at rest, shape (K, 3).
      seconds: Duration in [s].
      half: Half of the arena's length and width in [m].
      lean: Whether forces above the floor shift a robot's load, shape (K,).
      timestep: Duration of a step in [s].

    Returns poses, shape (T, K, 3), and loads of the wheels in [N], shape (T, K, 2), every 0.1 s.
    """
    # Complex numbers are vectors: x + iy in the arena, ahead + i left in a robot's frame.
    motors, start = np.asarray(motors, float), np.array(start, float)
    place, heading = start[:, 0] + 1j * start[:, 1], start[:, 2]
    count, room = len(start), np.asarray(half) - robot.radius
    side = robot.base / 2 * np.array([1, -1])  # of the left and the right wheel
    inertia = robot.wheel_mass + robot.drag * timestep  # the drag counts at the end of a step
    step = 0.6 / (1 / robot.mass + side[0] ** 2 / robot.inertia + 1 / inertia)
    velocity, turning, wheels = np.zeros(count, complex), np.zeros(count), np.zeros((count, 2))
    tyres = np.zeros((count, 2), complex)  # impulse of each tyre in the robot's frame
    loads = robot.loads(np.zeros(count), np.zeros(count))
    poses, history = [], []
    for number in range(1, round(seconds / timestep) + 1):
        ahead = np.exp(1j * heading)
        driven = (robot.wheel_mass * wheels + robot.stall * motors * timestep) / inertia
        towards, gap = np.sign(_parts(place)), room - np.abs(_parts(place))
        limit, most = robot.friction * loads * timestep, gap / timestep
        for left in (4, 3, 2, 1, 0):  # begins from the last step's impulses
            free = velocity + ahead * tyres.sum(axis=1) / robot.mass
            pushed = -towards * np.maximum(towards * _parts(free) - most, 0)
            moving = free + pushed.view(complex)[:, 0]
            spin = turning - tyres.real @ side / robot.inertia
            rolling = driven - tyres.real / inertia
            if not left:
                break
            slip = (moving * ahead.conj())[:, None] - (spin[:, None] * side + rolling)
            tyres = tyres - step * slip
            tyres *= np.minimum(1, limit / np.maximum(np.abs(tyres), 1e-30))
        before, velocity, turning, wheels = velocity, moving, spin, rolling
        place, heading = place + timestep * velocity, heading + timestep * turning
        # The wall pushes above the floor, and the centre of mass resists above it.
        pushes = pushed.view(complex)[:, 0] * robot.mass * robot.push
        resists = (velocity - before) * robot.mass * robot.centre
        moments = (pushes - resists) * ahead.conj() / timestep * np.asarray(lean)
        loads += 0.05 * (robot.loads(moments.real, moments.imag) - loads)  # within 2 ms
        if number % round(0.1 / timestep) == 0:
            poses.append(np.column_stack([place.real, place.imag, heading]))
            history.append(loads.copy())
    return np.stack(poses), np.stack(history)


def _parts(vectors):
    """Returns x and y of complex vectors, shape (K, 2)."""
    return vectors.view(float).reshape(-1, 2)
