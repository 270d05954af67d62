"""Comparisons of two runs made by hand, where everybody sees what must differ."""

import dataclasses
import sys

import numpy as np
import pytest
from helpers import run_of_rows

from musebot.controller import Parameters
from musebot.models import Kinematics
from musebot.protocols.analysis import comparison
from musebot.protocols.analysis.comparison import _newborns, compare_runs, is_paired
from musebot.protocols.errors import InputError
from musebot.protocols.pages import tables
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.learn_ability import CATEGORIES, category, learn_ability
from musebot.protocols.runs.run import Robot
from musebot.tasks.lives import LIVES

WA, SF = "wall_avoidance", "spot_finding"
WALLS_FIXED = Condition(WA, "fixed")
ROBOTS = 60
NAN = float("nan")


def run_of(name, times, *, invalid=(), **fields):
    """Returns a run from the times of its robots, by condition; fields are of its experiment."""
    rows = []
    for condition, seconds in times.items():
        schedule = LIVES[condition.life]
        abilities = learn_ability(*seconds.T, schedule.wanted)
        for i, (pre, post) in enumerate(seconds):
            kind = category(abilities[i]).replace("unmeasured", schedule.unmeasured)
            own = (NAN, "invalid") if i in invalid else (float(abilities[i]), kind)
            rows.append(Robot(condition.life, condition.proposer, 1, 0, i, pre, post, *own))
    return run_of_rows(rows, Experiment(**fields), name=name)


def times(seed=0, longest=1200.0):
    """Returns times of robots of all categories."""
    random = np.random.default_rng(seed)
    seconds = random.integers(0, 3, (ROBOTS, 2)) * random.integers(1, longest / 2, (ROBOTS, 1))
    return seconds.astype(float)


def two(first, second, **options):
    ours = run_of("ours", {WALLS_FIXED: first}, **options)
    return ours, run_of("other", {WALLS_FIXED: second})


def by_name(cells):
    return {cell.name: cell for cell in cells}


def test_only_the_cells_that_differ_are_reported():
    first = np.tile([600.0, 60.0], (ROBOTS, 1))
    second = first.copy()
    second[:30, 1] = 900.0  # spoiled by training
    ours, other = two(second, first, invalid={59})
    cells = by_name(compare_runs(ours, other))
    differ = {name for name, cell in cells.items() if cell.differs}
    post, pre = (f"share of time in contact, {part}" for part in ("post", "pre"))
    assert differ == {"0 < L < 1", "L < 0", "mean L", "sd of L", post}
    assert cells["L < 0"].difference == pytest.approx(30 / 59)
    assert cells[post].difference == pytest.approx(30 / 59 * 840 / 1200)
    for name in differ - {"sd of L"}:
        low, high = cells[name].interval
        assert low < cells[name].difference < high and not low <= 0 <= high
    assert cells[pre].corrected == 1
    text = tables.comparison_markdown(ours, other, list(cells.values()))
    assert "After Holm's correction 5 of 9 cells differ:" in text


def test_robots_with_the_same_newborn_brain_are_compared_in_pairs_and_others_are_not():
    random = np.random.default_rng(3)
    first = random.uniform(300, 900, (ROBOTS, 2))
    second = first + random.uniform(0, 40, (ROBOTS, 2))  # each a little more
    found = []
    for seed, words in ((1, "McNemar's exact"), (2, "Fisher's exact")):  # no run holds networks
        runs = two(first, second, seed=seed)
        cells = compare_runs(*runs)
        assert words in tables.comparison_markdown(*runs, cells)
        found.append(by_name(cells)["share of time in contact, pre"])
    pairs, others = found
    assert pairs.difference == others.difference < 0
    assert pairs.differs and not others.differs


def test_runs_of_two_bodies_are_pairs_and_of_two_seeds_or_sizes_are_not():
    real, condition = run_of("", {}, cohort_size=3), Condition(SF, "creative")
    for fields, expected in (
        ({"body": "kinematic"}, True),
        ({"body": "kinematic", "kinematics": Kinematics(radius=0.02)}, True),
        ({"brain": Parameters(test_epsilon=0.01)}, True),
        ({"brain": Parameters(memory_hidden=6)}, False),
        ({"seed": 2}, False),
        ({"cohort_size": 4}, False),
        ({"device": "cuda:0", "body": "kinematic"}, False),
    ):
        other = run_of("", {}, **{"cohort_size": 3} | fields)
        assert is_paired(real, other, condition) == expected, fields
    assert not is_paired(real, real, Condition(SF, "unknown.module:agent"))


