"""The kinematic simulator on tensors: the NumPy simulator's robots, without a look at the host."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from musebot.models import Kinematics
from musebot.models.arrays import interpolated
from musebot.tasks import make_kinematic_batch
from musebot.tasks.tensors.kinematic import KinematicTensors

BODIES = {
    "holds": Kinematics(),
    "turns": Kinematics(felt="pushed", wall="turns", lag=0.08),
    "refuses": Kinematics(wall="refuses", felt="pushed", pieces=1, path="euler"),
    "slides": Kinematics(wall="slides", any_contact=True),
    "sticks": Kinematics(wall="sticks"),
}
TASKS = ("wall_avoidance", "spot_finding", "spot_finding_walls")
ROBOTS = 40


def pair(how=BODIES["turns"], task="spot_finding_walls", robots=ROBOTS):
    """The same robots in both forms, at random places."""
    random = np.random.default_rng(1)
    numpy, host = (make_kinematic_batch(task, robots, how) for _ in range(2))
    tensors = KinematicTensors(host)
    poses = random.uniform((-0.4, -0.25, -np.pi), (0.4, 0.25, np.pi), (robots, 3))
    spots = random.uniform((-0.4, -0.25), (0.4, 0.25), (robots, 2))
    for batch in (numpy, tensors):
        batch.place_spot(np.arange(robots), spots)
        batch.place(np.arange(robots), poses)
    return numpy, tensors


def drive(batches, steps, seed=2):
    random = np.random.default_rng(seed)
    for step in range(steps):
        if step % 15 == 0:
            motors = random.uniform(-0.7, 0.7, (batches[0].robots, 2)).astype(np.float32)
        for batch in batches:
            given = torch.from_numpy(motors) if isinstance(batch, KinematicTensors) else motors
            batch.step(given)
        yield


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("how", BODIES.values(), ids=BODIES)
def test_robots_on_tensors_do_what_the_numpy_robots_do(how, task):
    numpy, tensors = pair(how, task)
    contacts = 0
    for _ in drive((numpy, tensors), 200):
        sensed = tensors.sensordata.numpy()
        np.testing.assert_allclose(sensed, numpy.sensordata, atol=1e-6)
        for rule in ("state", "reward"):
            ours, theirs = (
                np.asarray(getattr(batch.rules, rule)(batch.sensordata))
                for batch in (tensors, numpy)
            )
            np.testing.assert_allclose(ours, theirs, atol=1e-6)
        contacts += int(numpy.arrays()["touch"].sum())
    assert contacts > 50 and numpy.valid.all() and bool(tensors.valid.all())
    np.testing.assert_allclose(tensors.pose, numpy.pose, atol=1e-6)
    assert np.array_equal(tensors.spot, numpy.spot)


@given(st.lists(st.floats(-50, 150), min_size=1, max_size=20))
def test_interpolation_of_tensors_is_numpys(values):
    known, results = np.array([0.0, 30, 40, 57, 90]), np.array([0, 0.5, -0.2, 0.3, 1])
    ours = interpolated(torch.tensor(values, dtype=torch.float64), known, results)  # type: ignore
    np.testing.assert_allclose(ours, np.interp(values, known, results), atol=1e-12)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("how", BODIES.values(), ids=BODIES)
def test_a_step_reads_no_number_on_the_host(how, task):
    """The device "meta" has shapes but no numbers: reading one fails there."""
    with torch.device("meta"):
        batch = KinematicTensors(make_kinematic_batch(task, 3, how))
    batch.step(torch.zeros(3, 2, device="meta"))
    assert str(batch.rules.state(batch.sensordata).device) == "meta"
    assert batch.rules.reward(batch.sensordata).shape == (3,)
    assert batch.rules.event(batch.sensordata).dtype == torch.bool


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_a_robot_with_motors_that_are_not_finite_stops_and_the_others_go_on(broken):
    numpy, tensors = pair(robots=3)
    motors = np.array([[0.3, 0.3], [broken, 0.1], [0.2, -0.2]], np.float32)
    for _ in range(5):
        numpy.step(motors)
        tensors.step(torch.from_numpy(motors))
    assert tensors.valid.tolist() == [True, False, True] == numpy.valid.tolist()
    for name, array in numpy.arrays().items():
        np.testing.assert_allclose(tensors.arrays()[name], array, atol=1e-9, err_msg=name)
    assert not tensors.sensordata[1].any()


def test_a_robot_that_leaves_the_arena_stops():
    _, tensors = pair(robots=3)
    tensors._tensors["poses"][1, 0] = np.nan
    tensors._tensors["poses"][2, 0] = 1e9  # drives back within the walls
    tensors.step(torch.full((3, 2), 0.1))
    assert tensors.valid.tolist() == [True, False, True]
    assert not tensors.arrays()["poses"][1].any()


def test_a_stopped_robot_senses_zeros():
    _, tensors = pair(robots=3)
    tensors.stop(np.array([2]))
    assert tensors.valid.tolist() == [True, True, False]
    assert not tensors.sensordata[2].any() and tensors.sensordata[:2].any()


def test_robots_on_tensors_continue_bit_exactly_from_a_state():
    _, first = pair()
    for _ in drive((first,), 20):
        pass
    state = first.get_state()
    _, second = pair()
    second.set_state(state)
    for _ in drive((first, second), 40, seed=3):
        assert torch.equal(first.sensordata, second.sensordata)
    with pytest.raises(ValueError, match="wheels must have shape"):
        second.load_arrays({**state, "wheels": np.zeros((2, 2))})


def test_motors_of_another_shape_are_refused():
    _, tensors = pair(robots=3)
    with pytest.raises(ValueError, match=r"motors must have shape \(3, 2\), got \(2, 2\)"):
        tensors.step(torch.zeros(2, 2))
