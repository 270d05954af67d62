"""Hostile calls of the environments, compared with what they promise.

The promise: a call that cannot be carried out raises one error, a ValueError or a TypeError with
a sentence, or a RuntimeError for a step before a reset or after `close`; every other call returns
finite numbers. What Gymnasium refuses before it calls musebot has Gymnasium's own errors.
"""

import contextlib
import functools
import io
import traceback
import warnings
from pathlib import Path

import numpy as np
from hostile import oracle
from hostile.oracle import one
from torch.utils._pytree import tree_leaves

import musebot
from musebot.models import Dimensions, Kinematics
from musebot.tasks.episode import _REFUSALS
from musebot.tasks.kinematic import make_kinematic_batch
from musebot.tasks.suite import TASKS, make_batch

SEED = 20042
NAN, INF = float("nan"), float("inf")

VALUES = (
    None, 0, 1, -1, 2, 3, 5, 1.5, 0.5, NAN, INF, -INF, 1e400, -1e-300, 10**400, True, False, "",
    "3", "upper_left", "lower_left", "inverse", "printed", "x" * 5000, b"x", (), (0, 0), (0, 0, 0),
    (5, 5, 0), (0.3, 0.1, 1.0), (0.5249, 0, 0), (0, NAN, 0), (5, 5), (0.1, 0.1), ("a", "b", "c"),
    [[0, 0, 0]], {}, {"a": 1}, object, np.zeros(3), np.full(2, np.nan), np.array("x"), 1j,
    lambda: 0, np.int64(3), np.float32(0.1), 2**31, -(2**63), 2**64, [], [1, 2], np.array(1),
)  # fmt: skip
ACTIONS = (
    *VALUES, np.array([0.5, -0.5]), [0.5, 0.5], np.array([NAN, 0.0]), np.array([INF, 0]),
    [1e300, 0], np.array([0.1 + 1j, 0]), np.array(["a", "b"]), np.array([1, 2], dtype=object),
    np.zeros((1, 2)), np.zeros((2, 2)), np.zeros(3), np.zeros((2, 3)), np.zeros((2, 1)),
    [[0.1, 0.1], [NAN, 0]], np.array([True, False]), np.array([1, -1], dtype=np.int8),
    np.ma.masked_array([0.1, 0.1], [1, 0]), np.array([0, 0], dtype="M8[s]"), np.float16([6e4, 0]),
    [None, 0], [[0.1], [0.1, 0.2]],
)  # fmt: skip
KEYWORDS = "random time_limit robot spot nose nothing environment_kwargs".split()
OF_ENVIRONMENT = "control_timestep n_sub_steps flat_observation legacy_step time_limit x".split()
OF_GYMNASIUM = (
    "robot spot nose render_mode camera width height max_episode_steps task disable_env_checker "
    "nothing"
).split()
OF_VECTOR = "robot spot nose render_mode max_episode_steps autoreset_mode threads".split()


def _kwargs(draw, names, most=2):
    count = 0 if draw.random() < 0.5 else draw.integers(1, most + 1)
    return {one(draw, names): one(draw, VALUES) for _ in range(count)}


def _actions(draw, sound):
    """Returns three actions, one of them hostile in half of the cases."""
    actions = [sound] * 3
    if draw.random() < 0.5:
        actions[draw.integers(3)] = one(draw, ACTIONS)
    return actions


def _dm(draw):
    task, kwargs = one(draw, [*TASKS]), _kwargs(draw, KEYWORDS)
    environment = _kwargs(draw, OF_ENVIRONMENT) if draw.random() < 0.3 else None
    domain = "arena" if draw.random() < 0.95 else one(draw, VALUES)
    task = task if draw.random() < 0.95 else one(draw, VALUES)
    actions = _actions(draw, np.full(2, 0.3))
    first = draw.random() < 0.1

    def call():
        env = musebot.load(domain, task, kwargs, environment)
        given = [] if first else [env.reset()]
        given += [env.step(action) for action in actions]
        pose = env.physics.data.qpos
        size = Dimensions.of(env.physics.model.ptr)
        assert abs(pose[0]) < size.half_length and abs(pose[1]) < size.half_width, "outside"
        return [(step.observation, step.reward) for step in given], pose

    return call, (domain, task, kwargs, environment, actions, first)


