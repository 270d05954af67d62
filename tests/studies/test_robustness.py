"""Trained brains evaluated with perturbed robots, arenas and sensors, and what is kept of it."""

import dataclasses

import numpy as np
import pytest

from musebot.models import Kinematics
from musebot.protocols.agents.perturbed import PerturbedBrain
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.experiment.manifest import write_manifest
from musebot.protocols.experiment.plan import Plan
from musebot.protocols.experiment.random_streams import random_streams
from musebot.protocols.experiment.schedules import SPOT_FINDING, WALL_AVOIDANCE, control_steps
from musebot.protocols.playback import rollout
from musebot.protocols.playback.rollout import watch
from musebot.protocols.playback.stored_brains import stored_brains
from musebot.protocols.results.results import collect
from musebot.protocols.results.run import Run
from musebot.protocols.results.run_files import read_run, write_results
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.simulation.placement import place
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.protocols.studies import robustness
from musebot.protocols.studies.robustness import (
    PERTURBATIONS,
    REFERENCE,
    PerturbedTest,
    Robustness,
    evaluate,
)
from musebot.protocols.studies.study import conduct
from musebot.tasks.rules import RANGEFINDERS
from musebot.tasks.sensors import distance_signal

EXPERIMENT = Experiment(body="kinematic", cohort_size=3, time_scale=0.002)
PROPOSERS = {"wall_avoidance": "fixed", "spot_finding": "creative"}
CONDITIONS = tuple(Condition(*pair) for pair in PROPOSERS.items())
BY_NAME = {perturbation.name: perturbation for perturbation in PERTURBATIONS}


class Few(Robustness):
    """Two perturbations: what is tested is the study, not each of them."""

    perturbations = (REFERENCE, BY_NAME["noise"], BY_NAME["dead-left"])


def simulated(folder, experiment=EXPERIMENT):
    """A finished run."""
    lives = []
    for condition in CONDITIONS:
        key = CohortKey(condition, 0)
        cohort = Cohort(experiment, key)
        cohort.advance(cohort.steps)
        lives.append((key, cohort.lives()))
    return kept(folder, Run("run", experiment, collect(experiment, lives)))


def kept(folder, run):
    folder.mkdir(parents=True)
    size = run.experiment.cohort_size
    write_manifest(folder, Plan.of(run.experiment, run.conditions(), size))
    write_results(folder, run.results)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    other = dataclasses.replace(EXPERIMENT, seed=2)
    return simulated(folder / "first"), simulated(folder / "second", other)


def job(run, task, perturbation, seed=0, time_scale=0.002):
    own = read_run(run)
    experiment = dataclasses.replace(own.experiment, seed=seed, time_scale=time_scale)
    condition = Condition(task, PROPOSERS[task])
    changed = Run(own.name, experiment, own.results)
    return PerturbedTest(run / "unused", changed, condition, (0, 1, 2), perturbation)


# ---- What differs ----


def test_every_perturbation_differs_from_the_reference_in_one_thing():
    assert REFERENCE is PERTURBATIONS[0]
    labels = {"name", "says", "tasks"}
    for perturbation in PERTURBATIONS[1:]:
        fields = {
            field.name
            for field in dataclasses.fields(perturbation)
            if getattr(perturbation, field.name) != getattr(REFERENCE, field.name)
        }
        assert len(fields - labels - {"torque"}) == 1 and {"name", "says"} <= fields
        assert "torque" not in fields or "speed" in fields


def test_only_a_scaled_torque_is_named_in_a_file(runs):
    """Files made before there was a choice name none."""
    for name, named in (("half-speed", False), ("half-speed-lag", True)):
        own = job(runs[0], "spot_finding", BY_NAME[name])
        assert ("torque" in own.identity["change"]) is named


