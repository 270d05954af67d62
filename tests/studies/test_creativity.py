"""Whether creativity helps, on robots with known times."""

import dataclasses

import numpy as np
import pytest

from musebot.controller import BRAINS, Parameters
from musebot.protocols.analysis.comparison import verdict
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.experiment.manifest import write_manifest
from musebot.protocols.experiment.plan import Plan
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.protocols.results.learn_ability import category, learn_ability
from musebot.protocols.results.results import ConditionResults, Robot, collect
from musebot.protocols.results.run import Run
from musebot.protocols.results.run_files import write_results
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.studies import creativity
from musebot.protocols.studies.creativity import Contrast, Creativity
from musebot.protocols.studies.study import conduct

WA, SF = "wall_avoidance", "spot_finding"
FEW = Experiment(brain=Parameters(ideas=3))


def run(seconds, experiment=FEW, name="run"):
    """A run: mean seconds after training by condition, of 40 robots; 100 s before it."""
    results, random = {}, np.random.default_rng(0)
    for (task, proposer), mean in seconds.items():
        rows = []
        for i, post in enumerate(np.round(mean + random.normal(0, 20, 40), 1).tolist()):
            pair = np.array([100.0]), np.array([post])
            ability = float(learn_ability(*pair, SCHEDULES[task].wanted)[0])
            row = Robot(task, proposer, 1, 0, i, 100.0, post, ability, category(ability))
            rows.append(row)
        nothing = {"before": {}, "after": {}}
        curves = np.zeros((40, 1), np.float32)
        results[Condition(task, proposer)] = ConditionResults(rows, curves, nothing)
    return Run(name, experiment, results)


@pytest.mark.parametrize(("task", "more"), [(SF, "better"), (WA, "worse")])
def test_more_time_in_the_spot_is_better_and_in_contact_worse(task, more):
    (contrast,) = creativity.contrasts([run({(task, "creative"): 500, (task, "random"): 200})])
    assert [verdict(cell) for cell in contrast.cells] == [more, more]
    ability, share = contrast.cells
    assert ability.name == "mean L"
    assert share.difference * (3600 if task == SF else 1200) == pytest.approx(300, abs=20)
    assert share.interval[0] < share.difference < share.interval[1]
    (contrast,) = creativity.contrasts([run({(task, "creative"): 200, (task, "random"): 500})])
    less = {"better": "worse", "worse": "better"}[more]
    assert [verdict(cell) for cell in contrast.cells] == [less, less]


def test_equal_robots_are_undecided():
    alike = {(SF, "creative"): 300, (SF, "random"): 300}
    (contrast,) = creativity.contrasts([run(alike)])
    assert [verdict(cell) for cell in contrast.cells] == ["undecided"] * 2


def test_what_is_tested_together_is_corrected_together():
    one = run({(SF, "creative"): 316, (SF, "random"): 300})
    (alone,), five = creativity.contrasts([one]), creativity.contrasts([one] * 5)
    for found in ((alone,), five):
        cells = [cell for contrast in found for cell in contrast.cells]
        assert len(cells) == 2 * len(found)
        smallest = min(cell.p for cell in cells)
        assert 0 < smallest < 0.05
        # Holm: the smallest p is multiplied by the number of all cells.
        assert min(cell.corrected for cell in cells) == pytest.approx(len(cells) * smallest)


def test_the_page_describes_each_run():
    times = {(SF, "creative"): 500, (SF, "random"): 200, (WA, "creative"): 10}
    other = run(times, dataclasses.replace(FEW, protocol="walls"), "other")
    regretted = [{"no smell": (0.01, 0.4)}, {"no smell": (0.125, 0.25), "inside": (0, 1)}]
    found = creativity.contrasts([run(times), other])
    page = creativity.markdown(found, regretted).splitlines()
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
    assert page[17:] == [
        "- run: brain paper ideas=3",
        "- other: brain paper ideas=3, protocol walls",
    ]


