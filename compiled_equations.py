"""The paper's brain in the kinematic simulator, compiled by Numba, robot by robot.

This file repeats equations of `controller`, `models.kinematic`, and of `sensors`, `world`,
`kinematic`, `batch`, `spot_finding` and `wall_avoidance` in `tasks`, for speed.
`tests/test_compiled_equations.py` compares the results of both. The file imports no other module of
the package, because Numba reuses compiled code until this file changes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

F = np.float32  # brains compute in single precision; F turns a number into one


def _compiled(**options: Any) -> Any:
    """Returns a decorator that compiles, and keeps what it compiled where a folder can be written.

    Elsewhere, each process compiles anew.
    """

    def decorate(function: Any) -> Any:
        try:
            return numba.njit(function, error_model="numpy", cache=True, **options)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            return numba.njit(function, error_model="numpy", **options)

    return decorate


# In brains, sums may be reordered and fused; NaN and infinity keep their meaning.
_brain = _compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
_body = _compiled()

# ---- The brain ----


@_brain
def logistic(x):
    """Returns 1 / (1 + exp(-x)), as 1/2 + tanh(x / 2) / 2, with an error below 3e-7.

    The tanh is a rational function, as in the library Eigen: it has no branch, so that the compiler
    computes several at a time.
    """
    x = min(max(x * F(0.5), F(-7.9053111)), F(7.9053111))
    q = x * x
    p = F(-2.76076847742355e-16)
    p = p * q + F(2.00018790482477e-13)
    p = p * q + F(-8.60467152213735e-11)
    p = p * q + F(5.12229709037114e-08)
    p = p * q + F(1.48572235717979e-05)
    p = p * q + F(6.37261928875436e-04)
    p = p * q + F(4.89352455891786e-03)
    r = F(1.19825839466702e-06)
    r = r * q + F(1.18534705686654e-04)
    r = r * q + F(2.26843463243900e-03)
    r = r * q + F(4.89352518554385e-03)
    return F(0.5) + F(0.5) * x * p / r


# A network's weights are one row, as in `Networks.weights`: hidden weights, hidden biases, output
# weights, output biases.


@_brain
def ideas(net, state, pool, rows, hidden, motors):
    """Writes the memory's ideas into `motors`, (2, A); see `CreativeMemory.ideas`.

    Idea a has the noise pattern in row `rows[a]` of `pool`; `hidden` is scratch space, (H, A).
    """
    neurons, count = hidden.shape
    width = state.size
    biases = neurons * width
    first = biases + neurons
    for h in range(neurons):
        main = net[biases + h]
        for i in range(width):
            main += net[h * width + i] * state[i]
        for a in range(count):
            total = main
            for i in range(width):
                total += pool[rows[a], h * width + i] * state[i]
            hidden[h, a] = total
        for a in range(count):
            hidden[h, a] = logistic(hidden[h, a])
    for o in range(2):
        motors[o, :] = net[first + 2 * neurons + o]
        for h in range(neurons):
            weight, noisy = net[first + o * neurons + h], biases + o * neurons + h
            for a in range(count):
                motors[o, a] += (weight + pool[rows[a], noisy]) * hidden[h, a]
        for a in range(count):
            motors[o, a] = logistic(motors[o, a]) - F(0.5)


@_brain
def evaluate(net, state, motors, values):
    """Writes the values of actions into `values`, (A,); see `EvaluationNetwork.values`."""
    width = state.size + 2
    neurons = (net.size - 1) // (width + 2)
    biases = neurons * width
    values[:] = net[biases + 2 * neurons]
    for h in range(neurons):
        main, own = net[biases + h], net[h * width : (h + 1) * width]
        for i in range(state.size):
            main += own[i] * state[i]
        left, right, weight = own[-2], own[-1], net[biases + neurons + h]
        for a in range(values.size):
            values[a] += weight * logistic(main + left * motors[0, a] + right * motors[1, a])


@_brain
def forward(net, inputs, hidden, outputs):
    """Writes hidden activations, (H,), and output sums, (O,); see `Networks.forward`."""
    neurons, width = hidden.size, inputs.size
    biases = neurons * width
    first = biases + neurons
    for h in range(neurons):
        total = net[biases + h]
        for i in range(width):
            total += net[h * width + i] * inputs[i]
        hidden[h] = logistic(total)
    for o in range(outputs.size):
        outputs[o] = net[first + outputs.size * neurons + o]
        for h in range(neurons):
            outputs[o] += net[first + o * neurons + h] * hidden[h]


@_brain
def ascend(net, inputs, hidden, steps):
    """Moves a network's weights along the gradient of its output sums; see `Networks.ascend`."""
    width, neurons, count = inputs.size, hidden.size, steps.size
    biases = neurons * width
    first = biases + neurons
    for h in range(neurons):
        back = F(0)
        for o in range(count):
            back += steps[o] * net[first + o * neurons + h]
            net[first + o * neurons + h] += steps[o] * hidden[h]
        back *= hidden[h] * (F(1) - hidden[h])
        net[biases + h] += back
        for i in range(width):
            net[h * width + i] += back * inputs[i]
    for o in range(count):
        net[first + count * neurons + o] += steps[o]


