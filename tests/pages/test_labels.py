"""Labels: titles of tables, and what distinguishes an experiment."""

from musebot.controller import BRAINS
from musebot.models import Kinematics
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import Run
from musebot.protocols.pages import labels

OTHER = Experiment(
    seed=7, body="kinematic", kinematics=Kinematics(wheel_base=0.055), brain=BRAINS["steady"]
)


def test_the_papers_experiment_has_no_particulars_but_its_table():
    assert labels.particulars(Experiment(seed=7, cohort_size=3)) == []
    assert labels.title("spot_finding", Experiment()) == "Spot finding (table 2)"


def test_another_protocol_is_no_table_of_the_papers():
    found = labels.title("spot_finding", Experiment(protocol="continual", time_scale=0.5))
    assert found == "Spot finding, protocol: continual, all durations times 0.5"


def test_particulars_are_all_fields_that_are_not_the_default():
    assert labels.particulars(OTHER) == ["brain: steady", "body: kinematic", "wheel base: 0.055"]


def test_settings_are_written_as_on_the_command_line_and_a_speed_has_its_unit():
    experiment = Experiment(settings=("rate=0.1", "discount=0.9"), motor_speed=0.4)
    assert labels.particulars(experiment) == [
        "motor speed: 0.4 m/s",
        "settings: rate=0.1 discount=0.9",
    ]
    assert labels.described(Run("mine", experiment, {})) == (
        "- mine: brain paper, motor_speed 0.4 m/s, settings rate=0.1 discount=0.9"
    )


def test_the_title_of_several_runs_has_what_they_share():
    found = labels.title("spot_finding", OTHER, Experiment(body="kinematic"))
    assert found == "Spot finding (table 2), body: kinematic"


def test_a_run_is_described_by_its_brain_and_its_fields():
    found = labels.described(Run("mine", Experiment(seed=7, brain=BRAINS["steady"]), {}))
    assert found == "- mine: brain steady, seed 7"