@pytest.mark.parametrize("name", ["half-speed", "double-speed"])
def test_with_scaled_torque_the_wheels_follow_as_fast_at_every_speed(name):
    """What is missing of the full way, in seconds at full speed, is the lag."""
    experiment, missing = dataclasses.replace(EXPERIMENT, body="mujoco"), {}
    for perturbation in (REFERENCE, BY_NAME[name], BY_NAME[f"{name}-lag"]):
        batch = perturbation.batch(experiment, "wall_avoidance", 1)
        batch.place(np.array([0]), np.array([[-0.45, 0.0, 0.0]]))
        for _ in range(10):
            batch.step(np.full((1, 2), 0.5))
        speed = batch.dimensions.motor_speed
        missing[perturbation.name] = 1 - (batch.pose[0, 0] + 0.45) / speed
    assert missing[f"{name}-lag"] == pytest.approx(missing["unchanged"], abs=0.002)
    assert missing[name] / missing["unchanged"] == pytest.approx(
        BY_NAME[name].speed, rel=0.2
    )  # the lag that grows with the speed


@pytest.mark.parametrize("body", ["kinematic", "mujoco"])
@pytest.mark.parametrize(("name", "factor"), [("half-speed", 0.5), ("double-speed", 2.0)])
@pytest.mark.parametrize("own", [None, 0.1])
def test_a_robot_of_another_speed_moves_in_proportion(body, name, factor, own):
    experiment = dataclasses.replace(EXPERIMENT, body=body, motor_speed=own)
    ways = []
    for perturbation in (REFERENCE, BY_NAME[name]):
        batch = perturbation.batch(experiment, "spot_finding", 1)
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


def test_the_moved_spot_lies_below_the_robot_instead_of_to_its_right():
    batch = BY_NAME["spot-lower-left"].batch(EXPERIMENT, "spot_finding", 1)
    [phase] = BY_NAME["spot-lower-left"].test(SPOT_FINDING, batch.dimensions)
    [before] = [phase for phase in SPOT_FINDING.phases if phase.part == "post"]
    assert phase.robot == before.robot
    assert phase.spot == pytest.approx((-0.425, -0.25))
    assert np.hypot(*np.subtract(phase.spot, phase.robot[:2])) == pytest.approx(0.50)
    assert np.hypot(*np.subtract(before.spot, before.robot[:2])) == pytest.approx(0.85)


# ---- What brains sense ----


def perturbed(runs, task, perturbation, seed=0):
    condition = Condition(task, PROPOSERS[task])
    which = [(row, "after") for row in range(3)]
    brains = stored_brains(read_run(runs[0]), condition, which, 0)
    random = np.random.default_rng(seed)
    return PerturbedBrain(brains, task, random, perturbation.noise, perturbation.dead)


def test_noise_is_a_tenth_of_each_signal_new_every_step_and_seeded(runs):
    signals = np.tile([0.5, 0.01, 0.3, 0.0, -0.6], (3, 1)).astype(np.float32)
    one, again, other = (perturbed(runs, "wall_avoidance", BY_NAME["noise"], s) for s in (1, 1, 2))
    found = np.array([one.perturbed(signals) for _ in range(4000)])
    np.testing.assert_array_equal(found[:2], [again.perturbed(signals) for _ in range(2)])
    assert (other.perturbed(signals) != found[0])[:, signals[0] != 0].all()
    np.testing.assert_allclose(found.mean(axis=0), signals, rtol=0.01)
    np.testing.assert_allclose(found.std(axis=0), 0.1 * np.abs(signals), rtol=0.05)
    apart = (found / np.where(signals, signals, 1))[:, :, signals[0] != 0].reshape(4000, -1)
    np.testing.assert_allclose(np.corrcoef(apart.T), np.eye(12), atol=0.1)
    np.testing.assert_allclose(np.corrcoef(apart[1:, 0], apart[:-1, 0])[0, 1], 0, atol=0.1)


def test_noise_keeps_signals_within_their_range(runs):
    signals = np.tile([1.0, 1.0, 0.0, 0.0, -1.0], (3, 1)).astype(np.float32)
    brains = perturbed(runs, "wall_avoidance", BY_NAME["noise"])
    found = np.array([brains.perturbed(signals) for _ in range(200)])
    assert found[..., :2].max() == 1.0 and found[..., :2].min() < 0.9
    assert found[..., 4].min() == -1.0 and found[..., 4].max() > -0.9
    nose = perturbed(runs, "spot_finding", BY_NAME["noise"])
    smelled = np.array([nose.perturbed(np.full((3, 1), 10 / 11, "f4")) for _ in range(200)])
    assert 0.4 < smelled.min() < 10 / 11 < smelled.max() == 1.0


