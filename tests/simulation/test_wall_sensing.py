"""The walls protocol: spot finding by robots with wall sensing."""

import numpy as np
import pytest

from musebot.protocols.experiment.experiment import BODIES, CohortKey, Experiment, Plan
from musebot.protocols.experiment.schedules import COURSES, SPOT_FINDING, WALLS
from musebot.protocols.playback import viewer as explore
from musebot.protocols.playback.stored_brains import Candidate
from musebot.protocols.simulation import engine
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.simulation.local import Processes
from musebot.protocols.studies.robustness import CHANGES, Job, sit

SF = "spot_finding"
SHORT = Experiment(cohort_size=2, time_scale=0.001, course="walls")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("walls") / "run"
    engine.run(out, Plan.of(SHORT, [(SF, "creative")], 2), Processes(1))
    return engine.read_run(out)


def candidate(run):
    experiment, results = run
    return Candidate(experiment, results, SF, "creative", 1, "post")


def test_the_walls_protocol_differs_from_the_paper_in_the_sensors_only():
    assert COURSES["walls"] == {SF: WALLS}
    assert WALLS.task == "spot_finding_walls"
    assert (WALLS.phases, WALLS.wanted) == (SPOT_FINDING.phases, SPOT_FINDING.wanted)


@pytest.mark.parametrize("body", BODIES)
def test_robots_sense_the_walls_and_their_brains_have_the_inputs(body):
    cohort = Cohort(Experiment(cohort_size=2, body=body, course="walls"), CohortKey(SF, "fixed", 0))
    cohort.batch.place(np.arange(2), np.array([[0.4, 0, 0], [-0.4, 0.1, 1]]))
    nose, distances, contact = np.split(cohort.rules.state(cohort.batch.sensordata), [1, 5], axis=1)
    assert (nose == 0).all()
    assert (distances > 0).any(axis=1).all()
    assert (contact == 0).all()
    state = cohort.rules.state(cohort.batch.sensordata).astype(np.float32)
    assert cohort.agent.act(state, False).shape == (2, 2)


def test_stored_brains_drive_robots_with_wall_sensing(run):
    episode = candidate(run).episode()
    assert episode.task == "spot_finding_walls"
    assert len(list(episode.moments())) > 1
    driver = explore.Driver.of_candidate(candidate(run))
    assert driver.task == "spot_finding_walls"


def test_stored_brains_are_evaluated_by_the_robustness_study(run, tmp_path):
    experiment, results = run
    job = Job(tmp_path / "f", experiment, results, (SF, "creative"), (0, 1), CHANGES[-5])
    assert job.change.noise
    assert sit(job)["valid"].all()
