"""Trained brains sit their test again in changed robots, arenas and senses; what is kept of it."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
import torch

from musebot.models import Kinematics
from musebot.protocols.errors import InputError, exit_status
from musebot.protocols.experiment.experiment import (
    CohortKey,
    Experiment,
    Plan,
    experiment_of,
    physics_probe,
    save_plan,
)
from musebot.protocols.experiment.schedules import SPOT_FINDING, WALL_AVOIDANCE, control_steps
from musebot.protocols.playback import observation as probes
from musebot.protocols.playback.stored_brains import stored_brains
from musebot.protocols.results.results import collect, save
from musebot.protocols.simulation import engine, pool
from musebot.protocols.simulation.cohort import Cohort, place
from musebot.protocols.studies import robustness
from musebot.protocols.studies.robustness import CHANGES, REFERENCE, Job, Misled, sit
from musebot.tasks.rules import RANGEFINDERS
from musebot.tasks.sensors import distance_signal

EXPERIMENT = Experiment(body="kinematic", cohort_size=3, time_scale=0.002)
CONDITIONS = (("wall_avoidance", "fixed"), ("spot_finding", "creative"))
BY_NAME = {change.name: change for change in CHANGES}


def live(folder, experiment=EXPERIMENT):
    """A finished run."""
    lives = []
    for condition in CONDITIONS:
        cohort = Cohort(experiment, CohortKey(*condition, 0))
        cohort.advance(cohort.steps)
        lives.append((CohortKey(*condition, 0), cohort.lives()))
    folder.mkdir(parents=True)
    save(folder, collect(experiment, lives))
    save_plan(folder / engine.PLAN, Plan.of(experiment, CONDITIONS, experiment.cohort_size))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lived")
    longer = dataclasses.replace(EXPERIMENT, seed=2)
    return live(folder / "first"), live(folder / "second", longer)


@pytest.fixture
def here(monkeypatch):
    """Jobs are done in this process: the processes are slow to start, and have a test below."""

    def results(work, jobs, processes, show):
        assert processes == 1
        for job in jobs:
            yield work(*job)

    monkeypatch.setattr(pool, "results", results)
    monkeypatch.setattr(pool, "tick", lambda amount: None)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def study(out, *runs, **options):
    return exit_status(lambda: robustness.main(runs, out, **({"processes": 1} | options)))


def listing(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def job(run, task, change, seed=0):
    experiment, results = engine.read_run(run)
    experiment = dataclasses.replace(experiment, seed=seed)
    proposer = dict(CONDITIONS)[task]
    return Job(run / "unused", experiment, results, (task, proposer), (0, 1, 2), change)


# ---- What is changed ----


def test_every_change_differs_from_the_reference_in_one_thing():
    assert REFERENCE is CHANGES[0]
    told = {"name", "says", "tasks"}
    for change in CHANGES[1:]:
        fields = {
            field.name
            for field in dataclasses.fields(change)
            if getattr(change, field.name) != getattr(REFERENCE, field.name)
        }
        assert len(fields - told) == 1 and {"name", "says"} <= fields


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
@pytest.mark.parametrize(("name", "factor"), [("half-speed", 0.5), ("double-speed", 2.0)])
@pytest.mark.parametrize("own", [None, 0.1])
def test_a_robot_of_another_speed_goes_that_much_of_the_way(body, name, factor, own):
    experiment = dataclasses.replace(EXPERIMENT, body=body, motor_speed=own)
    ways = []
    for change in (REFERENCE, BY_NAME[name]):
        batch = change.batch(experiment, "spot_finding", 1)
        batch.place(np.array([0]), np.array([[-0.4, 0.0, 0.0]]))
        for _ in range(10):  # the body needs a few control steps to gather speed
            batch.step(np.full((1, 2), 0.25))
        start = batch.pose[0, 0]
        for _ in range(10):
            batch.step(np.full((1, 2), 0.25))
        ways.append(batch.pose[0, 0] - start)
    assert ways[0] == pytest.approx((own or 0.2) / 2, rel=0.01)
    assert ways[1] == pytest.approx(factor * ways[0], rel=0.01)


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
@pytest.mark.parametrize("schedule", [WALL_AVOIDANCE, SPOT_FINDING])
def test_in_the_larger_arena_robot_and_spot_start_as_far_from_its_corners(body, schedule):
    experiment = dataclasses.replace(EXPERIMENT, body=body)
    batch = BY_NAME["larger-arena"].batch(experiment, schedule.task, 1)
    size = batch.dimensions
    assert size.half_length == pytest.approx(0.525 * 4 / 3)
    assert size.half_width == pytest.approx(0.35 * 4 / 3)
    phases = BY_NAME["larger-arena"].test(schedule, size)
    before = [phase for phase in schedule.phases if phase.part == "post"]
    assert len(phases) == len(before) == (2 if schedule is WALL_AVOIDANCE else 1)
    for phase, old in zip(phases, before, strict=True):
        place(batch, phase, np.random.default_rng(0))
        places = [(batch.pose[0, :2], old.robot)]
        if schedule is SPOT_FINDING:
            places.append((batch.spot[0], old.spot))
        for (x, y), was in places:
            assert np.abs([x, y]) == pytest.approx([size.half_length - 0.1, size.half_width - 0.1])
            assert np.array_equal(np.sign([x, y]), np.sign(was[:2]))
        assert batch.pose[0, 2] == pytest.approx(old.robot[2])
        assert phase.minutes == old.minutes and not phase.learning


def test_elsewhere_the_spot_lies_below_the_robot_instead_of_beside_it():
    batch = BY_NAME["spot-lower-left"].batch(EXPERIMENT, "spot_finding", 1)
    [phase] = BY_NAME["spot-lower-left"].test(SPOT_FINDING, batch.dimensions)
    [before] = [phase for phase in SPOT_FINDING.phases if phase.part == "post"]
    assert phase.robot == before.robot
    assert phase.spot == pytest.approx((-0.425, -0.25))
    assert np.hypot(*np.subtract(phase.spot, phase.robot[:2])) == pytest.approx(0.50)
    assert np.hypot(*np.subtract(before.spot, before.robot[:2])) == pytest.approx(0.85)


# ---- What brains are told ----


def misled(runs, task, change, seed=0):
    experiment, results = engine.read_run(runs[0])
    which = [(row, "after") for row in range(3)]
    brains = stored_brains(experiment, results, task, dict(CONDITIONS)[task], which, 0)
    return Misled(brains, change, task, np.random.default_rng(seed))


def test_noise_is_a_tenth_of_each_signal_new_every_step_and_seeded(runs):
    signals = np.tile([0.5, 0.01, 0.3, 0.0, -0.6], (3, 1)).astype(np.float32)
    one, again, other = (misled(runs, "wall_avoidance", BY_NAME["noise"], s) for s in (1, 1, 2))
    told = np.array([one.told(signals) for _ in range(4000)])
    np.testing.assert_array_equal(told[:2], [again.told(signals) for _ in range(2)])
    assert (other.told(signals) != told[0])[:, signals[0] != 0].all()
    np.testing.assert_allclose(told.mean(axis=0), signals, rtol=0.01)
    np.testing.assert_allclose(told.std(axis=0), 0.1 * np.abs(signals), rtol=0.05)
    apart = (told / np.where(signals, signals, 1))[:, :, signals[0] != 0].reshape(4000, -1)
    np.testing.assert_allclose(np.corrcoef(apart.T), np.eye(12), atol=0.1)
    np.testing.assert_allclose(np.corrcoef(apart[1:, 0], apart[:-1, 0])[0, 1], 0, atol=0.1)


def test_noise_keeps_signals_within_their_range(runs):
    signals = np.tile([1.0, 1.0, 0.0, 0.0, -1.0], (3, 1)).astype(np.float32)
    brains = misled(runs, "wall_avoidance", BY_NAME["noise"])
    told = np.array([brains.told(signals) for _ in range(200)])
    assert told[..., :2].max() == 1.0 and told[..., :2].min() < 0.9
    assert told[..., 4].min() == -1.0 and told[..., 4].max() > -0.9
    nose = misled(runs, "spot_finding", BY_NAME["noise"])
    smelled = np.array([nose.told(np.full((3, 1), 10 / 11, "f4")) for _ in range(200)])
    assert 0.4 < smelled.min() < 10 / 11 < smelled.max() == 1.0


@pytest.mark.parametrize("name", RANGEFINDERS)
def test_a_dead_sensor_reads_the_same_whatever_is_there_and_the_others_what_they_did(runs, name):
    brains = misled(runs, "wall_avoidance", BY_NAME[f"dead-{name}"])
    batch = EXPERIMENT.batch("wall_avoidance", 3)
    column = RANGEFINDERS.index(name)
    read = []
    for x, y in ((0.0, 0.1), (0.2, 0.0), (0.45, -0.2)):
        for heading in (0.0, 1.0, 2.0, 4.0):
            batch.place(np.arange(3), np.tile([x, y, heading], (3, 1)))
            signals = batch.rules.state(batch.sensordata).astype(np.float32)
            before = signals.copy()
            told = brains.told(signals)
            np.testing.assert_array_equal(signals, before)
            np.testing.assert_array_equal(*(np.delete(s, column, 1) for s in (told, signals)))
            seen = distance_signal(batch.sensordata[:, batch.rules.layout.distances])[:, column]
            np.testing.assert_array_equal(signals[:, column], seen.astype(np.float32))
            read.append((told[0, column], signals[0, column]))
    dead, alive = np.array(read).T
    assert (dead == 0).all() and len({*alive}) >= 8 and (alive > 0).all()


# ---- The test ----


@pytest.mark.parametrize("task", dict(CONDITIONS))
def test_with_nothing_changed_it_is_the_test_of_the_schedule(runs, task):
    wanted = job(runs[0], task, REFERENCE, seed=5)
    seed, random = wanted.experiment.seeds(CohortKey(*wanted.condition, 0))
    which = [(row, "after") for row in wanted.rows]
    brains = stored_brains(wanted.experiment, wanted.results, *wanted.condition, which, seed)
    weights = {name: array.copy() for name, array in brains.weights().items()}
    batch = wanted.experiment.batch(task, 3)
    events = np.zeros(3, int)
    for phase in wanted.experiment.schedule(task).phases:
        if phase.part == "post":
            place(batch, phase, random)
            for _ in range(control_steps(phase.minutes)):
                state = batch.rules.state(batch.sensordata).astype(np.float32)
                batch.step(brains.act(state, False))
                events += batch.rules.event(batch.sensordata)
    found = sit(wanted)
    np.testing.assert_array_equal(found["events"], events)
    assert found["valid"].all()
    for name, array in brains.weights().items():
        np.testing.assert_array_equal(array, weights[name])


def test_robots_that_went_into_walls_meet_fewer_at_a_crawl(runs):
    """The speed reaches the robots: at a thousandth of it nobody gets the ten centimetres."""
    crawl = dataclasses.replace(REFERENCE, speed=0.001)
    assert sit(job(runs[0], "wall_avoidance", crawl))["events"].sum() == 0
    fast = dataclasses.replace(REFERENCE, speed=2.0)
    assert sit(job(runs[0], "wall_avoidance", fast))["events"].sum() > 0


@pytest.fixture
def went(monkeypatch):
    """Where a job's robots went, in tests three times as long."""
    tracks, watch = [], probes.watch

    def recorded(*args, **kwargs):
        tracks.append(watch(*args, **kwargs))
        return tracks[-1]

    monkeypatch.setattr(probes, "watch", recorded)

    def went(job):
        tracks.clear()
        sit(
            dataclasses.replace(
                job, experiment=dataclasses.replace(job.experiment, time_scale=0.006)
            )
        )
        return np.concatenate([track.poses for track in tracks])

    return went


