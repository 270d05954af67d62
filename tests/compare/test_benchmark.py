"""All learners have the same schedules in both tracks, with their tuned settings."""

import dataclasses
import re
from pathlib import Path

import pytest

from musebot.models import Kinematics
from musebot.protocols.cli import parser as cli
from musebot.protocols.compare.benchmark import LEARNERS, Benchmark
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import Condition

TINY = "--robots 3 --time-scale 0.001 --body kinematic --processes 1".split()


def test_every_learner_has_a_run_in_each_track_and_every_board_its_bounds():
    plans = Benchmark().plans()
    for board in ("paper", "walls"):
        names = {n.removeprefix(f"{board}-") for n in plans if n.startswith(f"{board}-")}
        wanted = {f"{name}-{track}" for name in (*LEARNERS, "steady") for track in ("paper", "raw")}
        assert names == wanted | {"bounds", "paper-paper"}
    spot = Condition("spot_finding", "creative")
    assert plans["paper-steady-raw"].robots == {
        Condition("wall_avoidance", "creative"): 60,
        spot: 60,
    }
    # Where nothing saturates, both tracks are the same life.
    assert plans["paper-steady-paper"].robots == {spot: 60}
    brain = plans["paper-steady-paper"].experiment.brain
    assert not brain.raw_signals and not brain.raw_reward
    assert plans["walls-dqn-raw"].experiment.signals == "raw"
    assert plans["walls-dqn-raw"].experiment.protocol == "walls"
    assert {plan.experiment.seed for plan in plans.values()} == {32010}
    assert {plan.experiment.kinematics for plan in plans.values()} == {Kinematics()}
    for plan in Benchmark(body="kinematic").plans().values():
        assert plan.experiment.cohort_size == 60
        assert plan.experiment.kinematics == Kinematics(felt="pushed", wall="turns", lag=0.08)
    # The second cohort is added to the first.
    assert Benchmark(robots=30).experiments() == Benchmark(robots=60).experiments()


def test_steady_stands_in_wall_avoidance_in_the_papers_track_alone():
    """Nothing saturates there; the run is that of both tracks, to which spot finding can come."""
    plans = Benchmark(agent=("steady",), signals=("paper",)).plans()
    assert {*plans} == {
        "paper-bounds", "paper-steady-paper", "paper-steady-raw", "walls-bounds",
        "walls-steady-paper",
    }  # fmt: skip
    assert [c.task for c in plans["paper-steady-raw"].robots] == ["wall_avoidance"]
    assert [c.task for c in plans["paper-steady-paper"].robots] == ["spot_finding"]
    both = Benchmark(agent=("steady",)).plans()
    assert both["paper-steady-raw"].experiment == plans["paper-steady-raw"].experiment


