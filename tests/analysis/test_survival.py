"""Kaplan-Meier curves and log-rank tests against textbook values and against simulation."""

import math

import numpy as np
import pytest

from musebot.protocols.analysis.survival import Durations, kaplan_meier, log_rank, restricted

# Freireich et al., Blood 21 (1963): weeks of remission of 21 patients each; + is censored. Cox
# (JRSS B 34, 1972) and most textbooks use them.
DRUG = "6 6 6 6+ 7 9+ 10 10+ 11+ 13 16 17+ 19+ 20+ 22 23 25+ 32+ 32+ 34+ 35+"
PLACEBO = "1 1 2 2 3 4 4 5 5 8 8 8 8 11 11 12 12 15 17 22 23"


def of(text):
    words = text.split()
    times = np.array([float(word.rstrip("+")) for word in words])
    return Durations(times, np.array([not word.endswith("+") for word in words]))


def test_the_curve_is_the_one_that_textbooks_print():
    curve = kaplan_meier(of(DRUG))
    shares = dict(zip(curve.times.tolist(), curve.share.round(3).tolist(), strict=True))
    printed = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448}
    assert printed.items() <= shares.items()
    assert curve.median == 23
    placebo = kaplan_meier(of(PLACEBO))
    assert placebo.median == 8
    assert placebo.median_interval == (4, 11)  # as R's survfit with conf.type "log-log"
    assert curve.median_interval == (13, math.inf)


def test_the_log_rank_test_gives_the_textbook_statistic():
    from scipy.stats import chi2

    assert chi2.isf(log_rank(of(DRUG), of(PLACEBO)), 1) == pytest.approx(16.79, abs=0.01)


def test_the_log_rank_test_rejects_equal_groups_as_often_as_its_level():
    draw = np.random.default_rng(0)
    found = []
    for _ in range(400):
        groups = []
        for _ in range(2):
            times = np.ceil(draw.exponential(10, 40)) * 10  # ties, as probes every ten minutes
            groups.append(Durations(np.minimum(times, 240), times <= 240))
        found.append(log_rank(*groups))
    assert np.mean(np.array(found) < 0.05) == pytest.approx(0.05, abs=0.03)


def test_a_median_that_is_not_reached_is_infinite():
    curve = kaplan_meier(of("10 20+ 20+ 20+"))
    assert curve.median == math.inf
    assert curve.median_interval[1] == math.inf


@pytest.mark.parametrize("robots", [1, 5, 6])
def test_a_few_robots_that_all_have_the_event_leave_the_median_open(robots):
    """As R's survfit: the upper band stays above one half until too few robots are left."""
    curve = kaplan_meier(of(" ".join(str(10 * n) for n in range(1, robots + 1))))
    assert curve.share[-1] == 0
    assert curve.median_interval[1] == math.inf


@pytest.mark.parametrize(("robots", "upper"), [(3, math.inf), (40, 0)])
def test_the_median_of_robots_that_all_have_the_event_at_once_is_known_if_they_are_many(
    robots, upper
):
    assert kaplan_meier(of("0 " * robots)).median_interval == (0, upper)


def test_an_event_at_time_0_counts():
    curve = kaplan_meier(of("0 0 0 10"))
    assert curve.times[0] == 0 and curve.share[0] == 0.25
    assert curve.median == 0


def test_without_events_there_is_no_p_and_without_robots_no_curve():
    assert math.isnan(log_rank(of("10+ 10+"), of("10+ 5+")))
    assert math.isnan(log_rank(of("10 20"), of("")))
    with pytest.raises(ValueError, match="at least one robot"):
        kaplan_meier(of(""))


def test_a_robot_without_the_event_counts_as_the_limit():
    assert restricted(of("0 30 20+ 400"), 240).tolist() == [0, 30, 240, 240]