@pytest.mark.parametrize("task", dict(CONDITIONS))
def test_every_change_changes_what_robots_do(runs, went, task):
    unchanged = went(job(runs[0], task, REFERENCE))
    for change in CHANGES[1:]:
        if task in change.tasks:
            assert not np.array_equal(went(job(runs[0], task, change)), unchanged), change.name


def test_the_seed_decides_the_ideas(runs, went):
    one, again, other = (
        went(job(runs[0], "spot_finding", REFERENCE, seed=seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)


# ---- The study ----


def test_a_study_keeps_every_test_and_its_page_and_goes_on_where_it_was(
    runs, tmp_path, here, capsys
):
    out = tmp_path / "study"
    assert study(out, *runs) == 0
    text, _ = capsys.readouterr()
    assert text == robustness.report(out) + "\n" == (out / "robustness.md").read_text() + "\n"
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    walls = [change for change in CHANGES if "wall_avoidance" in change.tasks]
    smells = [change for change in CHANGES if "spot_finding" in change.tasks]
    assert len(rows) == len(walls) + len(smells) + 4
    assert {line.count("|") for line in rows} == {8}  # a change, and three cells of each run
    assert "a rehearsal: every duration times 0.002" in text
    assert len([*out.glob("*/*.safetensors")]) == 2 * (len(walls) + len(smells))

    before = listing(out)
    (out / "robustness.md").unlink()
    (out / "first" / "wall_avoidance-fixed-noise.safetensors").unlink()
    (out / "second" / ".x.1.draft").write_text("half")
    assert study(out, *runs) == 0
    assert listing(out) == before


def test_differences_are_of_pairs_and_robots_that_became_unstable_are_left_out():
    reference = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, np.nan])
    found = np.array([0.0, 0.1, 0.3, 0.2, np.nan, 0.4, 0.9])
    share, difference, never = robustness.cells(found, reference)
    assert share.startswith(f"{np.nanmean(found):.4f} [")
    assert difference.startswith(f"{-(0.1 + 0.1 + 0 + 0.2 + 0.2) / 5:+.4f} [")
    assert never == "1 of 6"
    assert robustness.cells(reference, reference)[1] == ""
    assert robustness.cells(np.zeros(9), np.ones(9)) == ["0.0000", "-1.0000", "9 of 9"]


