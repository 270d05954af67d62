"""Learners are ranked between a newborn and a hand-coded robot."""

import dataclasses
import itertools
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from musebot.controller import BRAINS
from musebot.models import Kinematics
from musebot.protocols.cli import parser as cli
from musebot.protocols.compare.boards import (
    Board,
    Entry,
    boards,
    pair_tests,
    ranked,
    scores_of,
)
from musebot.protocols.compare.costs import cost_jobs
from musebot.protocols.compare.leaderboard import Leaderboard
from musebot.protocols.compare.leaderboard_page import draw, markdown, standings
from musebot.protocols.compare.study import conduct
from musebot.protocols.compare.summary import placed, summary
from musebot.protocols.compare.tune import Effort, efforts
from musebot.protocols.errors import InputError
from musebot.protocols.lives import local
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run_files import read_runs


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """Fewer draws than for a page, which take less time."""
    monkeypatch.setattr("musebot.protocols.compare.boards.DRAWS", 5000)


def entry(name, after, training, robots=20, spread=0.0):
    wobble = spread * np.linspace(-1, 1, robots)
    after, training = after + wobble, training + wobble
    curve = np.linspace(0, 2 * training.mean(), 120)
    return Entry(
        name, f"--agent {name}", Experiment(), Condition("spot_finding", f"musebot:{name}"), after,
        training, curve, np.full(robots, np.nan),
    )  # fmt: skip


LOW, HIGH = entry("newborn", 0.1, 0.1, spread=0.02), entry("hand_coded", 0.9, 0.9)
BOARD = [
    LOW,
    entry("slow", 0.5, 0.2, spread=0.05),
    entry("good", 0.8, 0.7, spread=0.05),
    HIGH,
    entry("alike", 0.79, 0.7, spread=0.05),
]


def test_a_score_is_0_for_the_mean_newborn_and_1_for_the_mean_hand_coded_robot():
    assert scores_of(LOW, LOW, HIGH).mean() == pytest.approx(0)
    assert scores_of(HIGH, LOW, HIGH) == pytest.approx(1)
    half = entry("half", 0.5, 0.9)
    assert scores_of(half, LOW, HIGH) == pytest.approx((0.5 + 1) / 2)
    assert np.isnan(scores_of(half, LOW, LOW)).all()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.floats(-1, 2), min_size=1, max_size=60))
def test_an_interquartile_mean_is_that_of_the_middle_half(values):
    values = np.array(values)
    learner = dataclasses.replace(entry("learner", 0.0, 0.0), after=values, training=values)
    bounds = entry("newborn", 0.0, 0.0), entry("hand_coded", 1.0, 1.0)
    (one,) = [one for one in ranked([learner, *bounds]) if one.entry is learner]
    low, high = one.interval
    cut = len(values) // 4
    assert one.score == pytest.approx(np.sort(values)[cut : len(values) - cut].mean())
    assert values.min() - 1e-9 <= low <= high <= values.max() + 1e-9


def test_the_interval_of_a_score_has_the_chance_in_the_bounds_too():
    learner = entry("learner", 0.5, 0.5)  # equal robots: all of the chance is in the bounds
    wide, narrow = (
        ranked([learner, entry("newborn", 0.1, 0.1, spread=spread), HIGH])[1].interval
        for spread in (0.2, 0.0)
    )
    assert narrow == pytest.approx((0.5, 0.5))
    # Standard error of the mean of 20 newborns, spread evenly over 0.4; 0.8 is the scores' unit.
    error = 0.4 / np.sqrt(12) * np.sqrt(21 / 19) / np.sqrt(20)
    assert wide[1] - wide[0] == pytest.approx(2 * 1.96 * error * 0.5 / 0.8, rel=0.15)


def test_learners_are_ranked_and_tested_against_the_first():
    ranking = ranked(BOARD)
    names = [one.entry.name for one in ranking]
    assert names == ["hand_coded", "good", "alike", "slow", "newborn"]
    tests = pair_tests(ranking)
    np.testing.assert_equal(tests, tests.T)
    p = dict(zip(names, tests[names.index("good")], strict=True))
    assert np.isnan([p["hand_coded"], p["newborn"], p["good"]]).all()
    assert p["alike"] > 0.05 > p["slow"]


