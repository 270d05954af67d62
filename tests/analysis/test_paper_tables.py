"""Tables 1 and 2: the paper's numbers, and a run's columns."""

import dataclasses
from pathlib import Path

import pytest
from helpers import run_of_rows

from musebot.protocols.analysis.paper_tables import PAPER, column, paper_column, row_names
from musebot.protocols.cli import parser as cli
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.run import Robot
from musebot.tasks.lives import WALL_AVOIDANCE

KEPT = Path(__file__).parents[2] / "docs" / "results"


@pytest.mark.slow
def test_kept_pages_are_printed_again_from_runs_kept_without_brains(monkeypatch, capsys):
    monkeypatch.chdir(KEPT)
    for words, page in (
        ("mujoco", "mujoco/tables.md"),
        ("mujoco --compare kinematic-1000", "mujoco/compare-kinematic-1000.md"),
    ):
        assert cli.main(["tables", *words.split()]) == 0
        assert capsys.readouterr().out == Path(page).read_text()


def test_the_paper_has_500_robots_in_each_of_six_columns_with_means_that_agree():
    assert len(PAPER) == 6
    for printed in PAPER.values():
        ones, positive, zero, negative, rest = printed.counts
        measured = ones + positive + zero + negative
        assert (printed.robots, printed.invalid) == (500, 0) == (measured + rest, 0)
        assert (ones - negative) / measured <= printed.mean <= (ones + positive) / measured


def test_only_the_papers_conditions_have_a_paper_column():
    condition = Condition("spot_finding", "fixed")
    found = paper_column(condition)
    assert found is not None and found.summary == PAPER[condition]
    for other in (("spot_finding_walls", "fixed"), ("spot_finding", "agents:mine")):
        assert paper_column(Condition(*other)) is None


def test_a_column_has_the_values_of_valid_robots_and_intervals_around_them():
    condition = Condition("wall_avoidance", "random")
    rows = [
        Robot(condition.life, condition.proposer, 1, 0, i, 1.0, 12.0 * i, ability, "0 < L < 1")
        for i, ability in enumerate([1.0, 1.0, 0.5, -0.5, 0.25, 0.75])
    ]
    rows.append(dataclasses.replace(rows[0], robot=6, t_post_s=9e9, category="invalid"))
    found = column(run_of_rows(rows), condition)
    summary = found.summary
    assert (summary.robots, summary.invalid, summary.counts) == (6, 1, (2, 3, 0, 1, 0))
    assert found.mean[0] < summary.mean == 0.5 < found.mean[1]
    assert found.post_share[0] < summary.post_share == 30 / 1200 < found.post_share[1]
    assert len(row_names(WALL_AVOIDANCE)) == 1 + len(found.shares) + 3
