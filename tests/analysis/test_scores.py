"""Scores of readings of the paper."""

import dataclasses
import math

import numpy as np
import pytest

from musebot.protocols.analysis.paper_numbers import PAPER
from musebot.protocols.analysis.scores import (
    log_likelihood,
    main_effect,
    newborn_score,
    unmet_before,
    verdict,
)
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import ConditionResults, Robot, Run, category_in

WALLS, SPOT = Condition("wall_avoidance", "creative"), Condition("spot_finding", "creative")


def run_of(abilities, times, condition=WALLS):
    rows = [
        Robot(condition.task, "creative", 1, 0, k, 0.0, t, a, category_in(condition.task, a))
        for k, (a, t) in enumerate(zip(abilities, times, strict=True))
    ]
    return Run("x", Experiment(), {condition: ConditionResults(rows, np.zeros((len(rows), 1)), {})})


def like_the_paper(shift=0):
    """Returns a run whose robots have the paper's classes, some of them moved to L < 0."""
    random = np.random.default_rng(3)
    ones, above, _, below, none = PAPER[WALLS].counts
    found = [*[1.0] * (ones - shift), *random.uniform(0.1, 0.9, above)]
    found += [*random.uniform(-1, -0.3, below + shift), *[math.nan] * none]
    return run_of(found, np.full(len(found), 48.0))


def test_robots_like_the_papers_are_likelier_than_others():
    scores = [log_likelihood(like_the_paper(shift), WALLS) for shift in (0, 50, 150)]
    assert scores[0] > scores[1] > scores[2]
    assert log_likelihood(like_the_paper(), WALLS) == scores[0]


def test_a_run_without_measured_robots_has_no_likelihood():
    assert math.isnan(log_likelihood(run_of([math.nan] * 20, [0.0] * 20), WALLS))


def test_the_paper_tells_the_newborns_of_spot_finding_and_bounds_those_of_wall_avoidance():
    assert unmet_before(SPOT) == pytest.approx((0.532, 0.532))
    assert unmet_before(WALLS) == pytest.approx((0.146, 0.306))


def test_a_newborn_score_is_highest_in_the_papers_bounds():
    assert newborn_score(0.2, 250, WALLS) == 0
    assert newborn_score(0.5, 250, WALLS) < newborn_score(0.4, 250, WALLS) < 0
    assert newborn_score(0.5, 250, SPOT) > newborn_score(0.45, 250, SPOT)


COLUMNS = [Condition(t, p) for t in ("wall_avoidance", "spot_finding") for p in ("fixed", "random")]


@pytest.mark.parametrize(
    ("differences", "error", "expected"),
    [
        ([2, 2, 2, 2], 1, "supported"),
        ([-2, -2, -2, -2], 1, "opposed"),
        ([2, 2, 2, 2], 5, "undecided"),  # within two standard errors
        ([9, 2, -1, -1], 1, "undecided"),  # the tasks disagree
        ([9, -4, 1, 1], 1, "undecided"),  # one column decides
    ],
)
def test_a_verdict_needs_both_tasks_and_no_single_column(differences, error, expected):
    assert verdict(dict(zip(COLUMNS, differences, strict=True)), error) == expected


def test_a_verdict_needs_more_than_twice_the_error():
    assert verdict({WALLS: 2.0}, 1) == "undecided"
    assert verdict({WALLS: 2.001}, 1) == "supported"
    assert verdict({WALLS: -0.5}, 0.1) == "opposed"


def test_the_scale_of_a_newborn_score_is_that_of_a_normal_log_density():
    share, sampling = 0.6, 0.532 * 0.468 * (1 / 250 + 1 / 500)
    z = (share - 0.532) / math.sqrt(sampling + 0.03**2)
    assert newborn_score(share, 250, SPOT) == pytest.approx(-(z**2) / 2)


def test_one_column_in_each_task_is_enough_for_a_verdict():
    assert verdict({WALLS: 3.0, SPOT: 3.0}, 1) == "supported"
    assert verdict({SPOT: 3.0}, 1) == "supported"


def test_a_main_effect_is_a_difference_of_means():
    assert main_effect([1, 2, 5, 6], [-1, -1, 1, 1]) == 4


def test_the_score_of_exact_classes_differs():
    near = run_of([0.004] * 10 + [1.0] * 10, [1.0] * 20)
    exact = dataclasses.replace(near, exact_classes=True)
    assert log_likelihood(near, WALLS) != log_likelihood(exact, WALLS)
