"""Tests that take a quarter of an hour or more, run by hand (CONTRIBUTING.md)."""

import json
import subprocess
import sys

import pytest
import soak

# One process of a run: a whole life of spot finding, six simulated hours, and the peak of its
# memory by the end of each.
LIFE = """
import json, pathlib, sys
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.jobs import CohortJob
from musebot.protocols.lives.local import prepare_process

prepare_process()
experiment = Experiment(cohort_size=50, time_scale=float(sys.argv[2]))
key = CohortKey(Condition("spot_finding", "creative"), 0)
job = CohortJob(pathlib.Path(sys.argv[1]), experiment, (key,), save_every=10.0)
peaks = {}

def report(done, message):
    assert not message, message
    status = pathlib.Path("/proc/self/status").read_text().split()
    peak = int(status[status.index("VmHWM:") + 1]) * 1024  # bytes
    peaks[min(int(6 * done / job.cost), 5) + 1] = peak / 1e6

assert job.run(lambda: False, report)
print(json.dumps(peaks))
"""


def peaks(directory, time_scale):
    """Returns the peak memory in MB (10^6 bytes) by the end of each sixth of a life, 1 to 6."""
    command = [sys.executable, "-c", LIFE, str(directory), str(time_scale)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {int(hour): peak for hour, peak in json.loads(done.stdout).items()}


@pytest.mark.slow
@pytest.mark.night
@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc")
def test_peak_memory_of_fifty_robots_grows_by_less_than_20_mb_in_five_hours(tmp_path):
    by_hour = peaks(tmp_path, time_scale=1)
    print("peak memory in MB by the end of each simulated hour:", by_hour)
    assert sorted(by_hour) == [1, 2, 3, 4, 5, 6]
    assert by_hour[6] - by_hour[1] < 20


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
