"""Learners in lives that change, each with its tuned settings and its newborns."""

import dataclasses
import re
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from musebot.controller import BRAINS
from musebot.controller.parameters import PROPOSERS
from musebot.models import Kinematics
from musebot.protocols.compare import bounds, lives_page
from musebot.protocols.compare.benchmark import HEADLINE, LEARNERS, Benchmark, newborn_lives
from musebot.protocols.compare.study import conduct
from musebot.protocols.compare.tune import Tune
from musebot.protocols.errors import InputError
from musebot.protocols.runs.manifest import read_manifest
from musebot.tasks.lives import BODY, CHANGING, DRIFT

RESULTS = Path(__file__).parents[2] / "docs" / "results"
TINY = {"robots": 2, "time_scale": 0.0005, "life": ("body",)}


@pytest.fixture(autouse=True)
def cheap(monkeypatch):
    """Measures bounds with few robots."""
    monkeypatch.setattr(bounds, "ROBOTS", 2)
    monkeypatch.setattr(bounds, "UNTRAINED", 2)


def test_every_learner_has_a_run_in_each_life_with_newborns_of_each_world():
    plans = Benchmark().plans()
    names = (*LEARNERS, "steady", "paper")
    assert plans.keys() == {f"{life}-{name}" for life in HEADLINE for name in names}
    lives = [condition.life for condition in plans["body-dqn"].robots]
    assert lives == ["body", "body@2", "body@3"] and newborn_lives(DRIFT) == []
    assert {c.proposer for c in plans["body-paper"].robots} == {"fixed", "random", "creative"}
    for track in ("paper", "raw"):
        plans = Benchmark(signals=track).plans()
        assert plans["body-dqn"].experiment.signals == track
        brain = plans["tasks-steady"].experiment.brain
        assert brain.raw_signals == brain.raw_reward == (track == "raw")
        brains = Benchmark(signals=track, agent=tuple(BRAINS), life=("tasks",)).plans()
        for name, own in BRAINS.items():
            found = brains[f"tasks-{name}"].experiment.brain
            paper = {"raw_signals": False, "raw_reward": False} if track == "paper" else {}
            assert found == dataclasses.replace(own, **paper), name
    for plan in plans.values():
        assert plan.experiment.cohort_size == 60 and plan.experiment.seed == 61010
        assert plan.experiment.kinematics == Kinematics(
            felt="pushed", wall="slips", lag=0.08, pieces=1
        )
    assert Benchmark(body="mujoco", robots=30).experiment().kinematics == Kinematics()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"robots": 0}, "robots must be a whole number from 1"),
        ({"robots": 90}, "robots above 60 must be a multiple of 60, got 90"),
        ({"robots": 40, "body": "mujoco"}, "robots above 30 must be a multiple of 30, got 40"),
        ({"agent": ()}, "at least one learner"),
        ({"agent": ("dqm",)}, "did you mean dqn"),
        (
            {"set": ("dqm.rate=0.1",), "agent": ("dqn",)},
            "there is no learner with settings 'dqm'; did you",
        ),
        (
            {"set": ("dqn.rate=0.1",), "agent": ("paper",)},
            "there is no learner with settings 'dqn'; there are none",
        ),
        ({"set": ("dqn.rate=0.1,0.2",), "agent": ("dqn",)}, "a setting must be NAME=VALUE"),
        ({"set": ("dqn.rate=0.1", "dqn.rate=0.2"), "agent": ("dqn",)}, "rate is given twice"),
        ({"set": ("dqn.rat=0.1",), "agent": ("dqn",)}, "dqn has no setting rat"),
        ({"agent": ("newborn",)}, "newborn is no learner of the benchmark"),
        ({"life": ("boddy",)}, "no built-in changing life 'boddy'; did you mean body"),
        ({"life": ("spot_finding",)}, "no built-in changing life 'spot_finding'"),
        ({"tuned": (Path("nowhere"),), "agent": ("dqn",)}, "is no study `tune` of musebot's"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(changes, sentence, tmp_path, in_process):
    with pytest.raises(InputError, match=sentence):
        conduct(dataclasses.replace(Benchmark(), **changes), tmp_path / "out", in_process())
    assert not (tmp_path / "out").exists()


def test_an_agent_named_twice_has_one_run_and_one_that_fails_writes_nothing(
    tmp_path, in_process, monkeypatch
):
    both = ("dqn", "musebot.protocols.agents.learners.dqn:dqn")
    assert Benchmark(agent=both).plans().keys() == Benchmark(agent=both[:1]).plans().keys()
    twice = Benchmark(agent=("constant",), life=("senses", "senses"))
    assert list(twice.plans()) == ["senses-constant"]
    (tmp_path / "broken_agent.py").write_text("def broken(robots, senses, seed): 1 / 0")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    study = Benchmark(agent=("broken_agent:broken",), **TINY)
    with pytest.raises(InputError, match="the factory broken_agent:broken failed"):
        conduct(study, tmp_path / "out", in_process())
    assert not (tmp_path / "out").exists()


def test_tuned_settings_are_used_and_learners_and_lives_are_added(
    tmp_path, in_process, monkeypatch
):
    tuned, out = tmp_path / "tuned", tmp_path / "out"
    tune = Tune(agent="sarsa_lambda", trials=4, kept=2, robots=2, time_scale=0.001)
    conduct(tune, tuned, in_process())
    study = Benchmark(tuned=(tuned,), agent=("sarsa_lambda",), **TINY)
    own = study.plans()["body-sarsa_lambda"].experiment.settings
    assert own == tune.best(tuned).settings
    words = ("sarsa_lambda.rate=0.05", "sarsa_lambda.trace=0.5")
    chosen = dataclasses.replace(study, set=words).plans()["body-sarsa_lambda"].experiment
    names = [word.partition("=")[0] for word in chosen.settings]
    assert {*words} <= {f"sarsa_lambda.{word}" for word in chosen.settings}
    assert len({*names}) == len(names)
    first = conduct(study, out, in_process()).markdown
    assert conduct(study, out, in_process(most=0)).markdown == first
    kept = {path: path.read_bytes() for path in out.glob("b*/*") if path.is_file()}
    brains = "paper", "steady", "steady-raw_signals"
    more = dataclasses.replace(study, agent=("sarsa_lambda", *brains), life=("body", "senses"))
    monkeypatch.setattr(lives_page, "same_mean", tested := Mock(wraps=lives_page.same_mean))
    done, costs = conduct(more, out, executor := in_process()), [j.cost for j in executor.jobs]
    assert costs == sorted(costs, reverse=True)
    page = done.markdown
    assert all(path.read_bytes() == content for path, content in kept.items())
    assert "A rehearsal, all durations times 0.0005: its numbers mean nothing." in page
    rows = {line.split(" | ")[0].removeprefix("| ") for line in page.splitlines() if "|" in line}
    assert {"sarsa_lambda", "paper, fixed", "paper, creative", "untrained", "random"} <= rows
    assert re.findall("^## (.*)$", page, re.MULTILINE) == [
        "Scores", "Changing body", "Changing senses"
    ]  # fmt: skip
    learners = ["sarsa_lambda", *(f"paper, {name}" for name in PROPOSERS)]
    learners += [f"{brain}, creative" for brain in brains[1:]]
    assert tested.call_count == 2 * (len(learners) - 1 + len(learners))  # scores, savings
    for learner in learners:  # among the scores and in both tables of each life
        assert len(re.findall(rf"^\| {learner} \|", page, re.MULTILINE)) == 5, learner
    assert page.count("| minutes |") == 2  # newborns lived in all worlds
    assert "nan" not in page  # lives so short have no scores
    assert len(re.findall(r"The best of these policies reaches 0\.\d{3} of the time", page)) == 2
    for figure in done.figures.values():
        assert sorted(axis.get_title("left") for axis in figure.axes) == sorted(learners)
        for axis in figure.axes:
            *own, mean = (line.get_ydata() for line in axis.lines[: TINY["robots"] + 1])
            np.testing.assert_allclose(np.mean(own, axis=0), mean)
            assert len(axis.lines) == TINY["robots"] + 1 + 11  # changes of the world
    with pytest.raises(InputError, match="holds a study with seed 61010, not 5"):
        conduct(dataclasses.replace(study, seed=5), out, in_process())


def test_learners_with_too_few_robots_for_a_test_and_those_without_a_score_are_not_bold():
    rows = [
        lives_page.Row(name, np.array([]), Mock(online=np.full(2, score)), [])
        for name, score in (("worse", 0.1), ("none", np.nan), ("best", 0.9))
    ]
    _, *table = lives_page._summary([lives_page.Column(BODY, Mock(), rows)])
    assert table == [["best", "**0.900**"], ["worse", "0.100"], ["none", "-"]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "lives", "options"),
    [
        ("lives", ("tasks", "drift"), {"backend": "numba"}),
        ("lives-body", ("body",), {"backend": "numba"}),
        ("lives-senses", ("senses",), {"backend": "numba"}),
        ("lives-mujoco", ("body",), {"body": "mujoco", "robots": 30}),
    ],
)
def test_kept_pages_are_made_again_from_runs_that_lack_networks(
    monkeypatch, folder, lives, options
):
    monkeypatch.undo()  # the kept bounds are not cheap
    kept = {
        path.name.partition("-")[2]: read_manifest(path).experiment
        for path in (RESULTS / folder).glob(f"{lives[0]}-*")
        if "newborns" not in path.name  # a second group, which the page does not have
    }
    study = Benchmark(
        life=lives,
        agent=tuple(kept),
        set=tuple(f"{name}.{word}" for name, own in kept.items() for word in own.settings),
        **options,
    )
    assert study.page(RESULTS / folder).markdown == (RESULTS / folder / "benchmark.md").read_text()


