"""Tables 1 and 2: the paper's numbers, and a run's columns."""

import numpy as np

from musebot.controller import PROPOSERS
from musebot.protocols.analysis.paper_tables import PAPER, column, paper_column, row_names
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import ConditionResults, Robot, Run

TABLES = {
    "wall_avoidance": """
        L = 1       260     196     282
        L > 0       12      215     65
        L = 0       13      1       0
        L < 0       19      51      80
        (Genius)    196     37      73
        mean        0.8232  0.7150  0.6109
        sigma       0.4959  0.5137  0.7068
        t_post      0.0584  0.0160  0.0402
    """,
    "spot_finding": """
        L = 1       22      20      109
        L > 0       2       16      63
        L = 0       1       0       1
        L < 0       20      323     170
        (Ignorant)  455     141     157
        mean        0.0800  -0.8064 0.0045
        sigma       0.9681  0.5631  0.8829
        t_post      0.0440  0.0296  0.2581
    """,
}


def test_the_columns_hold_the_printed_numbers():
    for task, table in TABLES.items():
        lines = [line.split()[-3:] for line in table.strip().splitlines()]
        for cells, proposer in zip(zip(*lines, strict=True), PROPOSERS, strict=True):
            paper = PAPER[Condition(task, proposer)]
            assert paper.counts == tuple(int(cell) for cell in cells[:5])
            printed = tuple(float(cell) for cell in cells[5:])
            assert (paper.mean, paper.deviation, paper.post_share) == printed


def test_the_paper_has_500_robots_in_each_of_six_columns_with_means_that_agree():
    assert len(PAPER) == 6
    for printed in PAPER.values():
        ones, positive, zero, negative, rest = printed.counts
        measured = ones + positive + zero + negative
        assert (printed.robots, printed.invalid) == (500, 0) == (measured + rest, 0)
        assert (ones - negative) / measured <= printed.mean <= (ones + positive) / measured


def test_only_the_papers_conditions_and_protocol_have_a_paper_column():
    condition = Condition("spot_finding", "fixed")
    found = paper_column(Experiment(), condition)
    assert found is not None and found.summary == PAPER[condition]
    assert paper_column(Experiment(protocol="walls"), condition) is None
    assert paper_column(Experiment(), Condition("spot_finding", "agents:mine")) is None


def test_a_column_has_the_values_of_valid_robots_and_intervals_around_them():
    condition = Condition("wall_avoidance", "random")
    abilities = [1.0, 1.0, 0.5, -0.5, 0.25, 0.75]
    rows = [
        Robot(condition.task, condition.proposer, 1, 0, i, 1.0, 12.0 * i, ability, "0 < L < 1")
        for i, ability in enumerate(abilities)
    ]
    rows.append(
        Robot(condition.task, condition.proposer, 1, 0, 6, 1.0, 9e9, float("nan"), "invalid")
    )
    results = ConditionResults(rows, np.zeros((7, 1)), {"before": {}, "after": {}})
    found = column(Run("run", Experiment(), {condition: results}), condition)
    assert (found.summary.robots, found.summary.invalid) == (6, 1)
    assert found.summary.counts == (2, 3, 0, 1, 0)
    assert found.mean[0] < found.summary.mean == 0.5 < found.mean[1]
    assert found.post_share[0] < found.summary.post_share == 30 / 1200 < found.post_share[1]
    assert len(row_names("wall_avoidance")) == 1 + len(found.shares) + 3