@pytest.mark.parametrize("name", RANGEFINDERS)
def test_a_dead_sensor_always_reads_the_same_and_the_others_are_unchanged(runs, name):
    brains = perturbed(runs, "wall_avoidance", BY_NAME[f"dead-{name}"])
    batch = EXPERIMENT.batch("wall_avoidance", 3)
    column = RANGEFINDERS.index(name)
    read = []
    for x, y in ((0.0, 0.1), (0.2, 0.0), (0.45, -0.2)):
        for heading in (0.0, 1.0, 2.0, 4.0):
            batch.place(np.arange(3), np.tile([x, y, heading], (3, 1)))
            signals = batch.rules.state(batch.sensordata).astype(np.float32)
            before = signals.copy()
            found = brains.perturbed(signals)
            np.testing.assert_array_equal(signals, before)
            np.testing.assert_array_equal(*(np.delete(s, column, 1) for s in (found, signals)))
            seen = distance_signal(batch.sensordata[:, batch.rules.layout.distances])[:, column]
            np.testing.assert_array_equal(signals[:, column], seen.astype(np.float32))
            read.append((found[0, column], signals[0, column]))
    dead, alive = np.array(read).T
    assert (dead == 0).all() and len({*alive}) >= 8 and (alive > 0).all()


# ---- The test ----


@pytest.mark.parametrize("task", PROPOSERS)
def test_without_a_perturbation_it_is_the_test_of_the_schedule(runs, task):
    wanted = job(runs[0], task, REFERENCE, seed=5)
    experiment = wanted.evaluated.experiment
    seed, random = random_streams(experiment.seed, CohortKey(wanted.condition, 0))
    which = [(row, "after") for row in wanted.rows]
    brains = stored_brains(wanted.evaluated, wanted.condition, which, seed)
    weights = {name: array.copy() for name, array in brains.weights().items()}
    batch = experiment.batch(task, 3)
    events = np.zeros(3, int)
    for phase in experiment.schedule(task).phases:
        if phase.part == "post":
            place(batch, phase, random)
            for _ in range(control_steps(phase.minutes)):
                state = batch.rules.state(batch.sensordata).astype(np.float32)
                batch.step(brains.act(state, False))
                events += batch.rules.event(batch.sensordata)
    found = evaluate(wanted)
    np.testing.assert_array_equal(found["events"], events)
    assert found["valid"].all()
    for name, array in brains.weights().items():
        np.testing.assert_array_equal(array, weights[name])


def test_slow_robots_do_not_reach_walls_that_fast_ones_reach(runs):
    """The speed reaches the robots: a thousandth of it covers less than the ten centimetres."""
    crawl = dataclasses.replace(REFERENCE, speed=0.001)
    assert evaluate(job(runs[0], "wall_avoidance", crawl))["events"].sum() == 0
    fast = dataclasses.replace(REFERENCE, speed=2.0)
    assert evaluate(job(runs[0], "wall_avoidance", fast))["events"].sum() > 0


@pytest.fixture
def tracks(monkeypatch):
    """A function that returns where a job's robots went, in tests three times as long."""
    recorded = []

    def record(batch, agent, steps, tick, mode):
        recorded.append(watch(batch, agent, steps, learning=False, tick=tick))
        return recorded[-1].events.sum(axis=0)

    monkeypatch.setattr(rollout, "count_events", record)

    def tracks(*args, **kwargs):
        recorded.clear()
        evaluate(job(*args, **kwargs, time_scale=0.006))
        return np.concatenate([track.poses for track in recorded])

    return tracks


@pytest.mark.parametrize("task", PROPOSERS)
def test_every_perturbation_changes_what_robots_do(runs, tracks, task):
    unchanged = tracks(runs[0], task, REFERENCE)
    for perturbation in PERTURBATIONS[1:]:
        if task in perturbation.tasks:
            found = tracks(runs[0], task, perturbation)
            assert not np.array_equal(found, unchanged), perturbation.name


