"""Whether the body's motion converges with the timestep, and the study that measures it."""

import numpy as np
import pytest

from musebot.protocols.errors import InputError
from musebot.protocols.studies import timestep
from musebot.protocols.studies.jobs import StoppedError
from musebot.protocols.studies.study import conduct
from musebot.protocols.studies.timestep import SUBSTEPS, Timestep, drive, random_motors

CENTRE = (0.0, 0.0, 0.0)
SMALL = {"robots": 2, "minutes": 0.1}


def test_motion_converges_with_the_timestep():
    motors = random_motors(4, 30, full_speed=False)
    ends = [drive(substeps, motors, CENTRE).poses[:, -1, :2] for substeps in (100, 50, 14)]
    errors = [np.abs(end - ends[0]).max() for end in ends]
    assert errors[0] == 0 < errors[1] < errors[2] < 2e-3


def test_robots_that_drive_into_a_wall_touch_it():
    ahead = np.full((1, 30, 2), 0.5)
    free, wall = (drive(14, ahead, (x, 0.0, 0.0)) for x in (-0.45, 0.4))
    assert (free.touch == 0).all() and free.gap.min() > 0.05
    assert wall.touch[0, -1] > 0 and abs(wall.deepest) < 2e-3
    assert max(free.tilt, wall.tilt) < 5 and free.microseconds > 0


def test_random_motor_values_are_held_and_seeded():
    motors = random_motors(3, 200, full_speed=True)
    assert {*motors.ravel()} == {-0.5, 0.5}
    calm = random_motors(3, 200, full_speed=False)
    held = (np.diff(calm, axis=1) == 0).all(axis=2).mean()
    assert 0.8 < held < 0.95 and np.abs(calm).max() <= 0.5
    np.testing.assert_array_equal(calm, random_motors(3, 200, full_speed=False))
    assert (calm != random_motors(3, 200, full_speed=False, seed=1)).any()


def test_a_study_has_a_row_for_each_timestep_and_continues(tmp_path, here):
    text = conduct(Timestep(**SMALL), tmp_path, here).markdown
    rows = [line.strip("| ").split(" | ") for line in text.splitlines()]
    assert [int(row[1]) for row in rows[2:]] == [*SUBSTEPS]
    assert {len(row) for row in rows if "---" not in row[0]} == {14}
    assert rows[2][:4] == ["1", "100", "0.00", "0.00"]
    assert [str(job) for job in here.jobs] == [f"{n} substeps" for n in SUBSTEPS]
    here.jobs.clear()
    (tmp_path / "substeps-014.safetensors").unlink()
    with pytest.raises(InputError, match="lacks substeps-014.safetensors"):
        Timestep(**SMALL).page(tmp_path)
    conduct(Timestep(**SMALL), tmp_path, here)
    assert [str(job) for job in here.jobs] == ["14 substeps"]


def test_a_measurement_stops_when_asked(tmp_path):
    with pytest.raises(StoppedError):
        drive(14, np.zeros((1, 700, 2)), CENTRE, iter([False, True]).__next__)
    job = timestep.TimestepJob(tmp_path / "file", 14, 2, 0.1)
    assert job.run(lambda: True, lambda cost, message: None) is False
    assert not job.done()
    reports = []
    assert job.run(lambda: False, lambda *report: reports.append(report))
    assert reports[-1] == (pytest.approx(job.cost), "")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "robots must be at least 1, got 0"),
        ({"minutes": 0.0}, "minutes must be at least 0.05, got 0"),
    ],
)
def test_an_invalid_option_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        Timestep(**options).experiments()