def test_the_creative_robots_and_dqn_are_compared_with_all_others():
    named = {"good": "dqn", "slow": "steady, creative"}
    entries = [dataclasses.replace(one, name=named.get(one.name, one.name)) for one in BOARD]
    entries[1] = dataclasses.replace(entries[1], condition=Condition("spot_finding", "creative"))
    ranking = ranked(entries)
    assert standings(ranking, pair_tests(ranking)) == [
        "- dqn: significantly above it: none, below it: steady, creative.",
        "- steady, creative: significantly above it: dqn; alike, below it: none.",
    ]


def test_what_was_trained_beforehand_has_a_row_but_is_not_compared():
    entries = [*BOARD, entry("ppo", 0.95, 0.95)]
    ranking = ranked(entries)
    assert ranking[0].entry.title == "*ppo*"
    tests = pair_tests(ranking)
    assert np.isnan(tests[0]).all()
    without = pair_tests(ranked(BOARD))
    np.testing.assert_array_equal(tests[1:, 1:], without)
    board = Board("raw", "paper", "spot_finding")
    (row,) = [row for row in cells(summary_of({board: entries})) if "ppo" in row[0]]
    assert row[0] == "*ppo*" and "**" not in row[1]


def test_the_page_has_a_row_a_learner_and_the_figure_a_named_line():
    board = Board("raw", "paper", "spot_finding")
    ranking, p = placed(board, BOARD)
    text = "\n".join(markdown(board, ranking, p, {}, {}))
    assert text.startswith("### Spot finding, protocol paper, raw signals, MuJoCo\n")
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert [row.split("|")[1].strip() for row in rows[2:7]] == [
        "*hand_coded*", "good", "alike", "slow", "*newborn*",
    ]  # fmt: skip
    assert "| 100% |" in rows[5]
    assert rows[12].startswith("| slow | - | - | - | defaults | `musebot` | `--agent slow` |")
    (axis,) = draw(ranked(BOARD)).axes
    assert sorted(text.get_text() for text in axis.texts) == sorted(one.name for one in BOARD)


def test_wall_avoidance_reports_robots_that_touch_a_wall_and_ranks_none():
    def walls(name, touching):
        after = np.where(np.arange(20) < touching, 0.9, 1.0)
        return dataclasses.replace(entry(name, 1.0, 1.0), after=after)

    board = Board("paper", "paper", "wall_avoidance")
    entries = [walls("newborn", 20), walls("good", 1), walls("perfect", 0), walls("hand_coded", 0)]
    ranking, p = placed(board, entries)
    text = "\n".join(markdown(board, ranking, p, {}, {}))
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| ")][2:6]
    assert [row[1].strip() for row in rows] == ["*hand_coded*", "perfect", "good", "*newborn*"]
    assert [row[3].split()[0] for row in rows] == ["0", "0", "1", "20"]
    assert "p against" not in text and "score" not in text


def cells(lines):
    """Returns the rows of Markdown tables, without their rules."""
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if "|" in line]
    return [row for row in rows if not row[0].startswith("---")]


def summary_of(found):
    return summary({board: placed(board, entries) for board, entries in found.items()})


def test_the_summary_has_a_row_a_learner_and_marks_those_that_may_be_the_first():
    touching = dataclasses.replace(BOARD[2], after=np.repeat([1.0, 0.9], [18, 2]))
    lines = summary_of(
        {
            Board("raw", "paper", "wall_avoidance"): [touching, LOW, HIGH],
            Board("raw", "paper", "spot_finding"): BOARD,
            Board("raw", "continual", "spot_finding"): [
                LOW, HIGH, entry("alike", 0.9, 0.8, spread=0.05), entry("slow", 0.2, 0.2),
                entry("other", 0.3, 0.3), entry("better", 0.5, 0.5),
            ],
            Board("raw", "paper", "spot_finding", body="kinematic"): BOARD,
            Board("paper", "paper", "spot_finding"): [LOW, HIGH],
        }
    )  # fmt: skip
    titles = [line for line in lines if line.startswith("## ")]
    assert titles == [
        "## Raw signals, MuJoCo",
        "## Raw signals, kinematic simulator",
        "## Paper signals, MuJoCo",
    ]
    head, *rows = cells(lines)[:8]
    assert head == ["learner", "spot finding", "spot finding, protocol continual", "touch a wall"]
    order = ["*hand_coded*", "good", "alike", "slow", "*newborn*", "better", "other"]
    assert [row[0] for row in rows] == order
    by_name = {row[0]: row[1:] for row in rows}
    assert by_name["good"][0].startswith("**0.8") and by_name["good"][1:] == ["-", "2 of 20"]
    assert by_name["alike"][0].startswith("**0.8") and by_name["alike"][1].startswith("**0.9")
    assert by_name["slow"][0].startswith("0.") and by_name["slow"][1].startswith("0.")
    assert by_name["*hand_coded*"][0].startswith("1.000 [")


