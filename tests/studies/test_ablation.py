"""What each ingredient of the brain `steady` contributes, on robots with known times."""

import dataclasses
from typing import ClassVar

import numpy as np
import pytest

from musebot.controller import INGREDIENTS
from musebot.protocols.analysis.comparison import verdict
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.conditions import PAPER_TASKS, CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment, differing
from musebot.protocols.experiment.overrides import named_brain
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.protocols.results.learn_ability import category, learn_ability
from musebot.protocols.results.results import ConditionResults, Robot
from musebot.protocols.results.run import Run
from musebot.protocols.results.run_files import read_run
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.studies import ablation
from musebot.protocols.studies.ablation import WHOLE, Ablation
from musebot.protocols.studies.study import conduct

WA, SF = "wall_avoidance", "spot_finding"
STEADY = Experiment(brain=named_brain(WHOLE), body="kinematic")
SMALL = {"robots": 5, "time_scale": 0.001, "body": "kinematic"}


class Few(Ablation):
    """Two ingredients: what is tested is the study, not each of them."""

    ingredients: ClassVar = ("clipped_bootstrap", "raw_reward")


def run(name, seconds, newborn=None):
    """A run: mean seconds after training by task, of 40 robots; 100 s before it."""
    results, random = {}, np.random.default_rng(len(name))
    for task, mean in seconds.items():
        rows = []
        for robot, post in enumerate(mean + random.normal(0, 20, 40)):
            pair = np.array([100.0]), np.array([post])
            ability = float(learn_ability(*pair, SCHEDULES[task].wanted)[0])
            rows.append(
                Robot(task, "creative", 1, 0, robot, 100.0, post, ability, category(ability))
            )
        results[Condition(task, "creative")] = of(rows, newborn)
    return Run(name, STEADY, results)


def of(rows, newborn=None):
    return ConditionResults(rows, np.zeros((len(rows), 1)), {"before": newborn or {}, "after": {}})


def with_rows(run, task, rows, **changes):
    return dataclasses.replace(run, results={Condition(task, "creative"): of(rows)}, **changes)


def rows_of(run, task):
    return run.robots(Condition(task, "creative"))


def compared(*runs):
    return ablation.compared({run.name: run for run in runs}, [*INGREDIENTS])


def verdicts(cells):
    return [verdict(cell) for cell in cells]


def test_each_run_lacks_one_ingredient_and_nothing_else():
    wanted = dict(Ablation(robots=60, cohort_size=20, body="kinematic").plans())
    whole = wanted.pop(WHOLE)
    assert whole.robots == {Condition(task, "creative"): 60 for task in PAPER_TASKS}
    assert whole.experiment == dataclasses.replace(STEADY, cohort_size=20)
    assert list(wanted) == [f"steady-{ingredient}" for ingredient in INGREDIENTS]
    for plan, (ingredient, fields) in zip(wanted.values(), INGREDIENTS.items(), strict=True):
        differ = differing(plan.experiment, whole.experiment)
        assert set(differ) == {f"brain.{field}" for field in fields}
        assert set(plan.robots.values()) == {60}
        assert [condition.task for condition in plan.robots] == [
            task for task in PAPER_TASKS if ablation.matters(ingredient, task)
        ]


@pytest.mark.parametrize("ingredient", INGREDIENTS)
def test_lives_are_the_same_without_an_ingredient_only_where_it_cannot_matter(ingredient, here):
    short = dataclasses.replace(STEADY, cohort_size=5, time_scale=0.002)
    less = dataclasses.replace(short, brain=named_brain(f"steady-{ingredient}"))
    learnt = []
    for experiment in (short, less):
        cohort = Cohort(experiment, CohortKey(Condition(WA, "creative"), 0))
        cohort.advance(10**9)
        after = cohort.lives().after.items()
        learnt.append([nets.ravel() for name, nets in after if name.startswith("evaluation.")])
    same = np.array_equal(*map(np.concatenate, learnt))
    assert same != ablation.matters(ingredient, WA)


@pytest.mark.parametrize(("task", "worse"), [(SF, 200), (WA, 500)])
def test_less_time_in_the_spot_is_worse_and_more_time_in_contact(task, worse):
    runs = [run("steady", {task: 350}), run("steady-clipped_bootstrap", {task: worse})]
    (cells,) = compared(*runs).values()
    assert [cell.name for cell in cells][0] == "mean L" and cells[0].robots == (40, 40)
    assert verdicts(cells) == ["better", "better"]
    runs = [run("steady", {task: worse}), run("steady-clipped_bootstrap", {task: 350})]
    (cells,) = compared(*runs).values()
    assert verdicts(cells) == ["worse", "worse"]


def test_a_few_of_many_perfect_robots_that_touch_a_wall_are_undecided():
    """A bootstrap interval would exclude 0 here, because all other values are equal."""
    perfect = run("steady", {WA: 0})
    rows = [
        dataclasses.replace(rows_of(perfect, WA)[0], robot=robot, t_post_s=0.0)
        for robot in range(60)
    ]
    touched = [
        dataclasses.replace(row, t_post_s=post)
        for row, post in zip(rows, (12, 24, 60), strict=False)
    ] + rows[3:]
    whole = with_rows(perfect, WA, rows)
    less = with_rows(perfect, WA, touched, name="steady-clipped_bootstrap")
    ((_, contact),) = compared(whole, less).values()
    assert contact.interval[0] < 0 < contact.interval[1]
    assert verdict(contact) == "undecided"


