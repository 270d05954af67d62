"""The continual protocol: its lives, its tables, and the study of it."""

import json

import numpy as np
import pytest

from musebot.protocols import cli
from musebot.protocols.analysis import intervals
from musebot.protocols.analysis.comparison import compare_runs
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.experiment.manifest import MANIFEST, read_manifest, write_manifest
from musebot.protocols.experiment.plan import Plan
from musebot.protocols.experiment.schedules import CONTINUAL, SPOT_FINDING
from musebot.protocols.reporting import style
from musebot.protocols.results.results import Robot, collect
from musebot.protocols.results.run import Run
from musebot.protocols.results.run_files import read_run, write_results
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.studies import continual
from musebot.protocols.studies.continual import Continual, Training
from musebot.protocols.studies.study import conduct

SF = "spot_finding"
CREATIVE = Condition(SF, "creative")
SHORT = ["--robots", "2", "--time-scale", "0.001", "--body", "kinematic", "--processes", "1"]


@pytest.fixture(scope="module")
def rehearsal(tmp_path_factory):
    out = tmp_path_factory.mktemp("continual") / "rehearsal"
    asked = [*SHORT, "--protocol", "continual", "--brain", "steady", "--proposer", "creative"]
    assert cli.main(["run", str(out), *asked]) == 0
    return out


def in_the_spot(first, last, robots=6):
    """Minutes of days in which the robots find the spot later and later, by robot."""
    minutes = np.zeros((robots, 1560), np.float32)
    late = np.linspace(first, last, 144).round().astype(int)
    for jump, minute in enumerate(late):
        minutes[:, 60 + 10 * jump + minute : 60 + 10 * (jump + 1)] = 1
    return minutes


@pytest.fixture
def run_of(invented):
    """Writes a run whose robots' curves in training are known, and their seconds in the tests."""

    def run_of(folder, curves, experiment=None, invalid=()):
        rows = [
            Robot(
                SF, "creative", 1, 0, i, 0.0, 1.0, *((np.nan, "invalid") if i in invalid else own)
            )
            for i, own in enumerate([(1.0, "L = 1")] * len(curves))
        ]
        experiment = experiment or Experiment(cohort_size=len(curves), protocol="continual")
        part = invented(experiment, rows)
        if part.curves.shape == curves.shape:
            part.curves[:, 60:1500] = curves[:, 60:1500]
        folder.mkdir()
        write_manifest(folder, Plan.of(experiment, [CREATIVE], len(curves)))
        write_results(folder, {CREATIVE: part})
        return folder

    return run_of


# ---- Its lives ----


def test_the_protocol_has_24_hours_of_learning_between_the_papers_tests():
    pre, training, post = CONTINUAL.phases
    assert (pre, post) == (SPOT_FINDING.phases[0], SPOT_FINDING.phases[2])
    assert CONTINUAL.steps() == [36_000, 864_000, 36_000]
    assert (training.learning, training.spot, training.robot) == (True, "random", None)
    assert training.every_minutes == 10
    assert (CONTINUAL.task, CONTINUAL.wanted, CONTINUAL.unmeasured) == (SF, True, "ignorant")


def test_a_life_has_146_places_of_the_spot_and_continues_from_a_checkpoint(monkeypatch):
    experiment = Experiment(cohort_size=2, time_scale=0.001, protocol="continual", body="kinematic")
    whole, first, second = (Cohort(experiment, CohortKey(CREATIVE, 0)) for _ in range(3))
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


def test_the_curves_of_a_whole_life_hold_every_minute():
    key = CohortKey(Condition(SF, "fixed"), 0)
    experiment = Experiment(cohort_size=1, protocol="continual", body="kinematic")
    cohort = Cohort(experiment, key)
    lives = cohort.lives()
    assert lives.minutes.shape == (1, 1560)
    lives.minutes[:] = np.iinfo(lives.minutes.dtype).max  # more than a minute's 600 steps
    assert lives.minutes.min() > 600
    lives.minutes[:] = np.arange(1560) % 601
    kept = collect(experiment, [(key, lives)])
    curve = kept[key.condition].curves[0]
    assert curve == pytest.approx((np.arange(1560) % 601) / 600)