@_brain
def scratch(inputs, neurons, count):
    """Returns scratch arrays: for selecting among A actions, and for learning."""
    evaluation, memory = neurons
    acting = np.empty((2, count), F), np.empty((memory, count), F), np.empty(count, F)
    patterns = np.zeros((count, memory * (inputs + 2)), F), np.arange(count)
    hidden = np.empty(evaluation, F), np.empty(memory, F)
    return (*acting, patterns), (np.empty(inputs + 2, F), hidden, np.empty(1, F), np.empty(2, F))


@_brain
def act(nets, space, state, draws, robot, now):
    """Selects a robot's action among proposed ones, and records it in the robot's row of `now`."""
    evaluation, memory, (pool, fixed), _, _ = nets
    rows, actions, exploring = draws
    motors, hidden, values, (patterns, each) = space
    if len(fixed):  # the signs that were drawn, at the robot's own connections
        patterns[:] = 0
        for a in each:
            for noisy in range(fixed.shape[1]):
                patterns[a, fixed[robot, noisy]] = pool[rows[robot, a], noisy]
        ideas(memory[robot], state, patterns, each, hidden, motors)
    elif rows.size:
        ideas(memory[robot], state, pool, rows[robot], hidden, motors)
    else:
        motors[:] = actions[robot % len(actions)].T
    evaluate(evaluation[robot], state, motors, values)
    chosen = exploring[robot]
    if chosen < 0:
        chosen = np.argmax(values)
    states, selected, value, chained = now
    states[robot], selected[robot] = state, motors[:, chosen]
    value[robot], chained[robot] = values[chosen], F(1)


@_brain
def learn(nets, space, reward, robot, before, now):
    """Trains a robot's networks on step `before`: evaluation (Eq. 1) and memory (section 3).

    Returns the TD error.
    """
    evaluation, memory, _, discount, rate = nets
    states, selected, _, chained = before
    _, _, following, _ = now
    inputs, (hidden, recalling), value, outputs = space
    state, action = states[robot], selected[robot]
    inputs[:-2], inputs[-2:] = state, action
    forward(evaluation[robot], inputs, hidden, value)
    error = chained[robot] * (reward + discount * following[robot] - value[0])
    value[0] = rate * error
    ascend(evaluation[robot], inputs, hidden, value)
    if memory.size:
        forward(memory[robot], state, recalling, outputs)
        for o in range(2):
            output = logistic(outputs[o])
            outputs[o] = error * (action[o] + F(0.5) - output) * output * (F(1) - output)
        ascend(memory[robot], state, recalling, outputs)
    return error


@_brain
def act_all(nets, neurons, state, draws, now):
    """Selects the actions of all robots in the first of the drawn steps."""
    rows, actions, exploring = draws
    space, _ = scratch(state.shape[1], neurons, rows.shape[2] or actions.shape[2])
    for robot in range(len(state)):
        act(nets, space, state[robot], (rows[0], actions[0], exploring[0]), robot, now)


@_brain
def learn_all(nets, neurons, reward, before, now, error):
    """Trains the networks of all robots, and writes the TD errors into `error`, shape (B,)."""
    states, _, _, _ = before
    _, space = scratch(states.shape[1], neurons, 1)
    for robot in range(len(reward)):
        error[robot] = learn(nets, space, reward[robot], robot, before, now)


# ---- The kinematic simulator ----

# Walls in the order of `models.kinematic.WALLS`.
HOLDS, SLIDES, STICKS, SLIPS, REFUSES = range(5)
# Sensors in a row of `sensordata`.
DISTANCES, TOUCH, SMELL = 0, 4, 5


