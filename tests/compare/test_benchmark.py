"""All learners have the same schedules in both tracks, with their tuned settings."""

import dataclasses
import re
from pathlib import Path

import pytest

from musebot.models import Kinematics
from musebot.protocols.cli import parser as cli
from musebot.protocols.compare import benchmark
from musebot.protocols.compare.benchmark import LEARNERS, Benchmark, Leaderboard
from musebot.protocols.compare.study import conduct
from musebot.protocols.compare.tune import Tune
from musebot.protocols.errors import InputError
from musebot.protocols.lives.run_files import read_run

TINY = {"robots": 2, "time_scale": 0.0005, "body": "kinematic"}


@pytest.fixture(autouse=True)
def cheap(monkeypatch):
    """Measures what learners cost with fewer robots and steps, and draws less."""
    monkeypatch.setattr(benchmark, "TIMED", (2, 20))
    monkeypatch.setattr("musebot.protocols.compare.boards.DRAWS", 100)


def test_every_learner_has_a_run_in_each_track_and_every_board_its_bounds():
    plans = Benchmark().plans()
    for board in ("paper", "walls"):
        names = {n.removeprefix(f"{board}-") for n in plans if n.startswith(f"{board}-")}
        wanted = {f"{name}-{track}" for name in (*LEARNERS, "steady") for track in ("paper", "raw")}
        assert names == wanted | {"bounds", "paper-paper"}
    for track in ("paper", "raw"):
        brain = plans[f"paper-steady-{track}"].experiment.brain
        assert brain.raw_signals == brain.raw_reward == (track == "raw")
    walls = plans["walls-dqn-raw"].experiment
    assert (walls.signals, walls.protocol, walls.seed) == ("raw", "walls", 32010)
    for plan in Benchmark(body="kinematic").plans().values():
        assert plan.experiment.cohort_size == 60
        assert plan.experiment.kinematics == Kinematics(felt="pushed", wall="slips", lag=0.08)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"robots": 0}, "robots must be from 1"),
        ({"robots": 40}, "robots above 30 must be a multiple of 30, got 40"),
        ({"robots": 90, "body": "kinematic"}, "robots above 60 must be a multiple of 60, got 90"),
        ({"agent": ()}, "at least one learner"),
        ({"agent": ("dqm",)}, "did you mean dqn"),
        ({"agent": ("newborn",)}, "newborn is no learner of the benchmark"),
        ({"agent": ("paper", "ppo"), "signals": ("raw",)}, "a track that it has"),
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
    (tmp_path / "broken_agent.py").write_text("def broken(robots, senses, seed): 1 / 0")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    study = Benchmark(agent=("broken_agent:broken",), **TINY)
    with pytest.raises(InputError, match="the factory broken_agent:broken failed"):
        conduct(study, tmp_path / "out", in_process())
    assert not (tmp_path / "out").exists()


def test_tuned_settings_are_used_and_learners_and_tracks_are_added(
    tmp_path, in_process, capsys, commands_in_process
):
    tuned, out = tmp_path / "tuned", tmp_path / "out"
    tune = Tune(agent="sarsa_lambda", signals="raw", trials=4, kept=2, robots=2, time_scale=0.0005)
    conduct(tune, tuned, in_process())
    best = tune.best(tuned).settings
    study = Benchmark((tuned,), ("sarsa_lambda",), ("raw",), ("walls",), **TINY)
    page = conduct(study, out, in_process()).markdown
    chosen = "".join(f" agent.{word}" for word in best)
    assert f"`--agent sarsa_lambda --set signals=raw{chosen}`" in page
    assert "4 settings, then the best 2; robots of a setting: 1, then 2" in page
    assert "paper signals" not in page and "was not tuned" not in capsys.readouterr().err
    kept = (out / "walls-sarsa_lambda-raw" / "experiment.json").read_bytes()
    more = dataclasses.replace(study, agent=("sarsa_lambda", "steady"), signals=("paper", "raw"))
    page = conduct(more, out, in_process()).markdown
    assert (out / "walls-sarsa_lambda-raw" / "experiment.json").read_bytes() == kept
    assert capsys.readouterr().err.count("sarsa_lambda was not tuned with paper signals") == 1
    titles = re.findall("^### Spot finding, protocol walls, (.*), kinematic", page, re.MULTILINE)
    assert titles == ["paper signals", "raw signals"]
    with pytest.raises(InputError, match="holds a study with seed 32010, not 5"):
        conduct(dataclasses.replace(study, seed=5), out, in_process())
    # A tuning that is not finished is refused, and another agent's is not read.
    next((tuned / "trials").glob("*-1.safetensors")).unlink()
    with pytest.raises(InputError, match="is not finished"):
        conduct(dataclasses.replace(study), out, in_process())
    others = dataclasses.replace(study, agent=("dqn",), board=("walls",)).plans()
    assert others["walls-dqn-raw"].experiment.settings == ()

    # The leaderboard of these runs has the same rows, and measures nothing again.
    runs = tuple(sorted(out.glob("walls-*-raw"))) + (out / "walls-bounds",)
    words = ["--runs", *map(str, runs)]
    assert cli.main(["benchmark", "rank", str(tmp_path / "board"), *words, "--processes", "1"]) == 0
    ranking = tmp_path / "board" / "leaderboard.md"
    first = ranking.read_text()
    assert "own settings" in first if best else "defaults" in first
    costs = re.findall(r"\| sarsa_lambda \| ([0-9.]+) \| ([0-9.]+) \| ([0-9.]+) \|", first)
    assert costs and all(float(number) > 0 for row in costs for number in row)
    assert conduct(Leaderboard(runs), tmp_path / "board", in_process(most=0)).markdown == first
    assert read_run(runs[0]).name in ("walls-sarsa_lambda-raw", "walls-steady-raw")
