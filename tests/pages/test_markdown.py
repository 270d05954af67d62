"""Markdown: tables, numbers with intervals, escaped text, and experiments in a few words."""

import html

from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from musebot.controller import BRAINS
from musebot.models import Kinematics
from musebot.protocols.pages import markdown
from musebot.protocols.runs.experiment import Experiment

OTHER = Experiment(
    seed=7, body="kinematic", kinematics=Kinematics(wheel_base=0.055), brain=BRAINS["steady"]
)


@given(st.text(st.characters(exclude_characters="\0")) | st.text("_~*`[]()|!<>&#a \\"))
def test_escaped_text_is_shown_as_it_is_in_a_table(text):
    page = MarkdownIt("js-default").render(f"| x |\n| --- |\n| a {markdown.escape(text)} b |")
    shown = html.escape(" ".join(text.split())).replace("&#x27;", "'")
    assert f"<td>a {shown} b</td>" in page


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