def test_at_most_so_many_robots_sit_and_no_invalid_ones(runs, tmp_path, here):
    experiment, results = engine.read_run(runs[0])
    rows = [
        dataclasses.replace(robot, category="invalid", learn_ability=float("nan"))
        if (robot.task, robot.robot) == ("spot_finding", 0)
        else robot
        for robot in results.robots
    ]
    folder = tmp_path / "run"
    folder.mkdir()
    save(folder, dataclasses.replace(results, robots=rows))
    save_plan(folder / engine.PLAN, Plan.of(experiment, CONDITIONS, 3))
    [(sitter, lives)] = robustness.sitters([folder], 60, None, 0)
    assert sitter.robots == {CONDITIONS[0]: 3, CONDITIONS[1]: 2}
    chosen = {job.condition: job.rows for job in robustness.jobs(tmp_path, [(sitter, lives)])}
    assert chosen == {CONDITIONS[0]: (0, 1, 2), CONDITIONS[1]: (1, 2)}
    [(sitter, _)] = robustness.sitters([folder], 1, None, 0)
    assert sitter.robots == dict.fromkeys(CONDITIONS, 1)


def test_only_the_proposers_that_are_asked_for_sit(runs, tmp_path, capsys):
    for condition in CONDITIONS:
        [(sitter, _)] = robustness.sitters(runs[:1], 1, None, 0, condition[1:])
        assert sitter.robots == {condition: 1}
    for proposer, words in (
        ("best", "must be one of fixed, random"),
        ("random", "no brain of a random"),
    ):
        assert study(tmp_path / "study", runs[0], proposer=(proposer,)) == 2
        assert words in capsys.readouterr().err
        assert not (tmp_path / "study").exists()


