"""The walls protocol: spot finding by robots with wall sensing."""

import numpy as np
import pytest

from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import BODIES, Experiment
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.runs import simulate
from musebot.protocols.lives.schedules import PROTOCOLS, SPOT_FINDING, WALLS_SENSED
from musebot.protocols.pages.replay import StoredRobot
from musebot.protocols.pages.viewer import Driver
from musebot.protocols.studies.robustness import (
    PERTURBATIONS,
    PerturbedTest,
    evaluate,
)

SF = "spot_finding"
CREATIVE = Condition(SF, "creative")
SHORT = Experiment(cohort_size=2, time_scale=0.001, protocol="walls")


@pytest.fixture(scope="module")
def run(tmp_path_factory, in_process):
    out = tmp_path_factory.mktemp("walls") / "run"
    return simulate(out, Plan.of(SHORT, [CREATIVE], 2), in_process(), quiet=True)


@pytest.fixture
def robot(run):
    return StoredRobot(run, CREATIVE, 1, "post")


def test_the_walls_protocol_differs_from_the_paper_in_the_sensors_only():
    assert PROTOCOLS["walls"] == {SF: WALLS_SENSED}
    assert WALLS_SENSED.task == "spot_finding_walls"
    assert (WALLS_SENSED.phases, WALLS_SENSED.wanted) == (SPOT_FINDING.phases, SPOT_FINDING.wanted)


@pytest.mark.parametrize("body", BODIES)
def test_robots_sense_the_walls_and_their_brains_have_the_inputs(body):
    experiment = Experiment(cohort_size=2, body=body, protocol="walls")
    cohort = Cohort(experiment, CohortKey(Condition(SF, "fixed"), 0))
    cohort.batch.place(np.arange(2), np.array([[0.4, 0, 0], [-0.4, 0.1, 1]]))
    nose, distances, contact = np.split(
        cohort.batch.rules.state(cohort.batch.sensordata), [1, 5], axis=1
    )
    assert (nose == 0).all()
    assert (distances > 0).any(axis=1).all()
    assert (contact == 0).all()
    state = cohort.batch.rules.state(cohort.batch.sensordata).astype(np.float32)
    assert cohort.agent.act(state, False).shape == (2, 2)


def test_stored_brains_drive_robots_with_wall_sensing(robot):
    episode = robot.episode()
    assert episode.task == "spot_finding_walls"
    assert len(list(episode.moments())) > 1
    driver = Driver.of_robot(robot)
    assert driver.task == "spot_finding_walls"


def test_stored_brains_are_evaluated_by_the_robustness_study(run, tmp_path):
    noise = next(one for one in PERTURBATIONS if one.noise)
    job = PerturbedTest(tmp_path / "f", run, CREATIVE, (0, 1), noise)
    assert evaluate(job)["valid"].all()