def test_the_seed_decides_the_ideas(runs, tracks):
    one, again, other = (
        tracks(runs[0], "spot_finding", REFERENCE, seed=seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)


def test_an_evaluation_stops_within_a_simulated_minute_when_asked(runs, tmp_path):
    wanted = job(runs[0], "spot_finding", REFERENCE, time_scale=1.0)
    wanted = dataclasses.replace(wanted, path=tmp_path / "file")
    reports = []
    stopped = wanted.run(lambda: len(reports) == 2, lambda *report: reports.append(report))
    assert stopped is False and not wanted.done()
    assert reports == [(180.0, ""), (360.0, "")]  # robot-seconds
    assert wanted.cost == 3 * 3600


# ---- The study ----


def test_a_study_keeps_every_evaluation_and_continues(runs, tmp_path, here, listing):
    text = conduct(Robustness(runs), tmp_path, here).markdown
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    walls = [one for one in PERTURBATIONS if "wall_avoidance" in one.tasks]
    spots = [one for one in PERTURBATIONS if "spot_finding" in one.tasks]
    assert len(rows) == len(walls) + len(spots) + 4
    assert {line.count("|") for line in rows} == {8}  # a perturbation, and three cells of each run
    assert "all durations times 0.002" in text
    assert len([*tmp_path.glob("*/*.safetensors")]) == 2 * (len(walls) + len(spots))

    before = listing(tmp_path)
    here.jobs.clear()
    (tmp_path / "robustness.md").unlink()
    (tmp_path / "first" / "wall_avoidance-fixed-noise.safetensors").unlink()
    (tmp_path / "second" / ".x.0123456789abcdef.musebot").write_text("half")
    conduct(Robustness(runs), tmp_path, here)
    assert listing(tmp_path) == before
    assert [str(job) for job in here.jobs] == ["first/wall_avoidance-fixed-noise"]


def test_differences_are_of_pairs_and_robots_that_became_unstable_are_left_out():
    reference = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, np.nan])
    found = np.array([0.0, 0.1, 0.3, 0.2, np.nan, 0.4, 0.9])
    share, difference, never = robustness.cells(found, reference)
    assert share.startswith(f"{np.nanmean(found):.4f} [")
    assert difference.startswith(f"{-(0.1 + 0.1 + 0 + 0.2 + 0.2) / 5:+.4f} [")
    assert never == "1 of 6"
    assert robustness.cells(reference, None)[1] == ""
    share, difference, never = robustness.cells(np.zeros(9), np.ones(9))
    # Clopper and Pearson: 1 - 0.025 ** (1 / 9) = 0.336.
    assert share.startswith("0.0000 [0.000, 0.33") and never == "9 of 9"
    assert difference.startswith("-1.0000 [-1.000, -0.5")


def test_the_first_valid_robots_are_evaluated(runs, tmp_path):
    run = read_run(runs[0])
    part = run.results[CONDITIONS[1]]
    broken = dataclasses.replace(part.robots[0], category="invalid", learn_ability=float("nan"))
    results = run.results | {
        CONDITIONS[1]: dataclasses.replace(part, robots=[broken, *part.robots[1:]])
    }
    folder = kept(tmp_path / "run", Run("run", run.experiment, results))
    study = Robustness((folder,))
    assert study.evaluated[0].robots == {CONDITIONS[0]: 3, CONDITIONS[1]: 2}
    chosen = {job.condition: job.rows for job in study.jobs(tmp_path)}
    assert chosen == {CONDITIONS[0]: (0, 1, 2), CONDITIONS[1]: (1, 2)}
    assert Robustness((folder,), robots=1).evaluated[0].robots == dict.fromkeys(CONDITIONS, 1)


def test_only_the_given_proposers_are_evaluated(runs):
    for condition in CONDITIONS:
        (found,) = Robustness(runs[:1], 1, proposer=(condition.proposer,)).evaluated
        assert found.robots == {condition: 1}