def _called(env, actions, order, kept, **start):
    """Returns what `reset` and `step` give; order 0 leaves the reset out, order 1 closes early."""
    given = [] if order == 0 else [env.reset(**start)[0]]
    if order == 1:
        env.close()
    given += [env.step(action)[:kept] for action in actions]
    env.close()
    return given


def _gymnasium(draw, vector):
    import gymnasium

    name = one(draw, [*musebot.GYMNASIUM_TASKS])
    kwargs = _kwargs(draw, OF_VECTOR if vector else OF_GYMNASIUM)
    actions = _actions(draw, np.full((2, 2) if vector else 2, 0.3))
    starts = ("seed",) if vector else ("seed", "options")
    start = {part: one(draw, VALUES) if draw.random() < 0.15 else None for part in starts}
    count = one(draw, [v for v in VALUES if v is not None]) if draw.random() < 0.2 else 2
    if isinstance(count, int) and count > 10**6:
        count = 2  # rightly out of memory
    order = int(draw.integers(12))

    def call():
        if not vector:
            return _called(gymnasium.make(f"musebot/{name}", **kwargs), actions, order, 2, **start)
        sound = dict(num_envs=count, vectorization_mode="vector_entry_point")
        env = gymnasium.make_vec(f"musebot/{name}", **sound, **kwargs)
        return _called(env, actions, order, 3, **start)

    return call, (name, count, kwargs, start, actions, order)


def _batch(draw):
    task, robots = one(draw, [*TASKS]), 2
    kwargs = {one(draw, ("nose", "motor_speed")): one(draw, VALUES)} if draw.random() < 0.4 else {}
    if draw.random() < 0.15:
        robots = one(draw, [v for v in VALUES if not (isinstance(v, int) and v > 10**6)])
    kinematic = draw.random() < 0.4
    place, spot = (one(draw, VALUES) if draw.random() < 0.3 else None for _ in range(2))
    motors = _actions(draw, np.full((2, 2), 0.3))

    def call():
        if kinematic:
            batch = make_kinematic_batch(task, robots, Kinematics(), **kwargs)
        else:
            batch = make_batch(task, robots, **kwargs)
        everyone = np.arange(batch.robots)
        if spot is not None:
            batch.place_spot(everyone, spot)
        if place is not None:
            batch.place(everyone, place)
        given = []
        for motor in motors:
            batch.step(motor)
            given += [rule(batch.sensordata) for rule in (batch.rules.state, batch.rules.reward)]
        return given, batch.pose[batch.valid]

    return call, (task, robots, kwargs, kinematic, place, spot, motors)


# Each draws a call, and returns the function that makes it, and what it is called with.
KINDS = {
    "load": _dm,
    "gymnasium.make": functools.partial(_gymnasium, vector=False),
    "make_vec": functools.partial(_gymnasium, vector=True),
    "batch": _batch,
}


def case(kind, number):
    """Carries out one case of a kind; returns the class of what happened, and a sentence."""
    draw = np.random.default_rng([SEED, [*KINDS].index(kind), number])
    call, arguments = KINDS[kind](draw)
    said = f"{kind} {number}: {arguments!r:.1000}"
    found, error = None, None
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            with oracle.limited():
                found = call()
        except oracle.OutOfTime:
            return "wrong: slow", said
        except Exception as caught:
            error = caught
    return _judged(found, error), f"{said}: {error!r:.600}"


def _judged(found, error):
    if error is None:
        arrays = [np.asarray(leaf) for leaf in tree_leaves(found)]
        sound = all(np.isfinite(array).all() for array in arrays if array.dtype.kind in "fiub")
        return "carried out, finite" if sound else "wrong: numbers that are not finite"
    name = type(error).__name__
    if not str(error):
        return "wrong: an error without a sentence"
    if type(error) in (ValueError, TypeError) or str(error) in _REFUSALS.values():
        return f"refused by {name}"
    if type(error).__module__.startswith("gymnasium") or not _reached(error):
        return f"refused by Gymnasium's own {name}"
    return f"wrong: {name}"


def _reached(error):
    """Returns whether an error was raised in a call of musebot, not by Gymnasium alone."""
    package = Path(musebot.__file__).resolve().parent
    paths = [Path(f.filename).resolve() for f in traceback.extract_tb(error.__traceback__)]
    others = (package / "tests", package / ".venv")
    return any(
        path.is_relative_to(package) and not any(path.is_relative_to(other) for other in others)
        for path in paths
    )
