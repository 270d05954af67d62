"""Changes of the body: the same in both simulators, in a batch and alone."""

import dataclasses

import numpy as np
import pytest

from musebot.models import CHANGES, BodyChange, Dimensions, Kinematics, arena_spec, robot_pose
from musebot.tasks import make_batch, make_kinematic_batch
from musebot.tasks.arena import TaskDefinition
from musebot.tasks.sensors import Nose
from musebot.tasks.spot_finding import PAPER

LAG = Kinematics(lag=0.08)


def batches(edits=()):
    return (
        make_batch("spot_finding", 2, edits=edits),
        make_kinematic_batch("spot_finding", 2, LAG, edits=edits),
    )


def driven(batch, motors):
    """Poses after each step of commanded motors, shape (steps, B, 3), and what was sensed."""
    batch.place_spot(np.arange(2), np.tile([0.3, 0.1], (2, 1)))
    batch.place(np.arange(2), np.array([[0.0, 0.0, 0.3], [-0.2, 0.1, 2.0]]))
    poses, sensed = [], []
    for pair in motors:
        batch.step(np.tile(pair, (2, 1)))
        poses.append(batch.pose)
        sensed.append(batch.sensordata.copy())
    return np.array(poses), np.array(sensed)


COMMANDS = np.random.default_rng(0).uniform(-0.5, 0.5, (30, 2))


@pytest.mark.parametrize("body", [0, 1], ids=["mujoco", "kinematic"])
@pytest.mark.parametrize(
    ("name", "equals"),
    [("polarity", (-1, -1)), ("half-gain", (0.5, 1)), ("turned-nose", (1, 1))],
)
def test_a_changed_body_moves_as_the_old_one_under_commands_times_its_gains(name, equals, body):
    ours, sensed = driven(batches([CHANGES[name]])[body], COMMANDS)
    theirs, other = driven(batches()[body], COMMANDS * equals)
    assert np.array_equal(ours, theirs)
    assert np.array_equal(sensed, other) == (name != "turned-nose")


@pytest.mark.parametrize("body", [0, 1], ids=["mujoco", "kinematic"])
def test_swapped_polarity_drives_a_commanded_robot_back(body):
    poses, _ = driven(batches([CHANGES["polarity"]])[body], [(0.5, 0.5)] * 10)
    ahead = (poses[-1, 0, :2] * [np.cos(0.3), np.sin(0.3)]).sum()
    assert ahead == pytest.approx(-0.2 * (1 - 0.08), abs=0.01)


@pytest.mark.parametrize("body", [0, 1], ids=["mujoco", "kinematic"])
def test_a_left_wheel_at_half_gain_turns_a_robot_that_is_commanded_straight(body):
    poses, _ = driven(batches([CHANGES["half-gain"]])[body], [(0.5, 0.5)] * 10)
    size = batches()[body].dimensions
    turned = (0.2 - 0.1) / size.wheel_base * (1 - 0.08)
    # The MuJoCo body is slower to turn than to drive ahead.
    assert (poses[-1, :, 2] - [0.3, 2.0]) % (2 * np.pi) == pytest.approx(turned, rel=0.06)


@pytest.mark.parametrize("body", [0, 1], ids=["mujoco", "kinematic"])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_turned_nose_smells_along_its_own_axis_by_equation_3(body, side):
    turn = side * np.pi / 6
    batch = batches([BodyChange("turned", nose_turn=turn)])[body]
    heading, nose = 0.4, np.array([0.1, -0.05])
    place = nose - batch.dimensions.nose * np.array([np.cos(heading), np.sin(heading)])
    # 0.2 m from the nose: along its axis, and 20 degrees off it, of 45 within which it smells.
    off = np.radians([0, 20])
    spots = nose + 0.2 * np.column_stack(
        [np.cos(heading + turn + off), np.sin(heading + turn + off)]
    )
    batch.place_spot(np.arange(2), spots)
    batch.place(np.arange(2), np.tile([*place, heading], (2, 1)))
    raw = 10 * (0.06 / 0.2) * (1 - 2 * off / (np.pi / 2))
    smelt = batch.rules.state(batch.sensordata)[:, 0]
    assert smelt == pytest.approx(raw / (1 + raw), abs=1e-6)
    assert Nose().signal(np.array([0.2, 0.0])) == pytest.approx(smelt[0], abs=1e-6)


def test_both_simulators_read_the_changes_from_the_model():
    for change in CHANGES.values():
        real, kinematic = batches([change])
        assert real.dimensions == kinematic.dimensions
        assert real.dimensions.gains == change.gains
        assert real.dimensions.nose_turn == pytest.approx(change.nose_turn, abs=1e-12)


@pytest.mark.parametrize("speed", [None, 0.1, 0.3])
def test_a_body_without_a_change_has_gains_of_1_and_its_nose_in_front(speed):
    size = Dimensions.of(arena_spec(motor_speed=speed).compile())
    assert (size.gains, size.nose_turn) == ((1.0, 1.0), 0.0)
    changed = batches([CHANGES["polarity"]])[0].dimensions
    same = {"gains": (1.0, 1.0), "motor_speed": size.motor_speed}
    assert dataclasses.replace(changed, **same) == size


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_batch_equals_a_changed_environment_bit_exactly(name):
    start, spot = (0.0, 0.0, 0.3), (0.3, 0.1)
    changed: TaskDefinition = dataclasses.replace(PAPER, edits=(CHANGES[name],))
    environment = changed.environment(robot=start, spot=spot)
    timestep = environment.reset()
    batch = make_batch("spot_finding", 1, edits=[CHANGES[name]])
    batch.place_spot(np.array([0]), np.array([spot]))
    batch.place(np.array([0]), np.array([start]))
    assert timestep.observation["nose"] == batch.rules.state(batch.sensordata)[0]
    for pair in COMMANDS:
        timestep = environment.step(pair)
        batch.step(pair[None])
        assert np.array_equal(robot_pose(environment.physics.qpos), batch.pose[0])
        assert timestep.observation["nose"] == batch.rules.state(batch.sensordata)[0]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"gains": (1.0, float("nan"))}, "gains must be two finite numbers, got"),
        ({"gains": (1.0,)}, "gains must be two finite numbers, got"),
        ({"nose_turn": float("inf")}, "nose_turn must be finite, got inf"),
    ],
)
def test_a_change_refuses_what_is_not_finite(fields, words):
    with pytest.raises(ValueError, match=words):
        BodyChange("wrong", **fields)
