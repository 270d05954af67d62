"""Settings of an agent are tuned with the same effort, and the study resumes to the same bytes."""

import dataclasses
import functools
import math
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from musebot.protocols.agents import trust
from musebot.protocols.agents.bounds import HandCoded
from musebot.protocols.agents.factory import factory_of
from musebot.protocols.agents.settings import Setting, settings_of, tunable
from musebot.protocols.cli import parser as cli
from musebot.protocols.compare import jobs
from musebot.protocols.compare.evaluation import EvaluationJob
from musebot.protocols.compare.tune import Trial, Tune, efforts
from musebot.protocols.errors import InputError
from musebot.protocols.storage import write_json


@tunable(goodness=Setting(0.2, 0.0, 1.0, "share of the time in which it acts well"))
def graded(robots, senses, seed, *, goodness):
    """Drives well for a share of the time, and else straight on."""
    return Graded(senses, goodness)


@tunable(goodness=Setting(0.2, 0.0, 1.0, "share of the time in which it acts well", each=True))
def each(robots, senses, seed, *, goodness):
    """The same, where robots may differ."""
    return Graded(senses, np.broadcast_to(goodness, robots))


class Graded(HandCoded):
    def __init__(self, senses, goodness):
        super().__init__(senses)
        self.goodness, self.step = goodness, 0

    def act(self, state, learning):
        self.step += 1
        good = np.broadcast_to((self.step * 0.618) % 1 < self.goodness, len(state))
        return np.where(good[:, None], super().act(state, learning), 0.5)


def plain(robots, senses, seed):
    return HandCoded(senses)


@pytest.fixture(autouse=True)
def module(monkeypatch):
    mine = types.ModuleType("mine")
    mine.graded, mine.each, mine.plain = graded, each, plain
    monkeypatch.setitem(sys.modules, "mine", mine)
    monkeypatch.setattr(trust, "_TRUSTED", set())


TINY = Tune(agent="mine:graded", trials=6, kept=2, robots=4, time_scale=0.05)


def test_the_first_trial_has_the_defaults_and_all_lie_in_their_ranges():
    trust.trust(TINY.agent)
    trials = TINY.drawn()
    assert trials[0].settings == () and len({*trials}) == 6
    for trial in trials[1:]:
        (word,) = trial.settings
        assert 0 <= float(word.removeprefix("goodness=")) <= 1
    assert trials == dataclasses.replace(TINY).drawn()
    assert trials != dataclasses.replace(TINY, seed=5).drawn()


def test_the_first_round_has_half_the_robots_and_another_seed():
    study = Tune(agent="dqn", trials=1, kept=1, robots=5, time_scale=0.1)
    (first,), (second,) = (study._jobs(Path(), n, [Trial(1, ("rate=0.01",))]) for n in (0, 1))
    assert (first.experiment.cohort_size, second.experiment.cohort_size) == (2, 5)
    assert (first.experiment.seed, second.experiment.seed) == (study.seed, study.seed + 1)
    for job in (first, second):
        assert job.condition.task == "spot_finding" and job.experiment.time_scale == 0.1
        assert job.experiment.settings == ("rate=0.01",)
    assert Tune(agent="dqn", robots=1)._robots(False) == 1


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_a_trials_value_is_the_mean_of_its_shares_after_and_during_training(
    task, tmp_path, monkeypatch
):
    study = Tune(agent="sarsa_lambda", task=task, trials=2, kept=1, robots=4)
    shares = {"post": np.array([0.2, 0.4, 0.6, 0.8]), "training": np.array([0.1, 0.1, 0.3, 0.3])}
    monkeypatch.setattr(EvaluationJob, "done", lambda job: job.path.stem.endswith("-0"))
    monkeypatch.setattr(EvaluationJob, "shares", lambda job, part: shares[part])
    ranked = study.ranked(tmp_path)
    means = [values.mean() for _, values, _ in ranked]
    wanted = [0.5, 0.2] if task == "spot_finding" else [0.8, 0.5]
    assert means == pytest.approx(wanted)
    assert [trial.number for trial, _, _ in ranked] == (
        [1, 0] if task == "spot_finding" else [0, 1]
    )


def test_trials_live_in_one_cohort_where_robots_may_differ_in_all_settings():
    trust.trust(TINY.agent)
    study = Tune(agent="sarsa_lambda", trials=3, kept=2, robots=4)
    trials = study.drawn()
    assert study._cohorts(trials) == [trials]
    both = study._round(1, trials[:2])
    assert both.cohort_size == 8
    values = [trial.values(study.settings) for trial in trials[:2]]
    assert values[0]["rate"] == "0.5" and len(values[0]) == len(both.settings) == 7
    for word in both.settings:
        name, _, text = word.partition("=")
        assert text == f"{values[0][name]},{values[1][name]}"
    assert study._round(0, trials[:1]).settings == ()
    assert len(TINY._cohorts(TINY.drawn())) == 6