class Body(NamedTuple):
    """A robot in its arena, in [m]."""

    length: float  # largest |x| of the robot's centre
    width: float  # largest |y| of the robot's centre
    wheel_base: float
    speed: float  # of a wheel for a motor value of 1, in [m/s]
    radius: float
    nose: float  # distance of the nose from the centre
    margin: float  # gap to a wall below which the robot is near it


class Motion(NamedTuple):
    """How a robot moves, see `models.kinematic.Kinematics`."""

    wall: int  # index in `models.kinematic.WALLS`
    pushed: bool  # whether contact is felt where the wheels push into a wall
    any_contact: bool
    arc: bool  # whether a path is an arc
    seconds: float  # duration of one of the `pieces` of a control step
    pieces: int
    late: float  # share of a wheel's initial speed error that remains, mean over a piece
    behind: float  # the same at the end of a piece
    grip: float


class Task(NamedTuple):
    """What a robot senses and what is rewarded, see `tasks.sensors.Nose`."""

    smells: bool
    sees: bool  # whether it senses distances and contact
    odour: float
    frustum: float
    spot: float  # radius in [m]
    printed: bool  # whether the smell has the printed form of Eq. 3


@_body
def _share(start, step, room):
    """Returns the share of a step, along one axis, after which a robot meets the wall."""
    return (math.copysign(room, step) - start) / step if step else 1.0


@_body
def drive(body, motion, pose, left, right):
    """Moves a robot along a path as `models.kinematic.drive`; returns whether it pushes a wall."""
    length, width, wall, seconds = body.length, body.width, motion.wall, motion.seconds
    turn = (right - left) * body.speed / body.wheel_base * seconds
    ahead, along = (left + right) * body.speed / 2 * seconds, pose[2]
    if motion.arc:
        half = turn / 2
        ahead, along = ahead * (math.sin(half) / half if half else 1.0), along + half
    x, y = ahead * math.cos(along), ahead * math.sin(along)
    pushing = abs(pose[0] + x) > length or abs(pose[1] + y) > width
    if not (pushing and wall == STICKS):
        pose[2] += turn
    if pushing and wall == REFUSES:
        return True
    if pushing and wall != SLIDES:
        first, second = _share(pose[0], x, length), _share(pose[1], y, width)
        share = min(max(min(first, second), 0.0), 1.0)
        pose[0] += share * x
        pose[1] += share * y
        x, y = (1 - share) * x, (1 - share) * y  # what the wall prevents
        if wall == SLIPS and share < 1:
            grip = (1 - share) * seconds * motion.grip
            x, y = slip(x, y, grip, first <= share, second <= share)
        else:
            x, y = 0.0, 0.0
    pose[0] = min(max(pose[0] + x, -length), length)
    pose[1] = min(max(pose[1] + y, -width), width)
    return pushing


@_body
def slip(x, y, grip, lengthwise, across):
    """Returns how far a robot slips along a wall; see `models.kinematic.slip`.

    `grip` is multiplied by the seconds of driving into the wall; `lengthwise` and `across` say
    whether the robot meets a wall that limits x, and one that limits y.
    """
    square = x * x + y * y
    if square == 0:
        return 0.0, 0.0
    ahead = math.hypot(x if lengthwise else 0.0, y if across else 0.0)
    kept = max(1 - grip * ahead / square, 0.0)
    return (0.0 if lengthwise else x * kept), (0.0 if across else y * kept)


@_body
def move(body, motion, pose, wheels, left, right):
    """Moves a robot for a control step; see `tasks.kinematic.after_control_step`.

    Returns whether the robot is in contact.
    """
    late, behind, contact = motion.late, motion.behind, False
    for _ in range(motion.pieces):
        missing = wheels[0] - left, wheels[1] - right
        mean = left + missing[0] * late, right + missing[1] * late
        wheels[0], wheels[1] = left + missing[0] * behind, right + missing[1] * behind
        pushing = drive(body, motion, pose, mean[0], mean[1])
        gap = min(body.length - abs(pose[0]), body.width - abs(pose[1]))
        felt = pushing if motion.pushed else gap <= body.margin
        contact = (contact and motion.any_contact) or felt
    return contact


@_body
def measure(body, pose, spot, touch, sensors):
    """Writes what a robot measures; see `tasks.kinematic.measure`."""
    radius = body.radius
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    rays = ((cosine, sine), (-cosine, -sine), (-sine, cosine), (sine, -cosine))
    for number, (x, y) in enumerate(rays):
        along = (math.copysign(body.length + radius, x) - pose[0]) / x
        across = (math.copysign(body.width + radius, y) - pose[1]) / y
        sensors[DISTANCES + number] = max(min(along, across) - radius, 0.0)
    sensors[TOUCH] = touch
    x, y = spot[0] - pose[0], spot[1] - pose[1]
    sensors[SMELL] = cosine * x + sine * y - body.nose
    sensors[SMELL + 1] = cosine * y - sine * x


