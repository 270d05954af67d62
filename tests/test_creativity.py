"""Whether creativity pays, on lives made by hand."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from musebot.controller import Parameters
from musebot.protocols import creativity
from musebot.protocols.beside import Side, verdict
from musebot.protocols.errors import InputError
from musebot.protocols.experiment import Experiment
from musebot.protocols.learn_ability import category, learn_ability
from musebot.protocols.results import Results, Robot
from musebot.protocols.schedules import SCHEDULES

WA, SF = "wall_avoidance", "spot_finding"
FEW = Experiment(brain=Parameters(ideas=3))


def side(seconds, experiment=FEW):
    """A run: mean seconds after training by condition, of 40 robots; 100 s before it."""
    rows, random = [], np.random.default_rng(0)
    for (task, proposer), mean in seconds.items():
        after = mean + random.normal(0, 20, 40)
        for i, post in enumerate(after):
            pair = np.array([100.0]), np.array([post])
            ability = float(learn_ability(*pair, SCHEDULES[task].wanted)[0])
            row = Robot(task, proposer, 1, 0, i, 100.0, post, ability, category(ability))
            rows.append(row)
    return Side("run", experiment, Results(rows, {}, {}))


@pytest.mark.parametrize(("task", "more"), [(SF, "better"), (WA, "worse")])
def test_more_time_in_the_spot_is_better_and_in_contact_worse(task, more):
    (contest,) = creativity.contests([side({(task, "creative"): 500, (task, "random"): 200})])
    assert [verdict(cell) for cell in contest.cells] == [more, more]
    ability, share = contest.cells
    assert ability.name == "mean L"
    assert share.difference * (3600 if task == SF else 1200) == pytest.approx(300, abs=20)
    assert share.interval[0] < share.difference < share.interval[1]
    (contest,) = creativity.contests([side({(task, "creative"): 200, (task, "random"): 500})])
    less = {"better": "worse", "worse": "better"}[more]
    assert [verdict(cell) for cell in contest.cells] == [less, less]


def test_robots_of_one_kind_leave_it_undecided():
    alike = {(SF, "creative"): 300, (SF, "random"): 300}
    (contest,) = creativity.contests([side(alike)])
    assert [verdict(cell) for cell in contest.cells] == ["undecided"] * 2


def test_what_is_tested_together_is_corrected_together():
    run = side({(SF, "creative"): 310, (SF, "random"): 300})
    (alone,), (first, *_) = creativity.contests([run]), creativity.contests([run] * 5)
    for one, of_five in zip(alone.cells, first.cells, strict=True):
        assert of_five.p == pytest.approx(one.p, abs=0.05)
        assert of_five.corrected >= one.corrected


def test_the_page_says_what_each_run_is():
    times = {(SF, "creative"): 500, (SF, "random"): 200, (WA, "creative"): 10}
    among = dataclasses.replace(side(times), name="other")
    among = dataclasses.replace(among, experiment=dataclasses.replace(FEW, course="walls"))
    page = creativity.markdown(creativity.contests([side(times), among])).splitlines()
    rows = [line.split(" | ") for line in page[2:6]]
    assert [row[0] for row in rows] == ["| run", "| run", "| other", "| other"]
    assert {(row[1], row[2]) for row in rows} == {("3", "40 and 40")}
    assert {row[-1] for row in rows} == {"better |"}
    assert "over the 4 rows" in page[7]
    assert page[9:] == ["- run: brain paper ideas=3", "- other: brain paper ideas=3, course walls"]


def test_invalid_lives_are_not_counted():
    run = side({(SF, "creative"): 500, (SF, "random"): 200})
    run.results.robots[0] = dataclasses.replace(run.results.robots[0], category="invalid")
    (contest,) = creativity.contests([run])
    assert contest.robots == (39, 40)


def test_a_run_without_both_kinds_of_robots_is_refused():
    with pytest.raises(InputError, match="run has no task with both creative and random robots"):
        creativity.contests([side({(SF, "creative"): 500, (WA, "random"): 200})])
    rehearsal = dataclasses.replace(FEW, time_scale=0.1)
    with pytest.raises(InputError, match="run is a rehearsal"):
        creativity.contests([side({(SF, "creative"): 5, (SF, "random"): 2}, rehearsal)])
    with pytest.raises(InputError, match="at least one run"):
        creativity.main(())
    with pytest.raises(InputError, match="a run is given twice"):
        creativity.main((Path("runs/a"), Path("runs/../runs/a")))
