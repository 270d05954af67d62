"""Tables as text and as data say the same, with the names that commands take."""

import dataclasses
import math
import re

from helpers import run_of_rows

from musebot.protocols.agents.names import RECORDED_NAMES
from musebot.protocols.analysis.comparison import compare_runs
from musebot.protocols.analysis.paper_tables import column
from musebot.protocols.pages import tables
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.learn_ability import CATEGORIES
from musebot.protocols.runs.run import Robot

WA = "wall_avoidance"


def run_of(proposer, kind, ability, *, post=2.0, **fields):
    rows = [Robot(WA, proposer, 1, 0, i, 6.0, post, ability, kind) for i in range(20)]
    return run_of_rows(rows, Experiment(**fields))


def test_a_column_without_robots_has_no_total_variation_in_text_and_data():
    run = run_of("fixed", "invalid", math.nan)
    entry = tables.as_json(run)["tables"][WA]["fixed"]
    assert entry["ours"]["robots"] == 0 and entry["paper"]["robots"] == 500
    assert entry["total_variation"] is entry["total_variation_by_chance"] is None
    assert f"| {tables.VARIATION} | - |" in tables.markdown(run)
    full = run_of("fixed", "0 < L < 1", 0.5)
    distance = tables.as_json(full)["tables"][WA]["fixed"]["total_variation"]
    assert f"| {tables.VARIATION} | {distance:.2f} (by chance " in tables.markdown(full)


def test_every_number_and_interval_of_a_column_is_in_the_data():
    run = run_of("fixed", "", 0.5)
    (results,) = run.results.values()
    results.robots[:] = [
        dataclasses.replace(row, category=name, learn_ability=ability, t_post_s=30.0 * row.robot)
        for row, (name, ability) in zip(
            results.robots,
            [("L = 1", 1.0)] * 9 + [("L < 0", -0.4)] * 8 + [("genius", math.nan)] * 2
            + [("invalid", math.nan)],
            strict=True,
        )
    ]  # fmt: skip
    own = column(run, Condition(WA, "fixed"))
    ours = tables.as_json(run)["tables"][WA]["fixed"]["ours"]
    numbers = "mean", "deviation", "post_share"
    assert ours.pop("intervals") == {
        "shares": dict(zip(CATEGORIES, map(list, own.shares), strict=True)),
        **{name: list(getattr(own, name)) for name in numbers},
    }
    assert ours == {
        "robots": 19,
        "invalid": 1,
        "counts": dict(zip(CATEGORIES, (9, 0, 0, 8, 2), strict=True)),
        **{name: getattr(own.summary, name) for name in numbers},
    }


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
        data = tables.as_json(run)
        assert bool(data["claims"]) == bool(data["joint_tests"]) == (not few)


def test_names_of_folders_are_no_markup():
    run = run_of("fixed", "0 < L < 1", 0.5)
    ours, other = (dataclasses.replace(run, name=name) for name in ("<script>a</script>", "b | c"))
    text = tables.comparison_markdown(ours, other, compare_runs(ours, other))
    assert "<script>" not in text and "&lt;script&gt;a&lt;/script&gt;" in text
    (head,) = [line for line in text.splitlines() if line.startswith("|  |  |")]
    assert len(head.replace(r"\|", "").split("|")) == 9  # seven columns
    assert tables.comparison_json(ours, other, [])["ours"] == ours.name


def test_a_comparison_has_short_names_and_settings_as_on_the_command_line():
    name = RECORDED_NAMES["sarsa_lambda"]
    ours = run_of(name, "0 < L < 1", 0.5)
    theirs = run_of(name, "L < 0", -0.5, post=600.0, settings=("trace=0.5", "tiles=6"))
    text = tables.comparison_markdown(ours, theirs, compare_runs(ours, theirs))
    assert "- wall_avoidance, sarsa_lambda: " in text and "| sarsa_lambda | L < 0 |" in text
    assert name not in text
    assert "settings (none, trace=0.5 tiles=6)" in text