def test_equal_robots_are_undecided():
    runs = run("steady", {SF: 300}), run("steady-clipped_bootstrap", {SF: 300})
    (cells,) = compared(*runs).values()
    assert verdicts(cells) == ["undecided"] * 2


def test_only_measured_robots_count_in_the_mean_of_l_and_no_invalid_ones():
    whole, less = run("steady", {SF: 300}), run("steady-clipped_bootstrap", {SF: 300})
    nothing = {"t_pre_s": 0.0, "t_post_s": 0.0, "learn_ability": float("nan")}
    rows = rows_of(less, SF)
    rows[:3] = [dataclasses.replace(row, category="unmeasured", **nothing) for row in rows[:3]]
    rows[3] = dataclasses.replace(rows[3], category="invalid", **nothing)
    ((ability, share),) = compared(whole, less).values()
    assert ability.robots == (40, 36) and share.robots == (40, 39)


def test_equal_newborn_brains_are_pairs_and_others_are_not():
    name, nets = "evaluation.weights0", np.arange(40.0)[:, None]
    whole = run("steady", {SF: 300}, {name: nets})
    for other, paired in ((nets, True), (nets + 1, False), (np.hstack([nets, nets]), False)):
        less = run("steady-clipped_bootstrap", {SF: 300}, {name: other})
        cells = compared(whole, less)[SF, "clipped_bootstrap"]
        assert all(cell.paired == paired for cell in cells)


def test_the_page_says_which_ingredient_helps_or_harms_in_which_task():
    runs = [
        run("steady", {WA: 100, SF: 300}),
        run("steady-clipped_bootstrap", {WA: 200, SF: 500}),
        run("steady-advantage", {WA: 100, SF: 300}),
        run("steady-raw_reward", {SF: 100}),
    ]
    page = ablation.markdown({run.name: run for run in runs})
    assert page.splitlines()[0] == "| ingredient | Wall avoidance | Spot finding |"
    assert "| clipped_bootstrap | helps | harms |" in page
    assert "| advantage | undecided | undecided |" in page
    assert "| raw_reward | - | helps |" in page
    walls, spots = page.split("### ")[1:]
    assert walls.count("| raw_reward |") == 0 and spots.count("| raw_reward |") == 2
    assert walls.count("| 40 and 40 |") == 4 and spots.count("| 40 and 40 |") == 6
    assert "corrected over 10 cells" in page
    assert page.rstrip().endswith("- steady: brain steady, body kinematic")


def test_an_ingredient_can_help_in_one_number_and_harm_in_the_other():
    whole = run("steady", {SF: 300})
    mixed = [
        dataclasses.replace(row, t_post_s=100.0, learn_ability=1.0) for row in rows_of(whole, SF)
    ]
    less = with_rows(whole, SF, mixed, name="steady-clipped_bootstrap")
    page = ablation.markdown({run.name: run for run in (whole, less)})
    assert "| clipped_bootstrap | helps and harms |" in page


def test_an_ablation_keeps_every_run_and_its_page_and_continues(tmp_path, here, listing):
    text = conduct(Few(**SMALL), tmp_path, here).markdown
    names = {"steady", "steady-clipped_bootstrap", "steady-raw_reward"}
    assert {path.name for path in tmp_path.iterdir()} == {*names, "ablation.md", "study.json"}
    assert "all durations times 0.001" in text
    before = listing(tmp_path)
    for name in ("steady-clipped_bootstrap/robots.csv", "ablation.md"):
        (tmp_path / name).unlink()
    conduct(Few(**SMALL), tmp_path, here)
    assert listing(tmp_path) == before
    for options, refused in (
        ({"task": (WA,)}, "holds a study of steady, .*, steady-raw_reward, not of "),
        ({"task": (SF,)}, "holds 5 robots of wall_avoidance/creative, more than 0"),
        ({"seed": 2}, "with seed 1, not 2"),
        ({"kinematics": ("lag=0.08",)}, "with kinematics.lag 0.0, not 0.08"),
    ):
        with pytest.raises(InputError, match=refused):
            conduct(Few(**(SMALL | options)), tmp_path, here)
    assert listing(tmp_path) == before


def test_cohorts_have_the_given_size(tmp_path, here):
    conduct(Few(**(SMALL | {"task": (WA,), "robots": 6, "cohort_size": 3})), tmp_path, here)
    for name in ("steady", "steady-clipped_bootstrap"):
        found = read_run(tmp_path / name)
        assert found.experiment.cohort_size == 3
        assert {row.cohort for row in rows_of(found, WA)} == {0, 1}


def test_one_task_alone_needs_no_run_of_an_ingredient_that_cannot_matter_there():
    assert list(Few(task=(WA,)).plans()) == ["steady", "steady-clipped_bootstrap"]
    assert list(Few(task=(SF, WA)).plans()["steady"].robots) == [
        Condition(task, "creative") for task in PAPER_TASKS
    ]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "robots must be at least 1, got 0"),
        ({"robots": 251}, "do not split into a few equal cohorts of at most 250"),
        ({"cohort_size": 2}, "must be a multiple of the cohort size, 2, got 5"),
        ({"cohort_size": 0}, "the cohort size must be at least 1, got 0"),
        ({"time_scale": 2.0}, r"time scale must lie in \(0, 1\], got 2"),
        ({"task": ("juggling",)}, "must be one of wall_avoidance, spot_finding, got 'juggling'"),
        ({"task": ()}, "at least one task is needed"),
        ({"body": "mujoco", "kinematics": ("lag=0.08",)}, "kinematic"),
    ],
)
def test_an_invalid_option_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        Ablation(**(SMALL | options)).experiments()