def test_each_trial_is_given_its_own_robots(tmp_path, commands_in_process):
    """An agent that drives well for the share of time it is given: so are its values."""
    words = "--trials 4 --kept 2 --robots 3 --time-scale 0.01 --processes 1".split()
    for name in ("graded", "each"):
        command = ["study", "tune", str(tmp_path / name), "--agent", f"mine:{name}", *words]
        assert cli.main(command) == 0
    studies = (
        Tune(agent=f"mine:{name}", trials=4, kept=2, robots=3, time_scale=0.01)
        for name in ("graded", "each")
    )
    alone, together = (
        {one[0]: one[1].mean() for one in study.ranked(tmp_path / study.agent[5:])}
        for study in studies
    )
    assert alone.keys() == together.keys()
    assert np.corrcoef([*alone.values()], [together[trial] for trial in alone])[0, 1] > 0.9
    assert len([*(tmp_path / "each" / "trials").iterdir()]) == 1 + 1


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"agent": ""}, "there is no agent ''"),
        ({"agent": "creative"}, "is a proposer of the brain"),
        ({"task": "spot_finding_unit"}, "the task must be one of wall_avoidance, spot_finding"),
        ({"agent": "streamq"}, "did you mean stream_q"),
        ({"agent": "mine:plain"}, "mine:plain has no settings to tune"),
        ({"trials": 0}, "trials must be at least 1"),
        ({"trials": 3, "kept": 4}, "kept must be at most trials, 3, got 4"),
        ({"robots": 0}, "robots must be at least 1"),
        ({"seed": -5}, "the seed must not be negative, got -5"),
        ({"time_scale": 2}, "the time scale must lie in"),
        ({"signals": "salty"}, "the signals must be one of"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        dataclasses.replace(TINY, **changes).experiments()


def held(folder, **changes):
    """Writes a folder that holds a study, with some details changed; returns it."""
    study = Tune(agent="mine:each", trials=4, kept=2, robots=4, time_scale=0.5)
    trust.trust("mine:each")
    content = {
        "study": "tune",
        "experiments": {"trials": dataclasses.asdict(study.experiments()["trials"])},
        "details": dict(study.details()),
    }
    for name, value in changes.items():
        (content if name == "study" else content["details"])[name] = value
    folder.mkdir()
    write_json(folder / "study.json", content)
    return folder


def test_a_study_is_read_from_its_folder(tmp_path):
    study = Tune(agent="mine:each", trials=4, kept=2, robots=4, time_scale=0.5)
    study = dataclasses.replace(study, task="wall_avoidance")
    read = Tune.read(held(tmp_path / "a", task="wall_avoidance"))
    assert read.experiments() == study.experiments() and read.details() == study.details()
    assert dataclasses.replace(read, kinematics=study.kinematics) == study
    assert study.effort == (
        "4 settings in wall_avoidance, then the best 2; robots of a setting: 2, then 4, "
        "durations times 0.5"
    )
    other = dataclasses.replace(study, kinematics=("lag=0.2",), task="spot_finding", time_scale=1)
    assert other.effort == ("4 settings, then the best 2; robots of a setting: 2, then 4, lag=0.2")


def test_a_tuning_that_stands_twice_is_refused(tmp_path):
    with pytest.raises(InputError, match="mine:each with paper signals was tuned twice"):
        efforts([held(tmp_path / "a"), held(tmp_path / "b")])


def test_a_second_round_that_is_too_large_is_refused_before_the_first():
    large = Tune(agent="sarsa_lambda", robots=100_000, kept=16)
    with pytest.raises(InputError, match="the cohort size must be at most 1000000"):
        large.experiments()


@pytest.mark.parametrize(
    "changes",
    [
        {"agent": 5},
        {"agent": "**x** | y"},
        {"kept": "3"},
        {"kept": 2.5},
        {"task": None},
        {"task": "chess"},
        {"trials": 3},
        {"study": "evolve"},
    ],
)
def test_what_is_no_study_that_tunes_is_refused_in_a_sentence(changes, tmp_path):
    with pytest.raises(InputError, match="study.json is no study `tune` of musebot's"):
        Tune.read(held(tmp_path / "a", **changes))


def test_a_folder_runs_no_code_that_only_it_names(tmp_path, monkeypatch):
    folder = held(tmp_path / "a", agent="foreign:agent")
    study = Tune.read(folder)
    with pytest.raises(InputError, match="trust"):
        study.best(folder)
    assert "foreign" not in sys.modules


def test_an_agents_fault_is_one_sentence_with_its_step(
    tmp_path, commands_in_process, capsys, monkeypatch
):
    def act(self, state, learning):
        self.step += 1
        return np.full((len(state), 2), 0.5) if self.step < 30 else 1 / 0

    monkeypatch.setattr(Graded, "act", act)
    words = "--trials 2 --kept 1 --robots 2 --time-scale 0.01 --processes 1".split()
    command = ["study", "tune", str(tmp_path / "out"), "--agent", "mine:graded", *words]
    assert cli.main(command) == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert "mine:graded failed in act (ZeroDivisionError" in last and "at step 29" in last


@pytest.mark.parametrize("killed", [False, True])
def test_a_stopped_trial_continues_from_its_checkpoint_to_the_same_bytes(
    killed, tmp_path, monkeypatch
):
    study = Tune(agent="sarsa_lambda", trials=2, kept=1, robots=2, time_scale=0.1)
    study.experiments()
    monkeypatch.setattr(jobs, "SAVE_EVERY", 0.0 if killed else math.inf)
    whole, cut = (next(study.stages(tmp_path / name))[0] for name in ("whole", "cut"))
    for job in (whole, cut):
        job.path.parent.mkdir(parents=True)
    assert whole.run(lambda: False, lambda *_: None)
    answers = iter((False, False, True))
    if killed:  # in the third minute, after the checkpoint of the second
        with pytest.raises(StopIteration):
            cut.run(functools.partial(next, iter((False, False))), lambda *_: None)
    else:
        assert not cut.run(lambda: next(answers), lambda *_: None)
    assert [path.suffix for path in cut.path.parent.iterdir()] == [".checkpoint"]
    reported = []
    assert cut.run(lambda: False, lambda seconds, _: reported.append(seconds))
    assert reported[0] == (2 if killed else 3) * 60 * cut.experiment.cohort_size
    assert reported[-1] == cut.cost
    assert cut.path.read_bytes() == whole.path.read_bytes()
    assert [*cut.path.parent.iterdir()] == [cut.path]


def test_checkpoints_of_jobs_that_were_killed_after_their_end_are_removed(
    tmp_path, commands_in_process
):
    words = "--trials 2 --kept 1 --robots 2 --time-scale 0.004 --processes 1".split()
    command = ["study", "tune", str(tmp_path), "--agent", "sarsa_lambda", *words]
    assert cli.main(command) == 0
    left = tmp_path / "trials" / "left.checkpoint"
    left.touch()
    assert cli.main(command) == 0
    assert not left.exists()


@pytest.mark.parametrize(
    ("name", "tuned"),
    [
        ("q_learner", "rate discount epsilon epsilon_steps"),
        ("sarsa_lambda", "rate discount trace initial epsilon epsilon_steps tiles"),
        ("stream_q", "discount trace kappa epsilon epsilon_steps"),
        ("stream_ac", "discount trace kappa entropy"),
        ("avg", "discount actor_rate critic_rate entropy"),
        ("amortised_q", "rate proposer_rate discount epsilon epsilon_steps entropy"),
        ("dqn", "rate discount epsilon epsilon_steps"),
    ],
)
def test_every_learner_of_ours_can_be_tuned_but_for_its_size(name, tuned):
    study = Tune(agent=name)
    assert [*study.settings] == tuned.split()
    assert {*settings_of(factory_of(name))} - {*study.settings} <= {"hidden", "cells"}
    assert len(study.drawn()) == 16


def test_the_best_trials_have_a_second_round_and_the_page_names_the_winner(
    tmp_path, commands_in_process, capsys
):
    words = "--trials 4 --kept 2 --robots 3 --time-scale 0.01 --processes 1".split()
    command = ["study", "tune", str(tmp_path / "out"), "--agent", "mine:graded", *words]
    assert cli.main(command) == 0
    study = Tune(agent="mine:graded", trials=4, kept=2, robots=3, time_scale=0.01)
    ranked = study.ranked(tmp_path / "out")
    assert [whole is not None for _, _, whole in ranked] == [True, True, False, False]
    early = [values.mean() for _, values, _ in ranked]
    assert min(early[:2]) >= max(early[2:])
    assert ranked[0][2].mean() >= ranked[1][2].mean()
    page = (tmp_path / "out" / "tune.md").read_text()
    assert f"Best: trial {ranked[0][0].number}, `musebot run OUT --agent mine:graded" in page
    files = sorted((tmp_path / "out" / "trials").iterdir())
    assert len(files) == 4 + 2
    # A missing file is made again with the same bytes; another agent's folder is refused.
    held = files[0].read_bytes()
    files[0].unlink()
    assert cli.main(command) == 0
    assert files[0].read_bytes() == held
    capsys.readouterr()
    assert cli.main([*command[:3], "--agent", "q_learner", *words]) == 2
    assert "holds a study with agent 'mine:graded'" in capsys.readouterr().err
