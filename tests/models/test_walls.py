"""The course among walls: spot finding by robots that feel the walls, too."""

import numpy as np
import pytest

from musebot.models import Kinematics
from musebot.protocols.experiment.experiment import BODIES, CohortKey, Experiment, Plan
from musebot.protocols.experiment.schedules import COURSES, SPOT_FINDING, WALLS
from musebot.protocols.playback import viewer as explore
from musebot.protocols.playback.stored_brains import Candidate
from musebot.protocols.simulation import engine
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.simulation.local import Processes
from musebot.protocols.studies.robustness import CHANGES, Job, sit
from musebot.tasks import make_batch, make_kinematic_batch

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


def test_it_is_the_papers_spot_finding_but_for_what_the_robot_senses():
    assert COURSES["walls"] == {SF: WALLS}
    assert WALLS.task == "spot_finding_walls"
    assert (WALLS.phases, WALLS.wanted) == (SPOT_FINDING.phases, SPOT_FINDING.wanted)


@pytest.mark.parametrize("body", BODIES)
def test_its_robots_feel_the_walls_and_their_brains_know(body):
    cohort = Cohort(Experiment(cohort_size=2, body=body, course="walls"), CohortKey(SF, "fixed", 0))
    cohort.batch.place(np.arange(2), np.array([[0.4, 0, 0], [-0.4, 0.1, 1]]))
    nose, distances, contact = np.split(cohort.rules.state(cohort.batch.sensordata), [1, 5], axis=1)
    assert (nose == 0).all()
    assert (distances > 0).any(axis=1).all()
    assert (contact == 0).all()
    state = cohort.rules.state(cohort.batch.sensordata).astype(np.float32)
    assert cohort.agent.act(state, False).shape == (2, 2)


def test_the_stand_in_senses_there_what_the_body_does():
    real, stand_in = (
        make_batch("spot_finding_walls", 3),
        make_kinematic_batch("spot_finding_walls", 3, Kinematics()),
    )
    for robots in (real, stand_in):
        robots.place_spot(np.arange(3), np.tile([0.3, 0.1], (3, 1)))
        robots.place(np.arange(3), np.array([[0.2, 0.1, 0.1], [-0.4, 0.2, 2.0], [0, -0.2, -1.0]]))
    ours, theirs = (robots.rules.state(robots.sensordata) for robots in (stand_in, real))
    np.testing.assert_allclose(ours, theirs, atol=1e-6)
    assert (ours[0, 0] > 0.3) & (ours[1:, 0] == 0).all()


def test_the_stand_in_has_no_arena_but_the_papers():
    for task in ("wall_avoidance_obstacles", "spot_finding_two_noses"):
        with pytest.raises(ValueError, match="only the paper's arena"):
            make_kinematic_batch(task, 1, Kinematics())


def test_its_brains_go_back_into_robots_that_feel_the_walls(run):
    episode = candidate(run).episode()
    assert episode.task == "spot_finding_walls"
    assert len(list(episode.moments())) > 1
    driver = explore.Driver.of_candidate(candidate(run))
    assert driver.task == "spot_finding_walls"


def test_its_brains_sit_the_test_of_robustness(run, tmp_path):
    experiment, results = run
    job = Job(tmp_path / "f", experiment, results, (SF, "creative"), (0, 1), CHANGES[-5])
    assert job.change.noise
    assert sit(job)["valid"].all()
