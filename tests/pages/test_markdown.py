"""Markdown: tables, numbers with intervals, escaped text, and experiments in a few words."""

import html
import re

from hypothesis import given
from hypothesis import strategies as st

from musebot.controller import BRAINS
from musebot.models import Kinematics
from musebot.protocols.pages import markdown
from musebot.protocols.runs.experiment import Experiment

OTHER = Experiment(
    seed=7, body="kinematic", kinematics=Kinematics(wheel_base=0.055), brain=BRAINS["steady"]
)


@given(st.text())
def test_escaped_text_is_shown_as_it_is_and_is_no_markup(text):
    found = markdown.escape(text)
    assert not re.search(r"[<>\n]", found)
    assert not re.search(r"(?<!\\)(\\\\)*[|*`\[\]]", found)  # each is behind an odd number of \
    shown = html.unescape(re.sub(r"\\([\\`*\[\]|])", r"\1", found))
    assert shown == html.unescape(html.escape(" ".join(text.split())))


def test_particulars_and_titles_have_all_fields_that_are_not_the_default():
    settings = Experiment(settings=("rate=0.1", "discount=0.9"), motor_speed=0.4)
    for experiment, facts in (
        (Experiment(seed=7, cohort_size=3), []),
        (Experiment(time_scale=0.5), ["all durations times 0.5"]),
        (OTHER, ["brain: steady", "body: kinematic", "wheel base: 0.055"]),
        (settings, ["motor speed: 0.4 m/s", "settings: rate=0.1 discount=0.9"]),
    ):
        assert markdown.particulars(experiment) == facts
        title = ", ".join(["Spot finding (table 2)", *facts])
        assert markdown.title("spot_finding", experiment) == title


def test_the_title_of_several_runs_has_what_they_share():
    found = markdown.title("spot_finding", OTHER, Experiment(body="kinematic"))
    assert found == "Spot finding (table 2), body: kinematic"
    found = markdown.title("spot_finding_walls", Experiment())
    assert found == "Spot finding, walls sensed"
