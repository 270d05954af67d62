"""The day: its lives, whom they can stand beside, and what is told of them."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from musebot.protocols import cli
from musebot.protocols.analysis import comparison as beside
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.experiment import (
    CohortKey,
    Experiment,
    Plan,
    load_plan,
    save_plan,
)
from musebot.protocols.experiment.schedules import DAY, SPOT_FINDING
from musebot.protocols.reporting import figures
from musebot.protocols.results.results import Results, Robot, results
from musebot.protocols.simulation import engine
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.studies import continual as day
from musebot.protocols.studies.continual import Day

SF = "spot_finding"
SHORT = ["--robots", "2", "--time-scale", "0.001", "--body", "kinematic", "--processes", "1"]


@pytest.fixture(scope="module")
def rehearsal(tmp_path_factory):
    out = tmp_path_factory.mktemp("day") / "rehearsal"
    asked = [*SHORT, "--course", "day", "--brain", "steady", "--proposer", "creative"]
    assert cli.main(["run", str(out), *asked]) == 0
    return out


def in_the_spot(first, last, robots=6):
    """Minutes of days in which the robots find the spot later and later, by robot."""
    minutes = np.zeros((robots, 1560), np.float32)
    late = np.linspace(first, last, 144).round().astype(int)
    for jump, minute in enumerate(late):
        minutes[:, 60 + 10 * jump + minute : 60 + 10 * (jump + 1)] = 1
    return minutes


def run_of(folder, curves, experiment=None, invalid=()):
    """A run whose robots' curves are known."""
    rows = [
        Robot(SF, "creative", 1, 0, i, 0.0, 1.0, *((np.nan, "invalid") if i in invalid else own))
        for i, own in enumerate([(1.0, "L = 1")] * len(curves))
    ]
    experiment = experiment or Experiment(cohort_size=len(curves), course="day")
    folder.mkdir()
    save_plan(folder / engine.PLAN, Plan.of(experiment, [(SF, "creative")], len(curves)))
    results.save(folder, Results(rows, {f"{SF}/creative": curves}, {}))
    return folder


# Its lives


def test_the_day_is_24_hours_of_learning_between_the_papers_tests():
    pre, training, post = DAY.phases
    assert (pre, post) == (SPOT_FINDING.phases[0], SPOT_FINDING.phases[2])
    assert DAY.steps() == [36_000, 864_000, 36_000]
    assert (training.learning, training.spot, training.robot) == (True, "random", None)
    assert training.every_minutes == 10
    assert (DAY.task, DAY.wanted, DAY.unmeasured) == (SF, True, "ignorant")


def test_a_life_of_the_day_has_146_places_of_the_spot_and_goes_on_from_a_checkpoint(monkeypatch):
    experiment = Experiment(cohort_size=2, time_scale=0.001, course="day", body="kinematic")
    whole, first, second = (Cohort(experiment, CohortKey(SF, "creative", 0)) for _ in range(3))
    spots, put = [], whole.batch.place_spot
    monkeypatch.setattr(
        whole.batch, "place_spot", lambda who, where: (spots.append(where[0]), put(who, where))
    )
    whole.advance(10**9)
    assert whole.steps == 936
    assert len(spots) == 146
    assert len({tuple(spot) for spot in spots}) == 145  # the two tests' is one
    first.advance(500)
    second.restore(*first.checkpoint())
    second.advance(10**9)
    for name, weights in whole.lives().after.items():
        assert np.array_equal(weights, second.lives().after[name])


def test_the_curves_of_a_whole_day_hold_every_minute():
    cohort = Cohort(
        Experiment(cohort_size=1, course="day", body="kinematic"), CohortKey(SF, "fixed", 0)
    )
    lives = cohort.lives()
    assert lives.minutes.shape == (1, 1560)
    lives.minutes[:] = np.iinfo(lives.minutes.dtype).max  # more than a minute's 600 steps
    assert lives.minutes.min() > 600
    lives.minutes[:] = np.arange(1560) % 601
    key = CohortKey(SF, "fixed", 0)
    kept = results.collect(Experiment(cohort_size=1, course="day"), [(key, lives)])
    curve = kept.curves[f"{SF}/fixed"][0]
    assert curve == pytest.approx((np.arange(1560) % 601) / 600)