def test_the_body_is_the_runs_own_or_the_one_asked_for(runs):
    for body, expected in ((None, "kinematic"), ("mujoco", "mujoco")):
        [(sitter, _)] = robustness.sitters(runs[:1], 1, body, 7)
        assert sitter.experiment == dataclasses.replace(EXPERIMENT, body=expected, seed=7)
        assert robustness.Sitter.of_plain(sitter.plain()) == sitter


def test_a_study_in_other_walls_of_a_stand_in_told_how_to_drive_is_refused(tmp_path, here, capsys):
    turns = Kinematics(wall="turns")
    run = live(tmp_path / "run", dataclasses.replace(EXPERIMENT, kinematics=turns))
    out = tmp_path / "study"
    assert study(out, run) == 0
    file = out / robustness.STUDY
    held = json.loads(file.read_text())
    assert held["runs"][0]["physics"] == list(physics_probe("kinematic", turns))
    held["runs"][0]["physics"] = physics_probe("kinematic", Kinematics(wall="slides"))
    file.write_text(json.dumps(held))
    before = listing(out)
    assert study(out, run) == 2
    assert "was measured in another physics than this version's" in capsys.readouterr().err
    assert listing(out) == before


def test_an_experiment_comes_back_from_json():
    experiment = Experiment(body="kinematic", kinematics=Kinematics(lag=0.08), motor_speed=0.1)
    plain = json.loads(json.dumps(dataclasses.asdict(experiment)))
    assert experiment_of(plain) == experiment


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "number of robots must be at least 1, got 0"),
        ({"processes": 0}, "number of processes must be at least 1, got 0"),
        ({"seed": -1}, "seed must lie in [0, 2^63), got -1"),
        ({"body": "wooden"}, "body must be one of mujoco, kinematic, got 'wooden'"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_made(options, words, runs, tmp_path, capsys):
    assert study(tmp_path / "study", *runs, **options) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_study_of_no_run_is_refused(tmp_path, capsys):
    assert study(tmp_path / "study") == 2
    assert "no run is named whose brains could sit the test" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_runs_that_cannot_stand_in_one_table_are_refused(runs, tmp_path, capsys):
    out = tmp_path / "study"
    assert study(out, runs[0], runs[0]) == 2
    assert "runs must have different names, got first, first" in capsys.readouterr().err
    assert study(out, tmp_path) == 2
    assert "holds no experiment of musebot's" in capsys.readouterr().err
    shorter = dataclasses.replace(EXPERIMENT, time_scale=0.001)
    assert study(out, runs[0], live(tmp_path / "shorter", shorter)) == 2
    assert "durations are the paper's times 0.001 and 0.002" in capsys.readouterr().err
    assert not out.exists()


def test_a_foreign_folder_and_another_study_are_refused_and_left_alone(
    runs, tmp_path, here, capsys
):
    (tmp_path / "thesis.tex").write_text("precious")
    assert study(tmp_path, *runs) == 2
    assert "is not empty and holds no study of musebot's" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]

    out = tmp_path / "study"
    assert study(out, runs[0], robots=2) == 0
    capsys.readouterr()
    before = listing(out)
    other = live(tmp_path / "other" / "first", dataclasses.replace(EXPERIMENT, seed=3))
    for asked, options, words in (
        (runs, {"robots": 2}, "holds a study of first, not of first, second"),
        (runs[:1], {"robots": 3}, "holds a study of 2, 2 robots of first, not of 3, 3"),
        (runs[:1], {"robots": 2, "seed": 1}, "holds a study of first with seed 0, not 1"),
        (runs[:1], {"robots": 2, "body": "mujoco"}, "with body kinematic, not mujoco"),
        ([other], {"robots": 2}, "holds a study of other brains than those of first"),
    ):
        assert study(out, *asked, **options) == 2
        assert words in capsys.readouterr().err
    assert listing(out) == before