def test_wall_avoidance_is_refused_before_anything_is_made(tmp_path, capsys):
    asked = ["--protocol", "continual", "--task", "wall_avoidance"]
    assert cli.main(["run", str(tmp_path / "new"), *SHORT, *asked]) == 2
    sentence = "musebot: the protocol continual has only spot_finding, got wall_avoidance\n"
    assert capsys.readouterr().err == sentence
    assert cli.main(["run", str(tmp_path / "new"), *SHORT, "--protocol", "night"]) == 2
    assert (
        capsys.readouterr().err
        == "musebot: the protocol must be one of paper, continual, walls, got 'night'\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_run_has_spot_finding_alone_continues_and_keeps_its_protocol(
    rehearsal, capsys, commands_in_process
):
    assert read_manifest(rehearsal).robots == {CREATIVE: 2}
    assert cli.main(["run", str(rehearsal), "--robots", "4"]) == 0
    assert read_manifest(rehearsal).experiment.protocol == "continual"
    assert len(read_run(rehearsal).robots(CREATIVE)) == 4
    capsys.readouterr()
    assert cli.main(["run", str(rehearsal), "--protocol", "paper"]) == 2
    assert "holds an experiment with protocol continual, not paper" in capsys.readouterr().err


def test_a_run_from_before_there_were_protocols_has_that_of_the_paper(tmp_path):
    write_manifest(tmp_path, Plan.of(Experiment(seed=5), [CREATIVE], 50))
    path = tmp_path / MANIFEST
    content = json.loads(path.read_text())
    assert content["experiment"].pop("protocol") == "paper"
    del content["digest"]
    path.write_text(json.dumps(content))
    assert read_manifest(tmp_path).experiment == Experiment(seed=5)


# ---- The tables ----