def test_wall_avoidance_has_no_day_and_is_refused_before_anything_is_made(tmp_path, capsys):
    asked = ["--course", "day", "--task", "wall_avoidance"]
    assert cli.main(["run", str(tmp_path / "new"), *SHORT, *asked]) == 2
    sentence = "musebot: the course day has only spot_finding, got wall_avoidance\n"
    assert capsys.readouterr().err == sentence
    assert cli.main(["run", str(tmp_path / "new"), *SHORT, "--course", "night"]) == 2
    assert (
        capsys.readouterr().err
        == "musebot: the course must be one of paper, day, walls, got 'night'\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_run_of_the_day_lives_spot_finding_alone_goes_on_and_is_no_other_run(rehearsal, capsys):
    assert load_plan(rehearsal / engine.PLAN).robots == {(SF, "creative"): 2}
    assert cli.main(["run", str(rehearsal), "--robots", "4"]) == 0
    assert load_plan(rehearsal / engine.PLAN).experiment.course == "day"
    assert len(engine.read_run(rehearsal)[1].robots) == 4
    capsys.readouterr()
    assert cli.main(["run", str(rehearsal), "--course", "paper"]) == 2
    assert "holds an experiment with course day, not paper" in capsys.readouterr().err


def test_a_run_from_before_there_was_a_day_is_of_the_papers_course(tmp_path):
    path = tmp_path / engine.PLAN
    save_plan(path, Plan.of(Experiment(seed=5), [(SF, "creative")], 50))
    content = json.loads(path.read_text())
    assert content["experiment"].pop("course") == "paper"
    path.write_text(json.dumps(content))
    assert load_plan(path).experiment == Experiment(seed=5)


# The tables


def test_the_tables_of_a_day_say_so_and_have_nothing_of_the_papers(rehearsal, capsys):
    assert cli.main(["tables", str(rehearsal)]) == 0
    text = capsys.readouterr().out
    title = "### Spot finding, course: day, brain: steady, body: kinematic"
    title += ", a rehearsal: every duration times 0.001"
    assert text.startswith(title)
    assert "creative, ours" in text
    assert "creative, paper" not in text and "The claims of section 4" not in text
    assert cli.main(["tables", str(rehearsal), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert (plain["course"], plain["claims"]) == ("day", [])
    assert plain["tables"][SF]["creative"]["paper"] is None


def test_lives_of_two_courses_cannot_stand_side_by_side():
    empty = Results([], {}, {})
    sides = [beside.Side(course, Experiment(course=course), empty) for course in ("paper", "day")]
    with pytest.raises(InputError, match="their courses are paper and day"):
        beside.all_cells(*sides)


# What is told of them


def test_hours_are_counted_from_the_start_of_the_training():
    minutes = np.zeros((3, 1440))
    minutes[0, :120] = 1
    minutes[1, 660:720] = 1
    minutes[2, 1320:] = 1
    lived = Day("", minutes)
    assert lived.share((1, 2)).tolist() == [1, 0, 0]
    assert lived.share((11, 12)).tolist() == [0, 0.5, 0]
    assert lived.share((23, 24)).tolist() == [0, 0, 1]


def test_a_jump_counts_as_followed_where_the_robot_is_in_the_spot_before_the_next():
    minutes = np.zeros((2, 1440))
    minutes[0, ::20] = 0.01  # at every other jump, the robot stands where the spot falls
    minutes[1, 19::20] = 0.01  # and here is in it at the very end
    assert Day("", minutes).found().tolist() == [0.5, 0.5]


def test_the_curve_after_a_jump_is_the_mean_over_its_hours_and_robots():
    minutes = np.zeros((2, 1440))
    minutes[0, 5:120:10] = 1
    minutes[:, 1329::10] = 0.5
    lived = Day("", minutes)
    assert lived.after_a_jump((1, 2)).tolist() == [0, 0, 0, 0, 0, 0.5, 0, 0, 0, 0]
    assert lived.after_a_jump((23, 24)).tolist() == [0] * 9 + [0.5]


def test_days_are_printed_and_drawn(tmp_path, capsys):
    early, late = (
        run_of(tmp_path / name, in_the_spot(*ends), invalid=[5])
        for name, ends in (("early", (1, 1)), ("late", (1, 10)))
    )
    for suffix in ("svg", "png"):
        output = tmp_path / f"day.{suffix}"
        words = [str(early), str(late), "--output", str(output)]
        assert run_command(words) == 0
        text = capsys.readouterr().out
        assert "| early, creative | 5 | 0.900 | 0.900 | 0.900 | 1.000 |" in text
        assert "| late, creative | 5 | 0.8" in text
        last = [line for line in text.splitlines() if line.startswith("| late")][0]
        assert float(last.split("|")[5]) < 0.1
        assert text.endswith(
            "\n\n- early: brain paper, cohort_size 6, course day"
            "\n- late: brain paper, cohort_size 6, course day\n"
        )
    assert run_command([str(early), str(late)]) == 0
    assert capsys.readouterr().out == text
    assert ElementTree.parse(tmp_path / "day.svg").getroot().tag.endswith("svg")
    assert np.asarray(Image.open(tmp_path / "day.png"))[..., 3].max() == 255
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_the_figure_shows_the_means_by_the_hour_and_after_a_jump():
    lived = [Day("", in_the_spot(1, last)[:, 60:1500]) for last in (1, 10)]
    above, below = day.draw(lived).axes
    for line, own in zip(above.lines, lived, strict=True):
        assert line.get_ydata() == pytest.approx(own.minutes.reshape(-1, 24, 60).mean(axis=(0, 2)))
    assert len(below.lines) == 4
    assert below.lines[0].get_ydata() == pytest.approx([0] + [1] * 9)
    assert {line.get_color() for line in above.lines} == {*figures.PALETTE[:2]}


def run_command(words):
    import tyro

    from musebot.protocols.errors import exit_status

    return exit_status(lambda: tyro.cli(day.main, args=words))


@pytest.mark.parametrize(
    ("experiment", "output", "words"),
    [
        (Experiment(cohort_size=6), "day.svg", "has lived the course paper, not the day"),
        (
            Experiment(cohort_size=6, course="day", time_scale=0.5),
            "day.svg",
            "is a rehearsal: its curves do not tell jump from jump",
        ),
        (None, "day.pdf", "the figure must be an .svg or .png, got "),
        (None, "nowhere/day.svg", "there is no folder "),
    ],
)
def test_what_is_no_day_is_refused_in_a_sentence(experiment, output, words, tmp_path, capsys):
    run = run_of(tmp_path / "run", in_the_spot(1, 1), experiment)
    assert run_command([str(run), "--output", str(tmp_path / output)]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_more_days_than_there_are_colours_are_refused(tmp_path):
    run = run_of(tmp_path / "run", in_the_spot(1, 1))
    with pytest.raises(InputError, match="a figure holds 1 to 7 conditions, got 8"):
        day.days([run] * 8)
    with pytest.raises(InputError, match="a figure holds 1 to 7 conditions, got 0"):
        day.days([])