def test_a_learner_that_a_track_does_not_rank_has_no_row_in_its_summary():
    """In wall avoidance the paper's brain is in both tracks; in spot finding it has no raw one."""
    touching, spot = Board("raw", "paper", "wall_avoidance"), Board("raw", "paper", "spot_finding")
    alone = entry("alone", 0.9, 0.8)
    both = summary_of({touching: [LOW, HIGH, alone], spot: BOARD})
    assert alone.title not in [row[0] for row in cells(both)]
    assert alone.title in [row[0] for row in cells(summary_of({touching: [LOW, HIGH, alone]}))]


def test_learners_of_equal_scores_differ_in_about_one_of_twenty_samples():
    """However their robots are spread: one learner fails in a quarter of its robots."""
    random, p = np.random.default_rng(1), []
    fails = entry("fails", 0.0, 0.0, robots=30)
    alike = entry("alike", 0.0, 0.0, robots=30)
    population = np.where(np.arange(4000) < 1000, 0.1, random.normal(0.85, 0.05, 4000))
    ordered = np.sort([random.choice(population, 30) for _ in range(4000)])
    equal = ordered[:, 7:-7].mean()
    for _ in range(150):
        one, other = random.choice(population, 30), random.normal(equal, 0.03, 30)
        entries = [
            dataclasses.replace(fails, after=one, training=one),
            dataclasses.replace(alike, after=other, training=other),
        ]
        ranking = ranked([*entries, LOW, HIGH])
        rows = [n for n, ranked_ in enumerate(ranking) if ranked_.entry.competes]
        p.append(pair_tests(ranking)[rows[0], rows[1]])
    assert 0.02 < np.mean(np.array(p) < 0.05) < 0.10


def test_a_learner_more_on_a_board_changes_no_interval():
    before = {one.entry.name: one.interval for one in ranked(BOARD)}
    after = {one.entry.name: one.interval for one in ranked([entry("new", 0.4, 0.4), *BOARD])}
    assert before == {name: after[name] for name in before}


def test_only_the_first_is_marked_where_robots_are_too_few_for_a_test():
    few = [
        dataclasses.replace(one, after=one.after[:4], training=one.training[:4]) for one in BOARD
    ]
    rows = cells(summary_of({Board("raw", "paper", "spot_finding"): few}))[1:]
    assert [row[0] for row in rows if row[1].startswith("**")] == ["good"]


def test_a_board_whose_bounds_do_not_differ_has_no_scores():
    alike = [LOW, BOARD[1], dataclasses.replace(HIGH, after=LOW.after, training=LOW.training)]
    rows = cells(summary_of({Board("raw", "paper", "spot_finding"): alike}))[1:]
    assert {row[1] for row in rows} == {"-"}


def test_rows_and_tests_go_by_the_same_mean():
    """Half the robots at 0 and half at 1, against robots that are all alike."""
    halves = dataclasses.replace(BOARD[2], name="halves", after=np.repeat([0.1, 0.9], 10))
    halves = dataclasses.replace(halves, training=halves.after)
    middling = entry("middling", 0.55, 0.55, spread=0.01)
    ranking = ranked([LOW, HIGH, halves, middling])
    assert [one.entry.name for one in ranking] == ["hand_coded", "middling", "halves", "newborn"]
    p = pair_tests(ranking)[1, 2]
    middle = [one.score for one in ranking[1:3]]
    assert middle[0] > middle[1] and p > 0.05


def test_steady_has_one_name_in_both_tracks_where_they_differ(runs):
    bounds, _, run = read_runs(runs)
    saturated = dataclasses.replace(run.experiment.brain, raw_signals=False, raw_reward=False)
    paper = dataclasses.replace(
        run, name="paper", experiment=dataclasses.replace(run.experiment, brain=saturated)
    )
    found = boards([bounds, run, paper])
    names = {
        (board.signals, board.task): [one.name for one in entries if not one.is_bound]
        for board, entries in found.items()
    }
    assert names["raw", "spot_finding"] == names["paper", "spot_finding"] == ["steady, creative"]
    assert len({*names["raw", "wall_avoidance"]}) == 2  # the same lives, in two runs
    spot = {board: es for board, es in found.items() if board.task == "spot_finding"}
    rows = [row for row in cells(summary_of(spot)) if row[0].startswith("steady")]
    assert [row[0] for row in rows] == ["steady, creative"] * 2
    assert all(row[1] != "-" for row in rows)
    (command,) = [
        one.command for one in found[Board("paper", "paper", "spot_finding", body="kinematic")]
        if not one.is_bound
    ]  # fmt: skip
    assert "raw_reward=false" in command


