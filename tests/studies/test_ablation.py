"""What each ingredient of our brain is worth, on lives made by hand and on short ones."""

import dataclasses
import sys

import numpy as np
import pytest
import tyro

from musebot.controller import INGREDIENTS
from musebot.protocols.analysis import comparison as beside
from musebot.protocols.analysis.comparison import Side
from musebot.protocols.errors import exit_status
from musebot.protocols.experiment.experiment import (
    TASKS,
    CohortKey,
    Experiment,
    differing,
    load_plan,
    named_brain,
)
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.protocols.options import Workers
from musebot.protocols.results.learn_ability import category, learn_ability
from musebot.protocols.results.results import Results, Robot
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.simulation.engine import PLAN, read_run
from musebot.protocols.studies import ablation
from musebot.protocols.studies.ablation import WHOLE

WA, SF = "wall_avoidance", "spot_finding"
STEADY = Experiment(brain=named_brain(WHOLE), body="kinematic")


def side(name, seconds, born=None):
    """A run: mean seconds after training by task, of 40 robots; 100 s before it."""
    rows, random = [], np.random.default_rng(len(name))
    for task, mean in seconds.items():
        for robot, post in enumerate(mean + random.normal(0, 20, 40)):
            pair = np.array([100.0]), np.array([post])
            ability = float(learn_ability(*pair, SCHEDULES[task].wanted)[0])
            rows.append(
                Robot(task, "creative", 1, 0, robot, 100.0, post, ability, category(ability))
            )
    return Side(name, STEADY, Results(rows, {}, born or {}))


def judged(*sides):
    return ablation.judge({side.name: side for side in sides})


def verdicts(cells):
    return [beside.verdict(cell) for cell in cells]


def run(out, **options):
    small = {"robots": 5, "time_scale": 0.001, "workers": Workers(1), "body": "kinematic"}
    return exit_status(lambda: ablation.main(out, **(small | options)))