def test_the_tables_name_the_protocol_and_have_no_numbers_of_the_papers(rehearsal, capsys):
    assert cli.main(["tables", str(rehearsal)]) == 0
    text = capsys.readouterr().out
    title = "### Spot finding, protocol: continual, brain: steady, body: kinematic"
    assert text.startswith(f"{title}, all durations times 0.001")
    assert "\n\n|  | creative |\n" in text  # "ours" would need a column of the paper
    assert "creative, paper" not in text and "The claims of section 4" not in text
    assert cli.main(["tables", str(rehearsal), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert (plain["protocol"], plain["claims"]) == ("continual", [])
    assert plain["tables"][SF]["creative"]["paper"] is None


def test_runs_of_two_protocols_cannot_be_compared():
    runs = [Run(name, Experiment(protocol=name), {}) for name in ("paper", "continual")]
    with pytest.raises(InputError, match="their protocols are paper and continual"):
        compare_runs(*runs)


# ---- The study ----


def test_hours_are_counted_from_the_start_of_the_training():
    minutes = np.zeros((3, 1440))
    minutes[0, :120] = 1
    minutes[1, 660:720] = 1
    minutes[2, 1320:] = 1
    training = Training("", minutes)
    assert training.share((1, 2)).tolist() == [1, 0, 0]
    assert training.share((11, 12)).tolist() == [0, 0.5, 0]
    assert training.share((23, 24)).tolist() == [0, 0, 1]


def test_a_place_counts_as_found_where_the_robot_is_in_the_spot_before_it_moves_again():
    minutes = np.zeros((2, 1440))
    minutes[0, ::20] = 0.01  # the spot moves onto the robot every other time
    minutes[1, 19::20] = 0.01  # and here is in it at the very end
    assert Training("", minutes).found().tolist() == [0.5, 0.5]


def test_the_curve_after_move_is_the_mean_over_its_hours_and_robots():
    minutes = np.zeros((2, 1440))
    minutes[0, 5:120:10] = 1
    minutes[:, 1329::10] = 0.5
    training = Training("", minutes)
    assert training.after_move((1, 2)).tolist() == [0, 0, 0, 0, 0, 0.5, 0, 0, 0, 0]
    assert training.after_move((23, 24)).tolist() == [0] * 9 + [0.5]


def test_a_study_of_kept_runs_has_a_page_and_a_figure(tmp_path, here, run_of):
    early, late = (
        run_of(tmp_path / name, in_the_spot(*ends), invalid=[5])
        for name, ends in (("early", (1, 1)), ("late", (1, 10)))
    )
    out = tmp_path / "out"
    text = conduct(Continual((early, late)), out, here).markdown
    assert "| early, creative | 5 | 0.900 [0." in text and "| 1.000 [0." in text
    assert "| late, creative | 5 | 0.8" in text
    (row,) = (line for line in text.splitlines() if line.startswith("| late"))
    assert float(row.split("|")[5].split()[0]) < 0.1
    assert text.endswith(
        "\n\n- early: brain paper, cohort_size 6, protocol continual"
        "\n- late: brain paper, cohort_size 6, protocol continual\n"
    )
    names = {"study.json", "continual.md", "continual.svg", "continual.png"}
    assert {path.name for path in out.iterdir()} == names
    assert here.jobs == []


def test_the_figure_shows_the_means_by_the_hour_and_after_a_move():
    found = [Training("", in_the_spot(1, last)[:, 60:1500]) for last in (1, 10)]
    above, below = continual.draw(found).axes
    for line, own in zip(above.lines, found, strict=True):
        assert line.get_ydata() == pytest.approx(own.minutes.reshape(-1, 24, 60).mean(axis=(0, 2)))
    assert len(below.lines) == 4
    assert below.lines[0].get_ydata() == pytest.approx([0] + [1] * 9)
    assert {line.get_color() for line in above.lines} == {*style.PALETTE[:2]}


def test_the_band_of_the_hours_is_the_interval_of_the_mean():
    robots = np.array([0.1, 0.2, 0.2, 0.4, 0.5, 0.9])
    above, _ = continual.draw([Training("", np.repeat(robots[:, None], 1440, axis=1))]).axes
    low, high = intervals.mean(robots, intervals.SHARE)
    assert high - low > 0.1
    (band,) = above.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((low, high))
    assert np.minimum(abs(heights - low), abs(heights - high)) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("experiment", "words"),
    [
        (Experiment(cohort_size=6), "run must have the protocol continual, got paper"),
        (
            Experiment(cohort_size=6, protocol="continual", time_scale=0.5),
            "run is a rehearsal with scaled durations",
        ),
    ],
)
def test_other_runs_are_refused(experiment, words, tmp_path, here, run_of):
    run = run_of(tmp_path / "run", in_the_spot(1, 1), experiment)
    with pytest.raises(InputError, match=words):
        conduct(Continual((run,)), tmp_path / "out", here)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_run_without_valid_robots_is_refused(tmp_path, run_of):
    run = read_run(run_of(tmp_path / "run", in_the_spot(1, 1), invalid=range(6)))
    with pytest.raises(InputError, match="run has no valid robot of spot_finding/creative"):
        continual.trainings([run])


def test_more_conditions_than_there_are_colours_are_refused(tmp_path, run_of):
    run = read_run(run_of(tmp_path / "run", in_the_spot(1, 1)))
    with pytest.raises(InputError, match="a figure shows 1 to 7 conditions, got 8"):
        continual.trainings([run] * 8)
    with pytest.raises(InputError, match="at least one run is needed"):
        Continual(()).experiments()
    with pytest.raises(InputError, match="a run is given twice"):
        Continual((tmp_path / "run",) * 2).experiments()