def test_the_effort_is_that_of_the_settings_of_the_run():
    held = {"musebot:slow, paper": Effort("3 settings", frozenset({(), ("a=1", "b=2")}))}
    slow, board = BOARD[1], Board("paper", "paper", "spot_finding")
    own = slow.experiment

    def tuned(held, **fields):
        one = dataclasses.replace(slow, experiment=dataclasses.replace(own, **fields))
        rows = markdown(board, *placed(board, [one, LOW, HIGH]), {}, held)
        (row,) = [row for row in rows if row.startswith("| slow | -")]
        return row.split(" | ")[4]

    assert tuned(held, settings=("b=2", "a=1")) == tuned(held) == "3 settings"
    assert tuned(held, settings=("a=3",)) == "own settings, not those of the tuning"
    assert tuned({}, settings=("a=3",)) == "own settings"
    assert tuned({}) == "defaults"


def test_only_the_papers_brain_is_called_published():
    board = Board("paper", "paper", "spot_finding")

    def tuned(brain):
        one = entry("brain", 0.5, 0.5)
        experiment = dataclasses.replace(one.experiment, brain=brain)
        condition = Condition("spot_finding", "creative")
        one = dataclasses.replace(one, experiment=experiment, condition=condition)
        rows = markdown(board, *placed(board, [one, LOW, HIGH]), {}, {})
        (row,) = [row for row in rows if row.startswith("| brain | -")]
        return row.split(" | ")[4]

    saturated = dataclasses.replace(BRAINS["steady"], raw_signals=False, raw_reward=False)
    assert tuned(BRAINS["paper"]) == "as published"
    assert tuned(BRAINS["steady"]) == tuned(saturated) == "by hand, hundreds of settings"
    assert tuned(BRAINS["recurrent"]) == "another brain, see the command"
    assert tuned(dataclasses.replace(BRAINS["steady"], noise=0.1)).startswith("another brain")


def test_the_curve_of_a_rehearsal_shows_all_its_minutes():
    short = [dataclasses.replace(one, curve=one.curve[:8]) for one in BOARD]
    line = draw(ranked(short)).axes[0].lines[0]
    assert line.get_xdata() == [8 / 60]
    assert line.get_ydata() == pytest.approx(ranked(short)[0].entry.curve.mean())


def test_a_short_rehearsal_can_be_drawn():
    short = [dataclasses.replace(one, curve=one.curve[:1]) for one in BOARD]
    assert len(draw(ranked(short)).axes[0].lines) == 5


