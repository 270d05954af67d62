"""Two runs side by side, on lives made by hand, where everybody sees what must differ."""

import dataclasses
import json
import math

import numpy as np
import pytest

from musebot.controller import Parameters
from musebot.models import Kinematics
from musebot.protocols.analysis import comparison as beside
from musebot.protocols.analysis.comparison import CELLS, Side
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.experiment import CohortKey, Experiment, differing
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.protocols.reporting import tables
from musebot.protocols.results.learn_ability import CATEGORIES, category, learn_ability
from musebot.protocols.results.results import Results, Robot
from musebot.protocols.simulation.cohort import Cohort

WA, SF = "wall_avoidance", "spot_finding"
ROBOTS = 60


def side(name, times, *, invalid=(), brains=0, experiment=None):
    """A run: times before and after training in seconds, shape (robots, 2), by condition."""
    rows, born = [], {}
    for (task, proposer), seconds in times.items():
        schedule = SCHEDULES[task]
        abilities = learn_ability(*seconds.T, schedule.wanted)
        for i, (pre, post) in enumerate(seconds):
            kind = category(abilities[i])
            kind = schedule.unmeasured if kind == "unmeasured" else kind
            ability = math.nan if i in invalid else float(abilities[i])
            kind = "invalid" if i in invalid else kind
            rows.append(Robot(task, proposer, 1, 0, i, pre, post, ability, kind))
        draw = np.random.default_rng(brains).random((len(seconds), 3))
        born[f"{task}/{proposer}/before/evaluation.output_weights"] = draw
    return Side(name, experiment or Experiment(), Results(rows, {}, born))


def times(seed=0, longest=1200.0):
    """Of robots of all categories."""
    random = np.random.default_rng(seed)
    seconds = random.integers(0, 3, (ROBOTS, 2)) * random.integers(1, longest / 2, (ROBOTS, 1))
    return seconds.astype(float)


def two(first, second, condition=(WA, "fixed"), **options):
    return side("ours", {condition: first}, **options), side("other", {condition: second})


def by_name(cells):
    return {cell.name: cell for cell in cells}


def test_cells_are_those_of_the_tables():
    lives = {(t, p): times(i) for i, (t, p) in enumerate([(WA, "random"), (SF, "creative")])}
    ours, other = side("ours", lives, invalid={3, 4}), side("other", lives, brains=1)
    cells = beside.all_cells(ours, other)
    assert len(cells) == 2 * CELLS
    for task, proposer in lives:
        own = by_name(c for c in cells if (c.task, c.proposer) == (task, proposer))
        for which, run in (("ours", ours), ("other", other)):
            summary = tables.ours(run.experiment, run.results, task, proposer).summary
            *names, _ = tables.row_names(task)[1:]
            values = [*summary.shares, summary.mean, summary.deviation]
            post = f"share of time {'in the spot' if task == SF else 'in contact'}, post"
            for name, value in zip([*names, post], [*values, summary.post_share], strict=True):
                assert getattr(own[name], which) == pytest.approx(value), (task, name)
        pre = np.mean(lives[task, proposer][:, 0]) / (3600 if task == SF else 1200)
        assert own[post.replace("post", "pre")].other == pytest.approx(pre)


def test_a_run_beside_itself_differs_in_nothing():
    cells = beside.all_cells(*two(times(), times()))
    assert {cell.difference for cell in cells} == {0.0}
    assert {cell.p for cell in cells} == {1.0}
    assert not any(cell.differs for cell in cells)


def test_what_differs_is_found_and_what_does_not_is_not():
    first = np.tile([600.0, 60.0], (ROBOTS, 1))
    second = first.copy()
    second[:30, 1] = 900.0  # spoiled by training
    ours, other = two(second, first, invalid={59})
    cells = by_name(beside.all_cells(ours, other))
    differ = {name for name, cell in cells.items() if cell.differs}
    post, pre = (f"share of time in contact, {part}" for part in ("post", "pre"))
    assert differ == {"0 < L < 1", "L < 0", "mean L", "sd of L", post}
    assert cells["L < 0"].difference == pytest.approx(30 / 59)
    assert cells[post].difference == pytest.approx(30 / 59 * 840 / 1200)
    for name in differ - {"sd of L"}:
        low, high = cells[name].interval
        assert low < cells[name].difference < high
        assert low > 0 or high < 0
    assert cells[pre].corrected == 1
    text = beside.markdown(ours, other, list(cells.values()))
    assert f"After Holm's correction 5 of {CELLS} cells differ:" in text
    assert "- wall_avoidance, fixed: L < 0 50.8% against 0.0%, +50.8% [" in text


def test_robots_born_with_the_same_brain_are_compared_in_pairs_and_others_are_not():
    random = np.random.default_rng(3)
    first = random.uniform(300, 900, (ROBOTS, 2))
    second = first + random.uniform(0, 40, (ROBOTS, 2))  # each a little more
    pairs = by_name(beside.all_cells(*two(first, second)))
    others = by_name(beside.all_cells(*two(first, second, brains=1)))
    name = "share of time in contact, pre"
    assert pairs[name].difference == others[name].difference < 0
    assert pairs[name].differs and not others[name].differs
    assert "McNemar's exact" in beside.markdown(*two(first, second), list(pairs.values()))
    unpaired = beside.markdown(*two(first, second, brains=1), list(others.values()))
    assert "The robots are no pairs" in unpaired and "Fisher's exact" in unpaired