def test_robots_that_begin_with_equal_weights_are_pairs_only_in_equal_streams(monkeypatch):
    monkeypatch.setattr(comparison, "_newborns", lambda *_: {"table": np.zeros(3)})
    for fields, expected in (({"body": "kinematic"}, True), ({"seed": 2}, False)):
        assert is_paired(run_of("", {}), run_of("", {}, **fields), WALLS_FIXED) == expected


@pytest.mark.parametrize("fields", [{}, {"body": "kinematic", "backend": "numba"}])
def test_newborns_are_those_of_the_run_and_need_no_numba(fields, monkeypatch):
    experiment, condition = Experiment(cohort_size=3, **fields), Condition(SF, "creative")
    born = Cohort(experiment, CohortKey(condition, 0)).agent.weights()
    monkeypatch.setitem(sys.modules, "musebot.controller.compiled", None)
    np.testing.assert_equal(_newborns(experiment, condition), born)


def test_pairs_without_two_valid_robots_are_left_out():
    first, second = times(1), times(2)[:50]  # ten robots have no partner
    ours, other = two(first, second, invalid={0, 7})
    keep = np.delete(np.arange(50), [0, 7])
    cells, expected = compare_runs(ours, other), compare_runs(*two(first[keep], second[keep]))
    assert all(cell.paired for cell in cells)
    assert list(map(repr, cells)) == list(map(repr, expected))


def test_pairs_of_which_one_robot_has_no_ability_are_left_out_of_it_and_counted():
    first, second = times(1), times(2)
    first[:9] = second[5:20] = 0.0  # geniuses: robots without contact have no L
    whole = ((first.sum(axis=1) > 0) & (second.sum(axis=1) > 0)).nonzero()[0]
    only_one = ((first.sum(axis=1) > 0) ^ (second.sum(axis=1) > 0)).sum()
    ours, other = two(first, second)
    cells, complete = by_name(compare_runs(ours, other)), two(first[whole], second[whole])
    expected = by_name(compare_runs(*complete))
    for name in ("mean L", "sd of L"):
        left_out = dataclasses.replace(expected[name], incomplete=int(only_one), corrected=0.0)
        assert repr(dataclasses.replace(cells[name], corrected=0.0)) == repr(left_out)
        assert cells[name].robots == (len(whole), len(whole)) != (ROBOTS, ROBOTS)
    assert cells["L = 1"].robots == (ROBOTS, ROBOTS) and cells["L = 1"].incomplete == 0
    text = tables.comparison_markdown(ours, other, [*cells.values()])
    assert f"left out because only one has it: {only_one} (wall_avoidance, fixed)." in text
    assert "left out" not in tables.comparison_markdown(*complete, [*expected.values()])


def test_the_fields_in_which_experiments_differ_are_named():
    fields = {"body": "kinematic", "cohort_size": 7}
    radius = {"kinematics": Kinematics(radius=0.02)}
    ours = run_of("a", {}, **fields, **radius)
    same, one, both = (
        tables.comparison_markdown(ours, run_of("b", {}, **fields, **other), [])
        for other in (radius, {"seed": 4, **radius}, {"brain": Parameters(epsilon=0.0)})
    )
    assert "Their experiments are the same" in same
    assert "differ in seed (1, 4)." in one
    assert "differ in 2 fields" in both and "kinematics.radius (0.02, None); brain." in both


def test_only_conditions_that_both_runs_have_are_compared():
    a, b, c = WALLS_FIXED, Condition(SF, "fixed"), Condition(SF, "random")
    ours = run_of("ours", {a: times(), b: times()})
    other = run_of("other", {b: times(), c: times()})
    assert {cell.condition for cell in compare_runs(ours, other)} == {b}
    with pytest.raises(InputError, match="ours and third have no task and proposer in common"):
        compare_runs(ours, run_of("third", {c: times()}))
    with pytest.raises(InputError, match="their time scales are 1.0 and 0.5"):
        compare_runs(ours, run_of("short", {a: times()}, time_scale=0.5))


def test_degenerate_runs_have_dashes(recwarn):
    for robots, invalid in ((1, ()), (4, ()), (30, ()), (4, range(4)), (30, range(30))):
        never = np.zeros((robots, 2))
        ours, other = two(never, never + 1, invalid=invalid)
        cells = compare_runs(ours, other)
        assert "nan" not in tables.comparison_markdown(ours, other, cells)
        assert [cell.name for cell in cells][:4] == [*CATEGORIES[:4]]
        assert {cell.paired for cell in cells} == {True}
    assert not recwarn.list
