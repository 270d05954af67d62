"""Whether creativity pays, on lives made by hand."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from musebot.controller import BRAINS, Parameters
from musebot.protocols.agents.base import make_agent
from musebot.protocols.analysis.comparison import Side, verdict
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.experiment import CohortKey, Experiment
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.protocols.reporting import robot_figures as portraits
from musebot.protocols.results.learn_ability import category, learn_ability
from musebot.protocols.results.results import Results, Robot, collect
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.studies import creativity

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
    lacked = [{"no smell": (0.01, 0.4)}, {"no smell": (0.125, 0.25), "inside": (0, 1)}]
    found = creativity.contests([side(times), among])
    page = creativity.markdown(found, lacked).splitlines()
    rows = [line.split(" | ") for line in page[2:6]]
    assert [row[0] for row in rows] == ["| run", "| run", "| other", "| other"]
    assert {(row[1], row[2]) for row in rows} == {("3", "40 and 40")}
    assert {row[-1] for row in rows} == {"better |"}
    assert "over the 4 rows" in page[7]
    assert page[11:14] == [
        "| run | 3 | spot_finding | no smell | 1.0% | 40.0% |",
        "| other | 3 | spot_finding | no smell | 12.5% | 25.0% |",
        "| other | 3 | spot_finding | inside | 0.0% | 100.0% |",
    ]
    assert page[17:] == ["- run: brain paper ideas=3", "- other: brain paper ideas=3, course walls"]


def test_the_figure_shows_both_times_and_their_difference_a_row_a_contest():
    times = {"creative": 500, "random": 200}
    runs = [side({(task, kind): mean for kind, mean in times.items()}) for task in (WA, SF)]
    found = creativity.contests(runs)
    both, apart = creativity.draw(found).axes
    marks = [line for line in both.lines if line.get_marker() == "o"]
    pairs = zip(found, marks[::2], marks[1::2], strict=True)
    for row, (contest, creative, random) in enumerate(pairs):
        time = contest.cells[1]
        assert [*creative.get_xydata()[0]] == [time.ours, row]
        assert [*random.get_xydata()[0]] == [time.other, row]
        interval, difference = apart.lines[2 * row : 2 * row + 2]
        assert tuple(interval.get_xdata()) == time.interval
        assert difference.get_xdata() == [time.difference]
    words = [label.get_text() for label in both.get_yticklabels()]
    assert words == ["run, 3 ideas\nin contact: less is better", "run, 3 ideas\nin the spot"]


def test_the_figure_is_written_and_a_bad_place_refused_before_any_work(tmp_path, monkeypatch):
    run = side({(SF, "creative"): 500, (SF, "random"): 200})
    monkeypatch.setattr(creativity.engine, "read_run", lambda out, enact: (FEW, run.results))
    monkeypatch.setattr(creativity, "lacks", lambda contest: {})
    for suffix in ("svg", "png"):
        creativity.main((Path("run"),), tmp_path / f"figure.{suffix}")
    assert {path.name for path in tmp_path.iterdir()} == {"figure.svg", "figure.png"}
    monkeypatch.delattr(creativity.engine, "read_run")
    with pytest.raises(InputError, match="the figure must be an .svg or .png"):
        creativity.main((Path("run"),), tmp_path / "figure.pdf")


def lives(experiment, task, proposer):
    key = CohortKey(task, proposer, 0)
    cohort = Cohort(experiment, key)
    cohort.advance(10**9)
    return key, cohort.lives()


@pytest.mark.parametrize("task", [WA, SF])
def test_what_ideas_lack_is_told_of_either_task_and_less_of_more_random_ones(task):
    shared = Experiment(cohort_size=20, time_scale=0.002, body="kinematic")
    few, many = (
        dataclasses.replace(shared, brain=dataclasses.replace(BRAINS["steady"], ideas=ideas))
        for ideas in (3, 25)
    )
    results = collect(few, [lives(few, task, "creative"), lives(few, task, "random")])
    three, five_and_twenty = (
        creativity.lacks(creativity.Contest(Side("run", experiment, results), task, ()))
        for experiment in (few, many)
    )
    assert three.keys() == five_and_twenty.keys() and len(three) == 3
    for situation, shares in three.items():
        assert 0 < shares[0] < 1 and 0 < five_and_twenty[situation][1] < shares[1] < 1
    rows = [dataclasses.replace(row, category="invalid") for row in results.robots]
    nobody = Side("run", few, Results(rows, results.curves, results.brains))
    assert creativity.lacks(creativity.Contest(nobody, task, ())) == {}


def test_the_best_of_all_actions_lacks_nothing_and_the_worst_all():
    brain = make_agent(Experiment(cohort_size=4), SF, "creative", 4, 1).controller
    sensed = torch.rand(4, 1, generator=torch.Generator().manual_seed(0))
    actions = portraits.grid().expand(4, -1, -1)
    assert portraits.lacking(brain, sensed, actions[:, None]).tolist() == [[0.0]] * 4
    values = brain.values(sensed, actions)
    for which, share in ((values.argmax(dim=1), 0.0), (values.argmin(dim=1), 1.0)):
        one = actions[torch.arange(4), which][:, None, None]
        # Alone, an action's value is rounded otherwise than among all.
        assert portraits.lacking(brain, sensed, one)[:, 0] == pytest.approx([share] * 4, abs=1e-5)
    half = (values.amax(dim=1) + values.amin(dim=1)) / 2
    nearest = (values - half[:, None]).abs().argmin(dim=1)
    one = actions[torch.arange(4), nearest][:, None, None]
    assert portraits.lacking(brain, sensed, one)[:, 0] == pytest.approx([0.5] * 4, abs=0.05)


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
