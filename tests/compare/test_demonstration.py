"""The demonstration: what it films by which rule, and what it says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from musebot.controller import BRAINS
from musebot.protocols.cli import parser as cli
from musebot.protocols.compare import demonstration
from musebot.protocols.compare.demonstration import Demo, chosen, markdown
from musebot.protocols.errors import InputError
from musebot.protocols.examples import ROBOT
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.results import ConditionResults, Robot
from musebot.protocols.lives.run import Run
from musebot.protocols.lives.run_files import read_run

TEST = {"wall_avoidance": 1200, "spot_finding": 3600}  # [s]


def run_of(brain, shares):
    """Returns a run whose robots have the given shares of the tests, (before, after), by task."""
    found = {}
    for task, pairs in shares.items():
        rows = [
            Robot(task, "creative", 1, 0, i, TEST[task] * a, TEST[task] * b, 0.5, "0 < L < 1")
            for i, (a, b) in enumerate(pairs)
        ]
        found[Condition(task, "creative")] = ConditionResults(rows, np.zeros((len(rows), 1)), {})
    return Run(brain, Experiment(cohort_size=3, brain=BRAINS[brain]), found)


@pytest.fixture
def runs():
    paper = {
        "wall_avoidance": [(0.5, 0.1), (0.0, 0.0), (0.1, 0.4)],
        "spot_finding": [(0.0, 0.0), (0.0, 0.6), (0.2, 0.1)],
    }
    steady = {
        "wall_avoidance": [(0.2, 0.0), (0.6, 0.0), (0.0, 0.0)],
        "spot_finding": [(0.0, 0.9), (0.1, 0.95), (0.0, 0.95)],
    }
    return {"paper": run_of("paper", paper), "steady": run_of("steady", steady)}


def test_the_best_robot_of_all_and_the_median_of_the_papers_brain_are_filmed(runs):
    found = [(one.task, one.kind, one.brain, one.robot) for one in chosen(runs)]
    assert found == [
        ("wall_avoidance", "best", "steady", 1),  # of those without contact, it had most before
        ("wall_avoidance", "typical", "paper", 0),
        ("spot_finding", "best", "steady", 2),  # as long in the spot as robot 1, and gained more
        ("spot_finding", "typical", "paper", 2),
    ]


def test_an_even_number_has_the_lower_median_and_an_invalid_robot_is_not_filmed(runs):
    (spot, part) = [*runs["paper"].results.items()][1]
    rows = [dataclasses.replace(part.robots[1], category="invalid"), *part.robots]
    results = {spot: ConditionResults([*rows, *part.robots[:1]], np.zeros((5, 1)), {})}
    (best, typical) = chosen({"paper": dataclasses.replace(runs["paper"], results=results)})
    assert (best.after, typical.after) == (pytest.approx(0.6), 0.0)


def test_the_page_has_the_numbers_and_the_films(runs):
    text = markdown(runs)
    assert "| in contact | 20% | 17% | 27% | 0% |" in text
    assert "| in the spot | 7% | 23% | 3% | 93% |" in text
    for one in chosen(runs):
        assert f"- `films/{one.file}`: " in text and f"{one.kind} robot; {one.caption}" in text
    assert "brain steady, robot 2: in the spot 0% before, 95% after training" in text
    assert "walls went from 20% to 17% with `paper` and from 27% to 0% with `steady`" in text


SHORT = ["--robots", "2", "--time-scale", "0.002"]


def test_the_trained_robot_is_filmed_first_and_a_second_call_makes_nothing_anew(
    tmp_path, monkeypatch, capsys, commands_in_process
):
    out, made = tmp_path / "demo", []

    def film(episode, path, *, seconds, speed):
        made.append((path.name, (out / "paper" / "robots.csv").exists(), episode.driver))
        path.write_bytes(b"film")

    monkeypatch.setattr(demonstration, "film", film)
    assert cli.main(["demo", str(out), *SHORT]) == 0
    printed = capsys.readouterr().out
    assert made[0] == ("trained_robot.mp4", False, "brain steady, trained for four hours")
    assert len(made) == 5 and all(learned for _, learned, _ in made[1:])
    assert all(name in printed for name, _, _ in made)
    assert f"musebot report {out}/steady" in printed
    assert [read_run(out / name).experiment.brain_name for name in ("paper", "steady")] == [
        "paper",
        "steady",
    ]
    assert cli.main(["demo", str(out), *SHORT]) == 0
    assert capsys.readouterr().out == printed and len(made) == 5
    assert cli.main(["demo", str(out), "--robots", "2", "--time-scale", "0.1"]) == 2
    assert "holds a study with time_scale 0.002, not 0.1" in capsys.readouterr().err


def test_without_egl_the_robots_learn_and_it_says_why_nothing_is_filmed(
    tmp_path, monkeypatch, capsys, commands_in_process
):
    def film(*_, **__):
        raise InputError("there is no headless OpenGL (EGL) on this machine")

    monkeypatch.setattr(demonstration, "film", film)
    assert cli.main(["demo", str(tmp_path), *SHORT]) == 0
    captured = capsys.readouterr()
    assert "trained_robot.mp4 is not filmed: there is no headless OpenGL" in captured.err
    assert "Contact with walls went" in captured.out


def test_the_robot_that_musebot_brings_learned_for_the_whole_time_and_finds_the_spot():
    run = read_run(ROBOT)
    assert run.experiment == Experiment(cohort_size=1, brain=BRAINS["steady"])
    condition = Condition("spot_finding", "creative")
    assert run.conditions() == [condition] and len(run.robots(condition)) == 1
    assert run.shares(condition, "pre")[0] < 0.1 and run.shares(condition, "post")[0] > 0.8
    assert sum(path.stat().st_size for path in ROBOT.iterdir()) < 20_000


def test_wrong_numbers_are_refused(tmp_path, capsys):
    for words in (["--robots", "0"], ["--time-scale", "2"], ["--seed", "-1"]):
        assert cli.main(["demo", str(tmp_path / "new"), *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "new").exists()
    assert Demo().robots == 6
