"""Tests that take a quarter of an hour or more, run by hand (CONTRIBUTING.md)."""

import json
import subprocess
import sys

import pytest
import soak

ROBOT_HOURS = 150  # about a quarter of an hour of a processor


@pytest.mark.slow
@pytest.mark.night
@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc")
def test_no_robot_becomes_invalid_in_many_hours_and_the_process_stays_as_it_is():
    command = [sys.executable, soak.__file__, "--robot-hours", str(ROBOT_HOURS)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    found = json.loads(done.stdout)
    assert found["robot_hours"] >= ROBOT_HOURS and found["invalid"] == 0
    for worst in found["worst"].values():
        # A tenth of what makes a robot invalid, or 1.5 times what has been seen.
        assert worst["tilt_deg"] < 5 and worst["depth_mm"] < 1.5
        assert worst["speed_m_s"] < 0.3 and worst["energy_mJ"] < 6
    first, *_, last = found["held"]
    assert last["MB"] - first["MB"] < 10
    assert (last["files"], last["threads"]) == (first["files"], first["threads"])