def test_the_figure_shows_both_times_and_their_difference_in_a_row_for_each_contrast():
    times = {"creative": 500, "random": 200}
    runs = [run({(task, kind): mean for kind, mean in times.items()}) for task in (WA, SF)]
    found = creativity.contrasts(runs)
    both, apart = creativity.draw(found).axes
    marks = [line for line in both.lines if line.get_marker() == "o"]
    pairs = zip(found, marks[::2], marks[1::2], strict=True)
    for row, (contrast, creative, random) in enumerate(pairs):
        time = contrast.cells[1]
        assert [*creative.get_xydata()[0]] == [time.ours, row]
        assert [*random.get_xydata()[0]] == [time.other, row]
        interval, difference = apart.lines[2 * row : 2 * row + 2]
        assert tuple(interval.get_xdata()) == time.interval
        assert difference.get_xdata() == [time.difference]
    words = [label.get_text() for label in both.get_yticklabels()]
    assert words == ["run, 3 ideas\nin contact: less is better", "run, 3 ideas\nin the spot"]


def lives(experiment, task, proposer):
    key = CohortKey(Condition(task, proposer), 0)
    cohort = Cohort(experiment, key)
    cohort.advance(10**9)
    return key, cohort.lives()


def test_a_study_of_kept_runs_has_a_page_and_a_figure(tmp_path, here, invented):
    # Untrained brains and invented times: what is simulated for hours is not the point.
    experiment = Experiment(cohort_size=40, body="kinematic", brain=BRAINS["steady"])
    made = run({(SF, "creative"): 500, (SF, "random"): 200}, experiment)
    results = {c: invented(experiment, part.robots) for c, part in made.results.items()}
    for condition, part in results.items():
        newborn = Cohort(experiment, CohortKey(condition, 0)).lives().before
        part.networks.update(before=newborn, after=newborn)
    folder = tmp_path / "kept"
    folder.mkdir()
    write_manifest(folder, Plan.of(experiment, made.conditions(), 40))
    write_results(folder, results)
    page = conduct(Creativity((folder,)), tmp_path / "out", here)
    rows = [line.split(" | ") for line in page.markdown.splitlines()]
    assert [row[-1] for row in rows[2:4]] == ["better |", "better |"]
    assert len([row for row in rows if row[0] == "| kept"]) == 2 + 3
    names = {"study.json", "creativity.md", "creativity.svg", "creativity.png"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names


@pytest.mark.parametrize("task", [WA, SF])
def test_more_ideas_have_less_regret_in_either_task(task):
    shared = Experiment(cohort_size=20, time_scale=0.002, body="kinematic")
    few, many = (
        dataclasses.replace(shared, brain=dataclasses.replace(BRAINS["steady"], ideas=ideas))
        for ideas in (3, 25)
    )
    results = collect(few, [lives(few, task, "creative"), lives(few, task, "random")])
    three, many_ideas = (
        creativity.regrets(Contrast(Run("run", experiment, results), task, ()))
        for experiment in (few, many)
    )
    assert three.keys() == many_ideas.keys() and len(three) == 3
    for situation, shares in three.items():
        assert 0 < shares[0] < 1 and 0 < many_ideas[situation][1] < shares[1] < 1
    invalid = {
        condition: dataclasses.replace(
            part, robots=[dataclasses.replace(row, category="invalid") for row in part.robots]
        )
        for condition, part in results.items()
    }
    assert creativity.regrets(Contrast(Run("run", few, invalid), task, ())) == {}


def test_invalid_robots_are_not_counted():
    one = run({(SF, "creative"): 500, (SF, "random"): 200})
    rows = one.robots(Condition(SF, "creative"))
    rows[0] = dataclasses.replace(rows[0], category="invalid")
    (contrast,) = creativity.contrasts([one])
    assert contrast.robots == (39, 40)


def test_a_run_without_both_kinds_of_robots_or_a_rehearsal_is_refused():
    with pytest.raises(InputError, match="run has no task with both creative and random robots"):
        creativity.contrasts([run({(SF, "creative"): 500, (WA, "random"): 200})])
    rehearsal = dataclasses.replace(FEW, time_scale=0.1)
    with pytest.raises(InputError, match="run is a rehearsal"):
        creativity.contrasts([run({(SF, "creative"): 5, (SF, "random"): 2}, rehearsal)])
    with pytest.raises(InputError, match="at least one run is needed"):
        Creativity(()).experiments()
