"""Tables as text and as data say the same, with the names that commands take."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import run_of_rows

from musebot.protocols.agents.names import RECORDED_NAMES
from musebot.protocols.analysis import intervals
from musebot.protocols.analysis.comparison import compare_runs
from musebot.protocols.analysis.paper_tables import column
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import Robot
from musebot.protocols.pages import tables

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
    kinds = [(1.0, "L = 1")] * 9 + [(0.5, "0 < L < 1")] * 6 + [(0.0, "L = 0"), (-0.4, "L < 0")]
    kinds += [(math.nan, "genius")] * 2 + [(math.nan, "invalid")]
    run = run_of("fixed", "", math.nan)
    (results,) = run.results.values()
    results.robots[:] = [
        dataclasses.replace(row, learn_ability=ability, category=name, t_post_s=30.0 * row.robot)
        for row, (ability, name) in zip(results.robots, kinds, strict=True)
    ]
    ours = tables.as_json(run)["tables"][WA]["fixed"]["ours"]
    own = column(run, Condition(WA, "fixed"))
    abilities = np.array([ability for ability, _ in kinds[:17]])
    counts = {"L = 1": 9, "0 < L < 1": 6, "L = 0": 1, "L < 0": 1, "unmeasured": 2}
    found = ours.pop("intervals")
    assert ours == {
        "robots": 19,
        "invalid": 1,
        "counts": counts,
        "mean": pytest.approx(abilities.mean()),
        "deviation": pytest.approx(abilities.std(ddof=1)),
        "post_share": pytest.approx(30 * 9 / 1200),
    }
    ends = {name: own for name, own in zip(counts, own.shares, strict=True)}
    assert found.pop("shares") == {name: pytest.approx(list(pair)) for name, pair in ends.items()}
    assert found.keys() == {"mean", "deviation", "post_share"}
    for name, pair in found.items():
        assert pair == pytest.approx(list(getattr(own, name))), name
    assert found["mean"] == pytest.approx(list(intervals.mean(abilities, intervals.ABILITY)))
    assert len({low for low, _ in found.values()}) == 3


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