def listing(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_each_run_lacks_one_ingredient_and_nothing_else():
    wanted = ablation.plans(60, TASKS, dataclasses.replace(STEADY, cohort_size=20))
    whole = wanted.pop(WHOLE)
    assert whole.robots == {(task, "creative"): 60 for task in TASKS}
    assert whole.experiment.cohort_size == 20
    assert list(wanted) == [f"steady-{ingredient}" for ingredient in INGREDIENTS]
    for plan, (ingredient, fields) in zip(wanted.values(), INGREDIENTS.items(), strict=True):
        differ = differing(plan.experiment, whole.experiment)
        assert set(differ) == {f"brain.{field}" for field in fields}
        assert set(plan.robots.values()) == {60}
        assert [task for task, _ in plan.robots] == [
            task for task in TASKS if ablation.matters(ingredient, task)
        ]


@pytest.mark.parametrize("ingredient", INGREDIENTS)
def test_only_where_an_ingredient_cannot_matter_lives_are_the_same_without_it(
    ingredient, lived_here
):
    short = dataclasses.replace(STEADY, cohort_size=5, time_scale=0.002)
    less = dataclasses.replace(short, brain=named_brain(f"steady-{ingredient}"))
    learnt = []
    for experiment in (short, less):
        cohort = Cohort(experiment, CohortKey(WA, "creative", 0))
        cohort.advance(10**9)
        after = cohort.lives().after.items()
        learnt.append([nets.ravel() for name, nets in after if name.startswith("evaluation.")])
    same = np.array_equal(*map(np.concatenate, learnt))
    assert same != ablation.matters(ingredient, WA)


@pytest.mark.parametrize(("task", "worse"), [(SF, 200), (WA, 500)])
def test_less_time_in_the_spot_is_a_loss_and_more_in_contact(task, worse):
    sides = [side("steady", {task: 350}), side("steady-cap", {task: worse})]
    (cells,) = judged(*sides).values()
    assert [cell.name for cell in cells][0] == "mean L" and cells[0].robots == (40, 40)
    assert verdicts(cells) == ["better", "better"]
    sides = [side("steady", {task: worse}), side("steady-cap", {task: 350})]
    (cells,) = judged(*sides).values()
    assert verdicts(cells) == ["worse", "worse"]


def test_a_few_robots_of_mostly_perfect_ones_that_touch_a_wall_are_no_loss():
    """A bootstrap interval alone excludes 0 here, for want of zeros that are not zero."""
    seconds = np.zeros(60)
    perfect = side("steady", {WA: 0})
    rows = [
        dataclasses.replace(perfect.results.robots[0], robot=robot, t_post_s=post)
        for robot, post in enumerate(seconds)
    ]
    touched = [dataclasses.replace(row) for row in rows]
    touched[:3] = [
        dataclasses.replace(row, t_post_s=post)
        for row, post in zip(rows, (12, 24, 60), strict=False)
    ]
    whole = dataclasses.replace(perfect, results=Results(rows, {}, {}))
    less = dataclasses.replace(perfect, name="steady-cap", results=Results(touched, {}, {}))
    ((_, contact),) = judged(whole, less).values()
    assert contact.interval[1] < 0
    assert beside.verdict(contact) == "undecided"


def test_robots_of_one_kind_leave_it_undecided():
    (cells,) = judged(side("steady", {SF: 300}), side("steady-cap", {SF: 300})).values()
    assert verdicts(cells) == ["undecided"] * 2


def test_only_robots_with_a_learn_ability_are_counted_in_its_mean_and_no_invalid_ones():
    whole, less = side("steady", {SF: 300}), side("steady-cap", {SF: 300})
    nothing = {"t_pre_s": 0.0, "t_post_s": 0.0, "learn_ability": float("nan")}
    rows = less.results.robots
    rows[:3] = [dataclasses.replace(row, category="unmeasured", **nothing) for row in rows[:3]]
    rows[3] = dataclasses.replace(rows[3], category="invalid", **nothing)
    ((ability, share),) = judged(whole, less).values()
    assert ability.robots == (40, 36) and share.robots == (40, 39)


def test_brains_born_alike_are_pairs_and_others_are_not():
    name, nets = f"{SF}/creative/before/evaluation.weights0", np.arange(40.0)[:, None]
    whole = side("steady", {SF: 300}, {name: nets})
    for other, paired in ((nets, True), (nets + 1, False), (np.hstack([nets, nets]), False)):
        less = side("steady-cap", {SF: 300}, {name: other})
        assert all(cell.paired == paired for cell in judged(whole, less)[SF, "cap"])


def test_the_page_says_what_earns_its_place_where_and_what_does_harm():
    sides = [
        side("steady", {WA: 100, SF: 300}),
        side("steady-cap", {WA: 200, SF: 500}),
        side("steady-gap", {WA: 100, SF: 300}),
        side("steady-raw_reward", {SF: 100}),
    ]
    page = ablation.markdown({side.name: side for side in sides})
    assert page.splitlines()[0] == "| ingredient | Wall avoidance | Spot finding |"
    assert "| cap | earns | harms |" in page
    assert "| gap | undecided | undecided |" in page
    assert "| raw_reward | - | earns |" in page
    walls, spots = page.split("### ")[1:]
    assert walls.count("| raw_reward |") == 0 and spots.count("| raw_reward |") == 2
    assert walls.count("| 40 and 40 |") == 4 and spots.count("| 40 and 40 |") == 6
    assert "corrected over 10 cells" in page
    assert page.rstrip().endswith("- steady: brain steady, body kinematic")


def test_who_earns_in_one_number_and_harms_in_the_other_is_called_so():
    whole = side("steady", {SF: 300})
    mixed = [
        dataclasses.replace(row, t_post_s=100.0, learn_ability=1.0) for row in whole.results.robots
    ]
    less = dataclasses.replace(whole, name="steady-cap", results=Results(mixed, {}, {}))
    page = ablation.markdown({side.name: side for side in (whole, less)})
    assert "| cap | earns and harms |" in page


def test_an_ablation_keeps_every_run_and_its_page_and_goes_on_where_it_was(
    tmp_path, lived_here, monkeypatch, capsys
):
    few = {name: INGREDIENTS[name] for name in ("cap", "raw_reward")}
    monkeypatch.setattr(ablation, "INGREDIENTS", few)
    out = tmp_path / "out"
    assert run(out) == 0
    text = capsys.readouterr().out
    assert text.strip() == (out / "ablation.md").read_text().strip()
    assert ablation.report(out) == (out / "ablation.md").read_text()
    names = {"steady", "steady-cap", "steady-raw_reward", "ablation.md"}
    assert {path.name for path in out.iterdir()} == names
    assert "a rehearsal: every duration times 0.001" in text
    before = listing(out)
    for name in ("steady-cap/robots.csv", "ablation.md"):
        (out / name).unlink()
    assert run(out) == 0
    assert listing(out) == before
    capsys.readouterr()

    words = "holds 5 robots of wall_avoidance creative, more than 0"
    for options, refused in (
        ({"task": (SF,)}, words),
        ({"seed": 2}, "holds an experiment with seed 1, not 2"),
        ({"kinematics": ("lag=0.08",)}, "with kinematics.lag 0.0, not 0.08"),
    ):
        assert run(out, **options) == 2
        assert refused in capsys.readouterr().err
    monkeypatch.setattr("musebot.protocols.studies.variants.same_physics", lambda path: False)
    assert run(out) == 2
    assert "was lived in another physics than this version's" in capsys.readouterr().err
    assert listing(out) == before


def test_cohorts_are_of_the_size_that_was_told(tmp_path, lived_here, monkeypatch):
    monkeypatch.setattr(ablation, "INGREDIENTS", {"cap": INGREDIENTS["cap"]})
    assert run(tmp_path, task=(WA,), robots=6, cohort_size=3) == 0
    for name in ("steady", "steady-cap"):
        assert load_plan(tmp_path / name / PLAN).experiment.cohort_size == 3
        assert {row.cohort for row in read_run(tmp_path / name)[1].robots} == {0, 1}


def test_one_task_alone_needs_no_run_of_what_cannot_matter_there(tmp_path, lived_here, monkeypatch):
    few = {name: INGREDIENTS[name] for name in ("cap", "raw_reward")}
    monkeypatch.setattr(ablation, "INGREDIENTS", few)
    assert run(tmp_path, task=(WA,)) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"steady", "steady-cap", "ablation.md"}
    assert ablation.report(tmp_path) == (tmp_path / "ablation.md").read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "number of robots must be at least 1, got 0"),
        ({"robots": 251}, "do not split into a few equal cohorts of at most 250"),
        ({"cohort_size": 2}, "must be a multiple of the cohort size, 2, got 5"),
        ({"cohort_size": 0}, "the cohort size must be at least 1, got 0"),
        ({"time_scale": 2.0}, "time scale must lie in (0, 1], got 2"),
        ({"workers": Workers(0)}, "number of processes must be at least 1, got 0"),
        ({"task": ("juggling",)}, "must be one of wall_avoidance, spot_finding, got 'juggling'"),
        ({"task": ()}, "at least one task is needed"),
        ({"body": "mujoco", "kinematics": ("lag=0.08",)}, "kinematic"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_made(options, words, tmp_path, capsys):
    assert run(tmp_path / "out", **options) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_folder_in_the_place_of_the_page_is_refused_before_anything_is_lived(
    tmp_path, capsys
):
    (tmp_path / "ablation.md").mkdir()
    assert run(tmp_path) == 2
    assert "is not empty and holds no study of musebot's" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ablation.md"]


def test_it_explains_itself(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["ablation", "--help"])
    with pytest.raises(SystemExit) as stop:
        tyro.cli(ablation.main)
    assert stop.value.code == 0
    assert "--robots" in capsys.readouterr().out