def test_the_body_is_the_runs_own_or_the_given_one(runs, tmp_path):
    for body, expected in ((None, "kinematic"), ("mujoco", "mujoco")):
        study = Robustness(runs[:1], 1, body, 7)
        expected = dataclasses.replace(EXPERIMENT, body=expected, seed=7)
        assert study.experiments() == {"first": expected}
    turns = dataclasses.replace(EXPERIMENT, kinematics=Kinematics(wall="turns"))
    run = simulated(tmp_path / "run", turns)
    for body, kinematics in ((None, turns.kinematics), ("mujoco", Kinematics())):
        assert Robustness((run,), body=body).experiments()["run"].kinematics == kinematics


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "robots must be at least 1, got 0"),
        ({"seed": -1}, r"seed must lie in \[0, 2\^63\), got -1"),
        ({"body": "wooden"}, "body must be one of mujoco, kinematic, got 'wooden'"),
        ({"proposer": ("best",)}, "must be one of fixed, random"),
        ({"proposer": ("random",)}, "first has no brain of a random robot"),
        ({"runs": ()}, "at least one run is needed"),
    ],
)
def test_an_invalid_option_is_refused(options, words, runs):
    with pytest.raises(InputError, match=words):
        Robustness(**({"runs": runs} | options)).experiments()


def test_runs_that_cannot_be_in_one_table_are_refused(runs, tmp_path):
    shorter = simulated(tmp_path / "shorter", dataclasses.replace(EXPERIMENT, time_scale=0.001))
    larger = simulated(tmp_path / "larger", dataclasses.replace(EXPERIMENT, arena_scale=1.5))
    for wanted, words in (
        ((runs[0], runs[0]), "runs must have different names, got first, first"),
        ((tmp_path,), "holds no experiment of musebot's"),
        ((larger,), "the run larger has a larger arena, which this study changes"),
        ((runs[0], shorter), "their time scales are 0.001 and 0.002"),
    ):
        with pytest.raises(InputError, match=words):
            Robustness(wanted).experiments()


def test_another_study_of_these_runs_is_refused(runs, tmp_path, here, listing):
    out = tmp_path / "study"
    conduct(Few(runs[:1], robots=2), out, here)
    before = listing(out)
    other = simulated(tmp_path / "other" / "first", dataclasses.replace(EXPERIMENT, seed=3))
    for wanted, options, words in (
        (runs, {"robots": 2}, "holds a study with robots .*first.*, not .*second"),
        (runs[:1], {"robots": 3}, "holds a study with robots .*2.*, not .*3"),
        (runs[:1], {"robots": 2, "seed": 1}, "holds a study of first with seed 0, not 1"),
        (runs[:1], {"robots": 2, "body": "mujoco"}, "with body kinematic, not mujoco"),
        ([other], {"robots": 2}, "holds a study with brains"),
    ):
        with pytest.raises(InputError, match=words):
            conduct(Few(tuple(wanted), **options), out, here)
    assert listing(out) == before


def test_a_missing_file_and_one_of_another_perturbation_are_named(runs, tmp_path, here, listing):
    class Louder(Few):
        perturbations = (REFERENCE, dataclasses.replace(BY_NAME["noise"], noise=0.2))

    conduct(Few(runs[:1]), tmp_path, here)
    before = listing(tmp_path)
    for refused in (conduct, lambda study, out, executor: study.page(out)):
        with pytest.raises(InputError, match="noise.safetensors is another's: its change is"):
            refused(Louder(runs[:1]), tmp_path, here)
    assert listing(tmp_path) == before
    (tmp_path / "first" / "spot_finding-creative-noise.safetensors").unlink()
    with pytest.raises(InputError, match="lacks first/spot_finding-creative-noise"):
        Few(runs[:1]).page(tmp_path)


def test_a_file_of_other_robots_or_of_impossible_counts_is_refused(runs, tmp_path, here):
    study = Few(runs[:1])
    conduct(study, tmp_path, here)
    path = tmp_path / "first" / "spot_finding-creative-noise.safetensors"
    arrays, notes = load_arrays(path)
    for changed, words in (
        ({"condition": "spot_finding/random"}, "is another's: its condition is"),
        ({"brains": "0" * 32}, "is another's: its brains is"),
        ({"seed": 7}, "is another's: its seed is 7, not 0"),
    ):
        save_arrays(path, arrays, **(notes | changed))
        with pytest.raises(InputError, match=words):
            study.page(tmp_path)
    for events in (arrays["events"] - 1000, arrays["events"] + 10**6, arrays["events"][:-1]):
        save_arrays(path, arrays | {"events": events}, **notes)
        with pytest.raises(InputError, match="events must"):
            study.page(tmp_path)
    save_arrays(path, arrays, change=notes["change"])  # as an earlier version
    assert study.page(tmp_path).markdown