def test_the_held_out_boards_have_seeds_of_their_own():
    chosen = Benchmark(agent=("dqn",), board=("continual", "larger"), signals=("raw",))
    found = {name: plan.experiment for name, plan in chosen.plans().items()}
    assert {*found} == {
        "continual-bounds", "continual-dqn-raw", "larger-bounds", "larger-dqn-raw",
    }  # fmt: skip
    assert found["continual-dqn-raw"].seed == 32011
    assert (found["larger-dqn-raw"].seed, found["larger-dqn-raw"].arena_scale) == (32012, 1.3333)
    assert {c.task for c in chosen.plans()["larger-bounds"].robots} == {"spot_finding"}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"robots": 0}, "robots must be at least 1"),
        ({"robots": 40}, "robots above 30 must be a multiple of 30, got 40"),
        ({"robots": 90, "body": "kinematic"}, "robots above 60 must be a multiple of 60, got 90"),
        ({"body": "paper"}, "the body must be one of mujoco, kinematic, got 'paper'"),
        ({"agent": ()}, "at least one agent"),
        ({"agent": ("dqm",)}, "did you mean dqn"),
        ({"agent": ("newborn",)}, "newborn is no learner of the benchmark"),
        ({"agent": ("creative",)}, "creative is no learner of the benchmark"),
        ({"agent": ("paper", "ppo"), "signals": ("raw",)}, "paper, ppo has no raw signals"),
        ({"tuned": (Path("nowhere"),), "agent": ("steady",)}, "is no study `tune` of musebot's"),
        ({"board": ("chess",)}, "the board must be one of paper, walls, continual, larger"),
        ({"signals": ("salty",)}, "the signals must be one of paper, raw"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        dataclasses.replace(Benchmark(), **changes).experiments()


def test_an_agent_named_twice_has_one_run():
    both = ("dqn", "musebot.protocols.agents.learners.dqn:dqn")
    assert Benchmark(agent=both).plans().keys() == Benchmark(agent=both[:1]).plans().keys()


def test_an_agent_that_fails_is_refused_before_anything_is_written(
    tmp_path, commands_in_process, capsys, monkeypatch
):
    (tmp_path / "broken_agent.py").write_text("def broken(robots, senses, seed): 1 / 0")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    command = ["study", "benchmark", "out", "--agent", "broken_agent:broken", *TINY]
    assert cli.main(command) == 2
    assert "the factory broken_agent:broken" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_every_board_is_simulated_and_its_command_can_be_given_again(
    tmp_path, commands_in_process, cheap_costs
):
    out = tmp_path / "out"
    words = ["--agent", "q_learner", "steady", "--board", "walls", "continual", "larger", *TINY]
    assert cli.main(["study", "benchmark", str(out), *words]) == 0
    page = (out / "benchmark.md").read_text()
    for title in (
        "protocol walls, paper signals", "protocol continual, raw signals",
        "protocol paper, arena 1.3333 times as large, raw signals, kinematic simulator",
    ):  # fmt: skip
        assert title in page
    commands = re.findall(r"`(--(?:agent|brain) [^`]*)`", page)
    assert len(commands) == 3 * 2 * 4
    (saturated,) = (c for c in commands if "raw_reward=false" in c and "walls" in c)
    again = tmp_path / "again"
    assert cli.main(["run", str(again), *saturated.split(), "--processes", "1"]) == 0
    kept = (out / "walls-steady-paper" / "robots.csv").read_bytes()
    assert (again / "robots.csv").read_bytes() == kept


def test_a_run_that_stands_in_both_tracks_makes_no_board_of_a_track_that_is_not_wanted(
    tmp_path, commands_in_process, cheap_costs
):
    command = ["study", "benchmark", str(tmp_path), "--agent", "steady", "--board", "paper", *TINY]
    assert cli.main([*command, "--signals", "raw"]) == 0
    page = (tmp_path / "benchmark.md").read_text()
    assert "Wall avoidance, protocol paper, raw signals" in page
    assert "paper signals" not in page.lower()


def test_tuned_settings_are_used_and_the_page_ranks_both_tracks(
    tmp_path, commands_in_process, cheap_costs, capsys
):
    tuned, out = tmp_path / "tuned", tmp_path / "out"
    words = "--trials 4 --kept 2 --robots 2 --time-scale 0.004 --processes 1".split()
    tune = ["study", "tune", str(tuned), "--agent", "sarsa_lambda", "--signals", "raw", *words]
    assert cli.main(tune) == 0
    command = ["study", "benchmark", str(out), "--tuned", str(tuned), *TINY]
    first = [*command, "--agent", "sarsa_lambda", "--board", "paper", "--signals", "raw"]
    assert cli.main(first) == 0
    assert "was not tuned" not in capsys.readouterr().err
    page = (out / "benchmark.md").read_text()
    best = (tuned / "tune.md").read_text().partition("--agent-set ")[2].partition(" --signals")[0]
    assert f"--agent sarsa_lambda --signals raw{' --agent-set ' * bool(best)}{best}" in page
    assert "4 settings, then the best 2; robots of a setting: 1, then 2" in page
    assert "paper signals" not in page.lower()
    # More learners and tracks are added; what is there is kept, without its brains.
    (brains,) = (out / "paper-sarsa_lambda-raw").glob("brains.safetensors")
    brains.unlink()
    assert (
        cli.main([*command, "--agent", "sarsa_lambda", "paper", "steady", "--board", "paper"]) == 0
    )
    printed = capsys.readouterr().err
    assert "sarsa_lambda was not tuned with paper signals: its defaults" in printed
    assert printed.count("was not tuned") == 1
    page = (out / "benchmark.md").read_text()
    assert not brains.exists()
    for title in ("Wall avoidance, protocol paper, ", "Spot finding, protocol paper, "):
        assert f"### {title}paper signals" in page and f"### {title}raw signals" in page
    rows = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| ")]
    assert rows.count("paper, creative") == 2 * 3 + 1  # and the summary of the track that ranks it
    assert rows.count("sarsa_lambda") == 2 * 4 + 2  # and a summary of each track
    capsys.readouterr()
    assert cli.main([*first[:-4], "--board", "walls"]) == 2
    assert "holds a study of" in capsys.readouterr().err


def test_an_unfinished_tuning_is_refused_and_another_agents_is_not_read(
    tmp_path, commands_in_process, capsys
):
    tuned, out = tmp_path / "tuned", tmp_path / "out"
    words = "--trials 2 --kept 1 --robots 2 --time-scale 0.004 --processes 1".split()
    assert cli.main(["study", "tune", str(tuned), "--agent", "dqn", *words]) == 0
    next((tuned / "trials").glob("*-1.safetensors")).unlink()
    command = ["study", "benchmark", str(out), "--tuned", str(tuned), *TINY]
    assert cli.main([*command, "--agent", "dqn"]) == 2
    assert "is not finished: `musebot study tune` continues it" in capsys.readouterr().err
    assert not out.exists()
    others = Benchmark(tuned=(tuned,), agent=("sarsa_lambda",), board=("walls",)).plans()
    assert others["walls-sarsa_lambda-raw"].experiment.settings == ()
