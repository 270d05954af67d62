"""Tables as text and as data say the same, with the names that commands take."""

import dataclasses
import math
import re

from helpers import run_of_rows

from musebot.protocols.agents.names import RECORDED_NAMES
from musebot.protocols.analysis.comparison import compare_runs
from musebot.protocols.analysis.paper_tables import column, paper_column
from musebot.protocols.pages import tables
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.learn_ability import total_variation
from musebot.protocols.runs.run import Robot

WA = "wall_avoidance"


def run_of(proposer, kind, ability, *, post=2.0, **fields):
    rows = [Robot(WA, proposer, 1, 0, i, 6.0, post, ability, kind) for i in range(20)]
    return run_of_rows(rows, Experiment(**fields))


def test_a_column_without_robots_has_no_total_variation():
    run = run_of("fixed", "invalid", math.nan)
    assert f"| {tables.VARIATION} | - |" in tables.markdown(run)
    full, condition = run_of("fixed", "0 < L < 1", 0.5), Condition(WA, "fixed")
    both = column(full, condition), paper_column(condition)
    distance = total_variation(*(one.summary for one in both))
    assert f"| {tables.VARIATION} | {distance:.2f} (by chance " in tables.markdown(full)


def test_few_robots_are_neither_tested_nor_compared_with_the_paper():
    for robots, few in ((19, True), (20, False)):
        rows = [Robot(WA, "fixed", 1, 0, i, 6.0, 2.123, 0.5, "0 < L < 1") for i in range(robots)]
        run = run_of_rows(rows)
        text = tables.markdown(run)
        assert few == run.few == ("fewer than 20 robots" in text)
        for words in ("paper |", tables.VARIATION, "p = ", "claims", "Student"):
            assert (words in text) != few, words
        digits = max(len(n.replace(".", "").lstrip("0")) for n in re.findall(r"\b0\.\d+", text))
        assert (digits <= 2) == few


def test_names_of_folders_are_no_markup():
    run = run_of("fixed", "0 < L < 1", 0.5)
    ours, other = (dataclasses.replace(run, name=name) for name in ("<script>a</script>", "b | c"))
    text = tables.comparison_markdown(ours, other, compare_runs(ours, other))
    assert "<script>" not in text and "&lt;script&gt;a&lt;/script&gt;" in text
    (head,) = [line for line in text.splitlines() if line.startswith("|  |  |")]
    assert len(head.replace(r"\|", "").split("|")) == 9  # seven columns


def test_a_comparison_has_short_names_and_settings_as_on_the_command_line():
    name = RECORDED_NAMES["sarsa_lambda"]
    ours = run_of(name, "0 < L < 1", 0.5)
    theirs = run_of(name, "L < 0", -0.5, post=600.0, settings=("trace=0.5", "tiles=6"))
    text = tables.comparison_markdown(ours, theirs, compare_runs(ours, theirs))
    assert "- wall_avoidance, sarsa_lambda: " in text and "| sarsa_lambda | L < 0 |" in text
    assert name not in text
    assert "settings (none, trace=0.5 tiles=6)" in text