def test_runs_of_two_bodies_are_pairs_and_of_two_seeds_or_sizes_are_not():
    def newborn(**fields):
        experiment = Experiment(**({"cohort_size": 3, "time_scale": 0.01} | fields))
        born = Cohort(experiment, CohortKey(SF, "creative", 0)).agent.weights()
        brains = {f"{SF}/creative/before/{name}": array for name, array in born.items()}
        return Side("", experiment, Results([], {}, brains))

    real = newborn()
    for fields, expected in (
        ({"body": "kinematic"}, True),
        ({"body": "kinematic", "kinematics": Kinematics(radius=0.02)}, True),
        ({"brain": Parameters(test_epsilon=0.01)}, True),
        ({"seed": 2}, False),
        ({"cohort_size": 4}, False),
    ):
        assert beside.are_pairs(real, newborn(**fields), (SF, "creative")) == expected, fields


def test_robots_that_one_of_two_runs_of_pairs_has_beyond_the_other_are_left_out():
    ours, longer = (
        side("ours", {(WA, "fixed"): times()}),
        Side("longer", *_twice(times(), times(9))),
    )
    cells = beside.all_cells(ours, longer)
    assert all(cell.paired for cell in cells)
    assert {cell.difference for cell in cells} == {0.0}


def _twice(first, second):
    """A run of twice as many robots: the first ones' brains, and others'."""
    one, two = (side("", {(WA, "fixed"): t}, brains=k) for k, t in enumerate((first, second)))
    more = [dataclasses.replace(row, robot=row.robot + ROBOTS) for row in two.results.robots]
    brains = {
        name: np.concatenate([array, two.results.brains[name]])
        for name, array in one.results.brains.items()
    }
    return one.experiment, Results([*one.results.robots, *more], {}, brains)


def test_of_pairs_with_an_invalid_life_both_are_left_out():
    first, second = times(1), times(2)
    ours, other = two(first, second, invalid={0, 7})
    keep = np.delete(np.arange(ROBOTS), [0, 7])
    expected = beside.all_cells(*two(first[keep], second[keep]))
    assert list(map(repr, beside.all_cells(ours, other))) == list(map(repr, expected))


def test_what_experiments_differ_in_is_named():
    ours = Experiment(body="kinematic", kinematics=Kinematics(radius=0.02), cohort_size=7)
    other = dataclasses.replace(ours, kinematics=Kinematics(), brain=Parameters(epsilon=0.0))
    assert differing(ours, ours) == {}
    assert differing(ours, other) == {
        "kinematics.radius": (0.02, None),
        "brain.epsilon": (0.01, 0.0),
    }
    lives = {(WA, "fixed"): times()}
    same, one, both = (
        beside.markdown(side("a", lives, experiment=ours), side("b", lives, experiment=b), [])
        for b in (ours, dataclasses.replace(ours, seed=4), other)
    )
    assert "Their experiments are the same" in same
    assert "differ in seed (1, 4)." in one
    assert "differ in 2 fields" in both and "kinematics.radius (0.02, None); brain." in both


def test_only_conditions_that_both_runs_have_are_compared():
    a, b, c = (WA, "fixed"), (SF, "fixed"), (SF, "random")
    ours = side("ours", {a: times(), b: times()})
    other = side("other", {b: times(), c: times()})
    assert {(cell.task, cell.proposer) for cell in beside.all_cells(ours, other)} == {b}
    with pytest.raises(InputError, match="ours and third have no task and proposer in common"):
        beside.all_cells(ours, side("third", {c: times()}))


def test_a_rehearsal_does_not_stand_beside_a_life():
    ours = side("ours", {(WA, "fixed"): times()})
    with pytest.raises(InputError, match="durations are the paper's times 1 and 0.5"):
        beside.all_cells(ours, dataclasses.replace(ours, experiment=Experiment(time_scale=0.5)))


@pytest.mark.parametrize("robots", [1, 4, 30])
@pytest.mark.parametrize("invalid", [(), range(30)], ids=["valid", "invalid"])
def test_degenerate_lives_have_dashes_and_plain_json(robots, invalid, recwarn):
    never = np.zeros((robots, 2))
    ours, other = two(never, never + 1, invalid=invalid)
    cells = beside.all_cells(ours, other)
    text = beside.markdown(ours, other, cells)
    assert "nan" not in text
    plain = json.loads(json.dumps(beside.as_json(ours, other, cells), allow_nan=False))
    assert [cell["name"] for cell in plain["cells"]][: len(CATEGORIES)] == [
        *CATEGORIES[:-1],
        "(genius)",
    ]
    assert {cell["paired"] for cell in plain["cells"]} == {True}
    assert not recwarn.list
