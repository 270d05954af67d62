"""What each ingredient of our brain is worth, on lives made by hand and on short ones."""

import sys

import numpy as np
import pytest
import tyro

from musebot.controller import INGREDIENTS
from musebot.protocols import ablation, beside, results
from musebot.protocols.ablation import WHOLE
from musebot.protocols.beside import Side
from musebot.protocols.errors import exit_status
from musebot.protocols.experiment import TASKS, Experiment, named_brain
from musebot.protocols.learn_ability import category, learn_ability
from musebot.protocols.results import Results, Robot
from musebot.protocols.schedules import SCHEDULES

WA, SF = "wall_avoidance", "spot_finding"
STEADY = Experiment(brain=named_brain(WHOLE), body="kinematic")


def side(name, seconds):
    """A run: mean seconds after training by task, of 40 robots; 100 s before it."""
    rows, random = [], np.random.default_rng(len(name))
    for task, mean in seconds.items():
        for robot, post in enumerate(mean + random.normal(0, 20, 40)):
            pair = np.array([100.0]), np.array([post])
            ability = float(learn_ability(*pair, SCHEDULES[task].wanted)[0])
            rows.append(
                Robot(task, "creative", 1, 0, robot, 100.0, post, ability, category(ability))
            )
    return Side(name, STEADY, Results(rows, {}, {}))


def run(out, **options):
    small = {"robots": 5, "time_scale": 0.001, "processes": 1, "body": "kinematic"}
    return exit_status(lambda: ablation.main(out, **(small | options)))


def listing(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_each_run_lacks_one_ingredient_and_nothing_else():
    wanted = ablation.plans(60, TASKS, STEADY)
    whole = wanted.pop(WHOLE)
    assert whole.robots == {(task, "creative"): 60 for task in TASKS}
    assert whole.experiment.cohort_size == 60
    for (name, plan), (ingredient, fields) in zip(wanted.items(), INGREDIENTS.items(), strict=True):
        assert name == f"steady-{ingredient}" and plan.robots == whole.robots
        differ = beside.differing(plan.experiment, whole.experiment)
        assert set(differ) == {f"brain.{field}" for field in fields}


@pytest.mark.parametrize(("task", "worse"), [(SF, 200), (WA, 500)])
def test_less_time_in_the_spot_is_a_loss_and_more_in_contact(task, worse):
    whole, less = side("whole", {task: 350}), side("less", {task: worse})
    found = ablation.losses(whole, less, task)
    assert list(found)[0] == "mean L" and list(found)[1].endswith("post")
    assert all(loss.earns and not loss.harms for loss in found.values())
    share = list(found.values())[1]
    assert share.size == pytest.approx(150 / results.test_seconds(STEADY, task), rel=0.15)
    assert share.left == pytest.approx(worse / results.test_seconds(STEADY, task), rel=0.1)
    assert share.interval[0] < share.size < share.interval[1]
    back = ablation.losses(less, whole, task)
    assert all(loss.harms and not loss.earns for loss in back.values())


def test_robots_of_one_kind_lose_nothing():
    found = ablation.losses(side("whole", {SF: 300}), side("less", {SF: 300}), SF)
    assert not any(loss.earns or loss.harms for loss in found.values())


def test_the_page_says_who_earns_its_place_in_which_task_and_who_does_harm(monkeypatch):
    monkeypatch.setattr(ablation, "INGREDIENTS", dict.fromkeys(("cap", "gap", "held"), ()))
    sides = [
        side("steady", {WA: 100, SF: 300}),
        side("steady-cap", {WA: 200, SF: 500}),
        side("steady-gap", {WA: 100, SF: 300}),
        side("steady-held", {WA: 100, SF: 500}),
    ]
    page = ablation.markdown({side.name: side for side in sides})
    assert page.splitlines()[:3] == [
        "- Earn their place, in one task at least: cap.",
        "- Are not seen to: gap.",
        "- Do harm: held.",
    ]
    walls, spots = page.split("### ")[1:]
    assert "| nothing | 40 |" in walls and "| nothing | 40 |" in spots
    (gap,) = (line for line in spots.splitlines() if line.startswith("| gap "))
    assert "**" not in gap and gap.count("[") == 2
    (held,) = (line for line in spots.splitlines() if line.startswith("| held "))
    assert held.count("**-") == 2
    assert page.rstrip().endswith("- steady: brain steady, body kinematic")


def test_an_ablation_keeps_every_run_and_its_page_and_goes_on_where_it_was(
    tmp_path, lived_here, monkeypatch, capsys
):
    few = {name: INGREDIENTS[name] for name in ("cap", "random")}
    monkeypatch.setattr(ablation, "INGREDIENTS", few)
    out = tmp_path / "out"
    assert run(out, task=(SF,)) == 0
    text = capsys.readouterr().out
    assert text.strip() == (out / "ablation.md").read_text().strip()
    assert ablation.report(out) == (out / "ablation.md").read_text()
    names = {"steady", "steady-cap", "steady-random", "ablation.md"}
    assert {path.name for path in out.iterdir()} == names
    assert "Spot finding" in text and "Wall avoidance" not in text
    before = listing(out)
    for name in ("steady-cap/robots.csv", "ablation.md"):
        (out / name).unlink()
    assert run(out, task=(SF,)) == 0
    assert listing(out) == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "number of robots must be at least 1, got 0"),
        ({"time_scale": 2.0}, "time scale must lie in (0, 1], got 2"),
        ({"processes": 0}, "number of processes must be at least 1, got 0"),
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


def test_it_explains_itself(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["ablation", "--help"])
    with pytest.raises(SystemExit) as stop:
        tyro.cli(ablation.main)
    assert stop.value.code == 0
    assert "--robots" in capsys.readouterr().out