@pytest.fixture(scope="module")
def runs(tmp_path_factory, in_process):
    """Two rehearsals: agents and both bounds in both tasks, and a brain."""
    folder = tmp_path_factory.mktemp("runs")
    words = "--robots 6 --cohort-size 6 --time-scale 0.004 --body kinematic --processes 1".split()
    agents = ["--agent", "newborn", "hand_coded", "sarsa_lambda", "--agent-set"]
    own = ["--agent", "newborn", "hand_coded"]
    for name, more in (
        ("bounds", own),
        ("sarsa", ["--agent", "sarsa_lambda", "--signals", "raw", *agents[-1:], "rate=0.2"]),
        ("brain", ["--brain", "steady", "--proposer", "creative"]),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(local, "Local", lambda processes: in_process())
            assert cli.main(["run", str(folder / name), *more, *words]) == 0
    return [folder / name for name in ("bounds", "sarsa", "brain")]


def test_runs_become_boards_whose_rows_name_their_commands(
    runs, tmp_path, commands_in_process, cheap_costs
):
    found = boards(read_runs(runs))
    # Nothing saturates in wall avoidance, so that `steady` stands in both tracks.
    assert [*found] == [
        Board("paper", "paper", "wall_avoidance", body="kinematic"),
        Board("raw", "paper", "spot_finding", body="kinematic"),
        Board("raw", "paper", "wall_avoidance", body="kinematic"),
    ]
    spot = Board("raw", "paper", "spot_finding", body="kinematic")
    by_name = {one.name: one for one in found[spot]}
    assert [*by_name] == ["hand_coded", "newborn", "sarsa_lambda", "steady, creative"]
    assert by_name["sarsa_lambda"].command == (
        "--agent sarsa_lambda --signals raw --agent-set rate=0.2 --task spot_finding "
        "--robots 6 --cohort-size 6 --seed 1 --time-scale 0.004 --body kinematic"
    )
    walls = found[Board("raw", "paper", "wall_avoidance", body="kinematic")][0]
    assert walls.after.mean() > 0.9  # the share of time without contact
    assert "sarsa_lambda" not in {
        one.name for one in found[Board("paper", "paper", walls.condition.task, body="kinematic")]
    }
    words = ["study", "leaderboard", str(tmp_path / "out"), "--runs", *map(str, runs)]
    assert cli.main(words) == 0
    page = (tmp_path / "out" / "leaderboard.md").read_text()
    own = next(
        line
        for line in page.splitlines()
        if line.startswith("| sarsa_lambda |") and "--agent" in line
    )
    _, _, us, ratio, size, tuned, module, _, _ = (cell.strip() for cell in own.split("|"))
    assert float(us) > float(ratio) > 0 and float(size) > 1 and tuned == "own settings"
    assert module == "`musebot.protocols.agents.learners.sarsa`"
    measured = {path: path.read_bytes() for path in (tmp_path / "out" / "costs").iterdir()}
    assert len(measured) == 4 + 4 + 3
    assert cli.main(words) == 0  # measures nothing again
    assert {path: path.read_bytes() for path in (tmp_path / "out" / "costs").iterdir()} == measured
    assert (tmp_path / "out" / "leaderboard.md").read_text() == page
    assert (
        "### Wall avoidance, protocol paper, raw signals" in page and "| steady, creative |" in page
    )
    assert {path.name for path in (tmp_path / "out").glob("*.svg")} == {
        "paper-signals-paper-wall_avoidance-kinematic.svg",
        "raw-signals-paper-wall_avoidance-kinematic.svg",
        "raw-signals-paper-spot_finding-kinematic.svg",
    }  # fmt: skip


@pytest.mark.parametrize("task", ["spot_finding", "wall_avoidance"])
def test_a_robot_that_was_stopped_counts_as_the_worst(runs, task):
    bounds, own, _ = read_runs(runs)
    condition = Condition(task, "musebot:sarsa_lambda")
    held = own.results[condition]
    rows = [*held.robots]
    rows[2] = dataclasses.replace(rows[2], category="invalid")
    results = {condition: dataclasses.replace(held, robots=rows)}
    stopped = dataclasses.replace(own, results=results)

    def found(run):
        (one,) = [
            one
            for board, entries in boards([bounds, run]).items()
            if (board.task, board.signals) == (task, "raw")
            for one in entries
            if one.name == "sarsa_lambda"
        ]
        return one

    before, after = found(own), found(stopped)
    assert (before.stopped, after.stopped) == (0, 1)
    for name in ("after", "training"):
        expected = np.where(np.arange(6) == 2, 0, getattr(before, name))
        np.testing.assert_array_equal(getattr(after, name), expected)


def test_bounds_alone_are_no_leaderboard(runs, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["study", "leaderboard", str(out), "--runs", str(runs[0])]) == 2
    assert "the runs hold no learner, only bounds" in capsys.readouterr().err
    assert not out.exists()


def test_the_effort_of_tuning_is_read_from_its_studies(runs, tmp_path, capsys, commands_in_process):
    tiny = "--trials 3 --kept 1 --robots 2 --time-scale 0.004 --processes 1".split()
    tuned = tmp_path / "tuned"
    words = ["study", "tune", str(tuned), "--agent", "sarsa_lambda", "--signals", "raw", *tiny]
    assert cli.main(words) == 0
    board = Leaderboard(runs=tuple(runs), tuned=(tuned,))
    assert board.details() == {
        "effort": {
            "musebot:sarsa_lambda, raw": "3 settings, then the best 1; robots of a setting: "
            "1, then 2, durations times 0.004"
        }
    }
    assert () in efforts([tuned])["musebot:sarsa_lambda, raw"].tried
    assert "| own settings, not those of the tuning |" in board.page(tmp_path).markdown
    (effort,) = board.details()["effort"].values()
    usual = tmp_path / "usual"
    words = "--robots 6 --cohort-size 6 --time-scale 0.004 --body kinematic --processes 1"
    own = ["run", str(usual), "--agent", "sarsa_lambda", "--signals", "raw", *words.split()]
    assert cli.main(own) == 0
    runs = [runs[0], usual]
    assert f"| {effort} |" in Leaderboard(runs=(*runs,), tuned=(tuned,)).page(tmp_path).markdown
    with pytest.raises(InputError, match=r"study.json is no study `tune` of musebot's"):
        Leaderboard(runs=tuple(runs), tuned=(tmp_path,)).details()


def test_runs_in_a_larger_arena_are_a_board_of_their_own(runs):
    larger = [
        dataclasses.replace(
            run, name="large", experiment=dataclasses.replace(run.experiment, arena_scale=1.5)
        )
        for run in read_runs(runs)
    ]
    together = boards([*read_runs(runs), *larger])
    ordinary = [board for board in together if board.arena_scale == 1]
    assert {*together} - {*ordinary} == {
        dataclasses.replace(board, arena_scale=1.5) for board in ordinary
    }
    for board in {*together} - {*ordinary}:
        text = "\n".join(markdown(board, *placed(board, together[board]), {}, {}))
        assert ", arena 1.5 times as large, " in text.splitlines()[0]
        assert text.count(" --arena-scale 1.5 ") == len(together[board])


def test_runs_may_be_kept_without_their_brains(runs, tmp_path):
    kept = [shutil.copytree(run, tmp_path / run.name) for run in runs]
    pages = []
    for folders in (runs, kept):
        pages.append(Leaderboard(runs=tuple(folders)).page(tmp_path).markdown)
        for folder in kept:
            (folder / "brains.safetensors").unlink(missing_ok=True)
    assert pages[0] == pages[1]


def test_robots_of_other_worlds_are_not_ranked_together_and_commands_name_their_world(runs):
    held = read_runs(runs)
    world = {"nose_place": "centre", "motor_speed": 0.1}
    elsewhere = dataclasses.replace(held[1].experiment, **world)
    other = dataclasses.replace(held[1], experiment=elsewhere)
    with pytest.raises(
        InputError, match=r"raw signals, kinematic simulator differ in nose_place: front and centre"
    ):
        boards([held[0], other])
    moved = [
        dataclasses.replace(
            run,
            experiment=dataclasses.replace(run.experiment, body="mujoco", kinematics=Kinematics()),
        )
        for run in held
    ]
    assert len(boards([*held, *moved])) == 2 * len(boards(held))  # each simulator has its own
    bounds = dataclasses.replace(
        held[0], experiment=dataclasses.replace(held[0].experiment, **world)
    )
    for entry in itertools.chain(*boards([bounds, other]).values()):
        assert " --nose-place centre --motor-speed 0.1 " in entry.command


def test_a_brain_with_many_changes_has_a_file_of_costs(runs):
    run = read_runs(runs)[2]
    changes = {
        "learn_rate": 0.00015, "initial_learn_rate": 0.00125, "epsilon": 0.045, "noise": 0.755,
        "initial_epsilon": 0.355, "advantage_scale": 0.855, "noisy_share": 0.255,
        "learn_rate_decay_steps": 10001.5, "epsilon_decay_steps": 10001.5, "random_share": 0.355,
    }  # fmt: skip
    brain = dataclasses.replace(run.experiment.brain, **changes)
    changed = dataclasses.replace(run, experiment=dataclasses.replace(run.experiment, brain=brain))
    jobs = cost_jobs(Path("out"), boards([read_runs(runs)[0], changed]))
    names = [job.path.name for job in jobs]
    assert len({*names}) == len(names) and max(map(len, names)) < 200


def test_a_board_without_bounds_and_a_learner_twice_are_refused(runs):
    with pytest.raises(InputError, match="hold no robots of newborn, a bound"):
        Leaderboard(runs=tuple(runs[1:])).experiments()
    again = read_runs(runs)
    again.append(dataclasses.replace(again[1], name="other"))
    with pytest.raises(InputError, match="sarsa_lambda stands in two runs"):
        boards(again)


def test_a_folder_of_no_tuning_is_refused_before_anything_is_made(runs, tmp_path, here):
    with pytest.raises(InputError, match=r"is no study `tune` of musebot's"):
        conduct(Leaderboard(runs=tuple(runs), tuned=(tmp_path,)), tmp_path / "out", here)
    assert list(tmp_path.iterdir()) == []