@_body
def move_all(body, motion, robots, motors):
    """Moves all robots for a control step and writes what they measure; `motors` are (B, 2)."""
    poses, wheels, touch, spots, sensordata, _ = robots
    for robot in range(len(poses)):
        pose, (left, right) = poses[robot], motors[robot]
        touch[robot] = move(body, motion, pose, wheels[robot], left, right)
        measure(body, pose, spots[robot], touch[robot], sensordata[robot])


@_body
def sense(task, turn, sensors, state):
    """Writes a robot's state, shape (S,); returns its reward, and whether the measured event holds.

    `turn` holds cosine and sine of the nose's angle on the rim, and the nose's distance from the
    centre.
    """
    smells, odour, spot = task.smells, task.odour, task.spot
    cosine, sine, nose = turn
    touched = sensors[TOUCH] > 0
    reward, event = -1.0 if touched else 0.0, touched
    if task.sees:
        for number in range(4):
            base = 1 + max(sensors[DISTANCES + number], 0.0)
            square = base * base
            fourth = square * square
            state[smells + number] = 1 / (fourth * fourth * square)
        state[smells + 4] = reward
    if smells:
        x, y = sensors[SMELL], sensors[SMELL + 1]
        if sine:
            x, y = cosine * (x + nose) + sine * y - nose, cosine * y - sine * (x + nose)
        distance = math.sqrt(x * x + y * y)
        event = distance < spot
        ratio = spot / max(distance, spot)
        ratio = 1 / ratio if task.printed else ratio
        raw = odour * ratio * max(1 - 2 * abs(math.atan2(y, x)) / task.frustum, 0.0)
        raw = odour if event else raw
        state[0] = raw / (1 + raw)
        reward = 0.0 if task.sees and touched else raw / (1 + raw)
    return reward, event


@_body
def simulate(world, robots, brain, draws, learning, counts):
    """Simulates control steps of robots, one robot after the other; counts their events.

    Args:
      world: `Body`, `Motion`, `Task`, the wheels of the `World` in single precision, and `turn` of
        `sense`.
      robots: Arrays of `KinematicBatch.compiled_arguments`: poses, wheels, contacts, spots, sensor
        data, and whether robots are valid. All but the spots are changed in place.
      brain: Tuple of `nets`, `neurons` and `now` (the present step) of a `CompiledNeurocontroller`.
      draws: Random numbers of K steps, which `CompiledNeurocontroller.draw` returned.
      learning: True if the brains learn in all K steps, False if they learn in none.
      counts: Number of steps in which each robot's measured event has held so far, shape (B,);
        increased in place.
    """
    body, motion, task, (a, b, c, d), turn = world
    poses, wheels, touch, spots, sensordata, valid = robots
    nets, neurons, now = brain
    rows, actions, exploring = draws
    states, selected, values, chained = now
    acting, lesson = scratch(states.shape[1], neurons, rows.shape[2] or actions.shape[2])
    past, done, linked = states.copy(), selected.copy(), chained.copy()
    before = past, done, values, linked
    state = np.empty_like(states[0])
    for robot in range(len(poses)):
        pose, sensors = poses[robot], sensordata[robot]
        reward, event = sense(task, turn, sensors, state)
        for step in range(len(exploring)):
            past[robot], done[robot], linked[robot] = states[robot], selected[robot], chained[robot]
            drawn = rows[step], actions[step], exploring[step]
            act(nets, acting, state, drawn, robot, now)
            if learning:
                learn(nets, lesson, F(reward), robot, before, now)
            left, right = selected[robot]
            valid[robot] &= math.isfinite(left) and math.isfinite(right)
            if valid[robot]:
                left, right = a * left + b * right, c * left + d * right
                left, right = min(max(left, F(-0.5)), F(0.5)), min(max(right, F(-0.5)), F(0.5))
                motors = np.float64(left), np.float64(right)
                touch[robot] = move(body, motion, pose, wheels[robot], *motors)
                measure(body, pose, spots[robot], touch[robot], sensors)
            else:
                pose[:], wheels[robot], touch[robot], sensors[:] = 0, 0, 0, 0
            reward, event = sense(task, turn, sensors, state)
            counts[robot] += event