def test_what_a_study_lacks_or_was_measured_otherwise_is_named(
    runs, tmp_path, here, capsys, monkeypatch
):
    out = tmp_path / "study"
    assert study(out, runs[0]) == 0
    changes = [
        dataclasses.replace(change, noise=0.2) if change.noise else change for change in CHANGES
    ]
    monkeypatch.setattr(robustness, "CHANGES", changes)
    with pytest.raises(InputError, match="was measured with another change than noise"):
        robustness.report(out)
    (out / "first" / "wall_avoidance-fixed-unchanged.safetensors").unlink()
    before = listing(out)
    assert study(out, runs[0]) == 2
    assert "was measured with another change than noise" in capsys.readouterr().err
    assert listing(out) == before
    monkeypatch.setattr(robustness, "CHANGES", CHANGES)
    assert study(out, runs[0]) == 0
    (out / "first" / "spot_finding-creative-noise.safetensors").unlink()
    with pytest.raises(InputError, match="lacks first/spot_finding-creative-noise"):
        robustness.report(out)
    (out / "study.json").write_text("{}")
    with pytest.raises(InputError, match="is no study of musebot's"):
        robustness.report(out)
    with pytest.raises(InputError, match="holds no study of musebot's"):
        robustness.report(tmp_path)


def test_a_study_that_was_stopped_goes_on_to_the_same_bytes(tmp_path, here, stopped):
    run = live(tmp_path / "run", dataclasses.replace(EXPERIMENT, time_scale=0.01))
    assert study(tmp_path / "whole", run) == 0
    out = tmp_path / "stopped"
    line = [sys.executable, "-m", "musebot.protocols.studies.robustness", str(run)]
    line += ["--out", str(out), "--processes", "1"]
    status, said = stopped(line, out, "*/*.safetensors")
    kept = len([*out.glob("*/*.safetensors")])
    assert (status, 0 < kept < 15) == (130, True), said
    assert "the same command goes on from here" in said
    assert study(out, run) == 0
    assert listing(out) == listing(tmp_path / "whole")


def test_it_explains_itself():
    line = [sys.executable, "-m", "musebot.protocols.studies.robustness", "--help"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "--robots" in done.stdout