def test_informed_policies_are_good_in_their_own_world_only(monkeypatch):
    monkeypatch.setattr(bounds, "ROBOTS", 20)
    monkeypatch.setattr(bounds, "UNTRAINED", 20)
    monkeypatch.setattr(bounds, "MINUTES", 1)
    experiment = Benchmark().experiment()
    for life in CHANGING:
        monkeypatch.setattr(bounds, "MOST", 2)  # of the drift the first and the opposite one
        shares = bounds.measure(experiment, life.name, lambda done: None)["shares"]
        found = bounds.Matrix(bounds.tried_worlds(life), shares)
        assert (found.informed > 0.5).all(), life.name
        assert found.best_fixed < 0.55 and (shares[-2:] < 0.35).all(), life.name


def test_a_world_that_was_not_tried_has_the_bounds_of_one_before():
    matrix = bounds.Matrix((0, 2), np.array([[0.9, 0.1], [0.2, 0.8], [0.1, 0.15], [0.0, 0.0]]))
    drift = dataclasses.replace(DRIFT, phases=DRIFT.phases[:4])
    found = matrix.bounds(drift)
    assert found.low.tolist() == [0.1, 0.1, 0.15, 0.15]
    assert found.high.tolist() == [0.9, 0.9, 0.8, 0.8]
    assert matrix.best_fixed == pytest.approx(0.5) and len(bounds.tried_worlds(BODY)) == 3
