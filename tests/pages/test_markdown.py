"""Markdown: tables, numbers and intervals as text."""

import numpy as np
import pytest

from musebot.protocols.analysis.intervals import UNKNOWN
from musebot.protocols.pages import markdown


def test_a_table_has_a_head_a_rule_and_rows():
    assert markdown.table([["", "a"], ["one", "1"]]) == [
        "|  | a |",
        "| --- | ---: |",
        "| one | 1 |",
    ]


def test_the_columns_of_a_table_are_aligned_as_given():
    assert markdown.table([["a", "b", "c"]], "rlr")[1] == "| ---: | --- | ---: |"


def test_a_section_is_a_heading_a_paragraph_and_a_table():
    assert markdown.section("A", "Text.", ("", "a"), [("one", "1")]) == (
        "### A\n\nText.\n\n|  | a |\n| --- | ---: |\n| one | 1 |\n"
    )


@pytest.mark.parametrize(("value", "text"), [(0.25, "0.2500"), (float("nan"), "-")])
def test_a_number_has_four_decimals_or_is_a_dash(value, text):
    assert markdown.number(value) == text


def test_an_interval_stands_in_brackets_unless_it_is_unknown():
    assert markdown.bracket((0.125, 0.25)) == "[0.125, 0.250]"
    assert markdown.bracket((0.125, 0.25), percent=True) == "[12%, 25%]"
    assert markdown.bracket(UNKNOWN) == ""


def test_a_mean_without_interval_stands_alone():
    assert markdown.mean_cell(np.array([0.5, 0.5])) == "0.500"
    assert markdown.mean_cell(np.linspace(0, 1, 9)).startswith("0.500 [0.")
