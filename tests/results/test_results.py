"""What a run leaves for its reader: rows, curves and brains that stay together."""

import copy
import csv
import dataclasses
import math
import os
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.protocols.errors import DamagedFileError
from musebot.protocols.experiment.experiment import TASKS, CohortKey, Experiment
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.protocols.results import results as module
from musebot.protocols.results.results import (
    BRAINS,
    CURVES,
    ROBOTS,
    Results,
    Robot,
    collect,
    load,
    merge,
    read_robots,
    save,
)
from musebot.protocols.simulation.cohort import Lives

quick = settings(deadline=None, max_examples=50)
CONDITIONS = [(t, p) for t in TASKS for p in ("fixed", "random", "creative")]
NAN = float("nan")


def same(first, second):
    """Whether two results are equal, NaN equal to NaN."""
    return repr(first.robots) == repr(second.robots) and all(
        one.keys() == other.keys()
        and all(one[k].dtype == other[k].dtype and np.array_equal(one[k], other[k]) for k in one)
        for one, other in ((first.curves, second.curves), (first.brains, second.brains))
    )


def mark(condition, robot, run):
    """A number that tells whose curve or brain a row is, and of which run."""
    return 10_000 * run + 100 * CONDITIONS.index(condition) + robot


def marked(lives, run):
    """Results of robots by condition; rows, curves and brains bear the mark of the run."""
    robots, curves, brains = [], {}, {}
    for condition in CONDITIONS:
        if numbers := sorted(lives.get(condition, ())):
            marks = np.array([mark(condition, n, run) for n in numbers], dtype=np.float32)
            unmeasured = SCHEDULES[condition[0]].unmeasured
            robots += [
                Robot(
                    *condition, run, n, n, 1.0, float(m),
                    *((NAN, unmeasured) if n % 3 == 0 else (-0.5, "L < 0")),
                )
                for n, m in zip(numbers, marks, strict=True)
            ]  # fmt: skip
            name = "/".join(condition)
            curves[name] = np.stack([marks, marks], axis=1)
            for when in ("before", "after"):
                brains[f"{name}/{when}/evaluation.hidden_biases"] = marks[:, None, None] + 0.5
    return Results(robots, curves, brains)


lives = st.dictionaries(
    st.sampled_from(CONDITIONS), st.sets(st.integers(0, 12), min_size=1), max_size=4
)


# Merging


@quick
@given(lives, lives)
def test_merged_results_hold_every_robot_once_in_the_tables_order(older, newer):
    merged = merge(marked(older, 1), marked(newer, 2))
    wanted = [
        (*condition, robot)
        for condition in CONDITIONS
        for robot in sorted(older.get(condition, set()) | newer.get(condition, set()))
    ]
    assert [(r.task, r.proposer, r.robot) for r in merged.robots] == wanted
    assert merged.conditions() == [c for c in CONDITIONS if c in older or c in newer]


@quick
@given(lives, lives)
def test_a_robot_that_both_have_is_taken_whole_from_the_older(older, newer):
    merged = merge(marked(older, 1), marked(newer, 2))
    for condition in merged.conditions():
        rows = merged.of(*condition)
        marks = []
        for row in rows:
            assert row.seed == (1 if row.robot in older.get(condition, ()) else 2)
            marks.append(mark(condition, row.robot, row.seed))
        assert [row.t_post_s for row in rows] == marks
        name = "/".join(condition)
        assert merged.curves[name].tolist() == [[m, m] for m in marks]
        for when in ("before", "after"):
            brains = merged.brains[f"{name}/{when}/evaluation.hidden_biases"]
            assert brains.tolist() == [[[m + 0.5]] for m in marks]
    names = {"/".join(condition) for condition in merged.conditions()}
    assert merged.curves.keys() == names
    assert {name.rsplit("/", 2)[0] for name in merged.brains} == names


@quick
@given(lives)
def test_merging_with_nothing_or_with_itself_changes_nothing(some):
    results, nothing = marked(some, 1), Results([], {}, {})
    assert same(merge(results, nothing), results)
    assert same(merge(nothing, results), results)
    assert same(merge(results, results), results)


@quick
@given(lives, lives, lives)
def test_it_does_not_matter_in_how_many_steps_lives_are_added(first, second, third):
    a, b, c = marked(first, 1), marked(second, 2), marked(third, 3)
    assert same(merge(merge(a, b), c), merge(a, merge(b, c)))


@quick
@given(lives, lives)
def test_merging_leaves_its_arguments_alone(older, newer):
    results = marked(older, 1), marked(newer, 2)
    before = copy.deepcopy(results)
    merge(*results)
    assert all(same(*pair) for pair in zip(results, before, strict=True))


# Collecting

SHORT = Experiment(seed=9, cohort_size=2, time_scale=0.011)  # 1,056 steps: 1.76 minutes


def lived(pre, post, valid=(True, True), minutes=None, brain=0.0):
    events = np.array([pre, (0, 0), post]).T
    minutes = np.zeros((2, 2), dtype=np.int16) if minutes is None else np.array(minutes)
    networks = {"evaluation.output_biases": np.full((2, 1), brain, dtype=np.float32)}
    after = {name: array + 0.5 for name, array in networks.items()}
    return Lives(events.astype(np.int32), minutes, np.array(valid), networks, after)


def test_finished_cohorts_become_rows():
    results = collect(
        SHORT,
        [
            (CohortKey("wall_avoidance", "random", 1), lived((30, 0), (10, 0))),
            (CohortKey("wall_avoidance", "random", 0), lived((7, 9), (0, 9), (True, False))),
            (CohortKey("spot_finding", "random", 0), lived((0, 30), (0, 10))),
            (CohortKey("wall_avoidance", "fixed", 0), lived((0, 5), (3, 5))),
        ],
    )
    assert [dataclasses.astuple(r)[:-2] for r in results.robots] == [
        ("wall_avoidance", "fixed", 9, 0, 0, 0.0, 0.3),
        ("wall_avoidance", "fixed", 9, 0, 1, 0.5, 0.5),
        ("wall_avoidance", "random", 9, 0, 0, 0.7, 0.0),
        ("wall_avoidance", "random", 9, 0, 1, 0.9, 0.9),
        ("wall_avoidance", "random", 9, 1, 2, 3.0, 1.0),
        ("wall_avoidance", "random", 9, 1, 3, 0.0, 0.0),
        ("spot_finding", "random", 9, 0, 0, 0.0, 0.0),
        ("spot_finding", "random", 9, 0, 1, 3.0, 1.0),
    ]
    abilities = [r.learn_ability for r in results.robots]
    assert abilities == pytest.approx([-1, 0, 1, NAN, 0.5, NAN, NAN, -0.5], nan_ok=True)
    assert [r.category for r in results.robots] == [
        *("L < 0", "L = 0", "L = 1", "invalid", "0 < L < 1", "genius", "ignorant", "L < 0")
    ]


def test_curves_are_shares_of_each_minute_even_of_a_last_one_cut_short():
    steps = sum(SHORT.schedule("wall_avoidance").steps())
    assert 600 < steps < 1200
    minutes = [[600, steps - 600], [150, 0]]
    key = CohortKey("wall_avoidance", "fixed", 0)
    results = collect(SHORT, [(key, lived((0, 0), (0, 0), minutes=minutes))])
    np.testing.assert_allclose(results.curves["wall_avoidance/fixed"], [[1, 1], [0.25, 0]])


def test_curves_and_brains_of_cohorts_stand_in_the_order_of_their_rows():
    results = collect(
        SHORT,
        [
            (
                CohortKey("wall_avoidance", "fixed", index),
                lived((0, 0), (0, 0), minutes=[[60 * index, 0], [60 * index, 0]], brain=index),
            )
            for index in (2, 0, 1)
        ],
    )
    assert [robot.robot for robot in results.robots] == [0, 1, 2, 3, 4, 5]
    curves = results.curves["wall_avoidance/fixed"]
    np.testing.assert_allclose(curves[:, 0], [0, 0, 0.1, 0.1, 0.2, 0.2], rtol=1e-6)
    assert results.brains.keys() == {
        f"wall_avoidance/fixed/{when}/evaluation.output_biases" for when in ("before", "after")
    }
    for when, more in (("before", 0), ("after", 0.5)):
        brains = results.brains[f"wall_avoidance/fixed/{when}/evaluation.output_biases"]
        assert brains[:, 0].tolist() == [n + more for n in (0, 0, 1, 1, 2, 2)]


def test_the_test_after_training_lasts_20_minutes_or_an_hour():
    assert module.test_seconds(Experiment(), "wall_avoidance") == pytest.approx(20 * 60)
    assert module.test_seconds(Experiment(), "spot_finding") == pytest.approx(60 * 60)
    half = Experiment(time_scale=0.5)
    assert module.test_seconds(half, "spot_finding") == pytest.approx(30 * 60)


def test_a_summary_counts_invalid_lives_and_leaves_them_out():
    experiment = Experiment(cohort_size=2)
    results = collect(
        experiment,
        [
            (CohortKey("wall_avoidance", "fixed", 0), lived((30, 9), (10, 9000), (True, False))),
            (CohortKey("wall_avoidance", "fixed", 1), lived((30, 0), (0, 0))),
            (CohortKey("wall_avoidance", "random", 0), lived((5, 5), (9, 9))),
            (CohortKey("spot_finding", "fixed", 0), lived((5, 5), (9, 9))),
        ],
    )
    summary = results.summary(experiment, "wall_avoidance", "fixed")
    assert summary.counts == (1, 1, 0, 0, 1)
    assert summary.invalid == 1
    assert summary.mean == pytest.approx(0.75)
    assert summary.post_share == pytest.approx(1.0 / 3 / 1200)


# Files


@pytest.fixture
def results():
    rows = [
        Robot("wall_avoidance", "fixed", 1, 0, 0, 12.5, 0.0, 1.0, "L = 1"),
        Robot("wall_avoidance", "fixed", 1, 0, 1, 0.0, 0.0, NAN, "genius"),
        Robot("wall_avoidance", "fixed", 1, 1, 2, 0.3, 0.1, 0.5, "0 < L < 1"),
        Robot("spot_finding", "creative", 1, 0, 0, 0.0, 0.0, NAN, "ignorant"),
        Robot("spot_finding", "creative", 1, 0, 1, 0.1, 0.2, 1 / 3, "0 < L < 1"),
        Robot("spot_finding", "creative", 1, 1, 2, 7.0, 0.0, NAN, "invalid"),
    ]
    draw = np.random.default_rng(0)
    names = ["wall_avoidance/fixed", "spot_finding/creative"]
    curves = {name: draw.random((3, 20), dtype=np.float32) for name in names}
    brains = {
        f"{name}/{when}/evaluation.output_weights": draw.random((3, 1, 7), dtype=np.float32)
        for name in names
        for when in ("before", "after")
    }
    return Results(rows, curves, brains)


@pytest.fixture
def folder(tmp_path, results):
    save(tmp_path, results)
    return tmp_path


def test_results_come_back_from_their_files_as_they_were(folder, results):
    assert {path.name for path in folder.iterdir()} == {ROBOTS, CURVES, BRAINS}
    assert same(load(folder), results)


def test_equal_results_leave_equal_bytes_however_they_were_put_together(tmp_path):
    first, second = ({condition: {0, 1}} for condition in CONDITIONS[::5])
    pair = marked(first, 1), marked(second, 1)
    save(tmp_path / "one", merge(*pair))
    save(tmp_path / "two", merge(*reversed(pair)))
    for name in (ROBOTS, CURVES, BRAINS):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@st.composite
def any_robot(draw):
    """A row, of the category that its L has, or invalid."""
    task = draw(st.sampled_from(TASKS))
    seconds = st.integers(0, 216_000).map(lambda steps: round(steps * 0.1, 1))
    ability = draw(st.just(NAN) | st.floats(-1, 1))
    return Robot(
        task,
        draw(st.sampled_from(["fixed", "random", "creative"])),
        draw(st.integers(0, 2**64)),
        draw(st.integers(0, 100)),
        draw(st.integers(0, 10_000)),
        draw(seconds),
        draw(seconds),
        ability,
        draw(st.sampled_from([module.category_in(task, ability), "invalid"])),
    )


@quick
@given(st.lists(any_robot(), max_size=5))
def test_robots_csv_gives_back_every_row(tmp_path_factory, rows):
    folder = tmp_path_factory.mktemp("results")
    save(folder, Results(rows, {}, {}))
    assert repr(read_robots(folder / ROBOTS)) == repr(rows)


def test_robots_csv_is_a_plain_table(folder):
    with (folder / ROBOTS).open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        *("task", "proposer", "seed", "cohort", "robot"),
        *("t_pre_s", "t_post_s", "learn_ability", "category"),
    ]
    assert rows[0]["t_pre_s"] == "12.5"
    assert [row["learn_ability"] for row in rows[:3]] == ["1.0", "", "0.5"]


def test_a_folder_without_robots_csv_holds_no_lives_yet(tmp_path, folder):
    (folder / ROBOTS).unlink()
    assert load(folder) == Results([], {}, {})


@pytest.mark.parametrize("name", [CURVES, BRAINS])
def test_a_folder_that_lacks_a_file_is_damaged(folder, name):
    (folder / name).unlink()
    with pytest.raises(DamagedFileError, match=name):
        load(folder)


@pytest.mark.parametrize("name", [CURVES, BRAINS])
def test_a_truncated_file_is_damaged_and_named(folder, name):
    path = folder / name
    whole = path.read_bytes()
    for length in range(0, len(whole), 13):
        path.write_bytes(whole[:length])
        with pytest.raises(DamagedFileError) as caught:
            load(folder)
        assert str(path) in str(caught.value)


def test_robots_csv_truncated_within_a_row_is_damaged_and_named(folder):
    path = folder / ROBOTS
    whole = path.read_bytes()
    for length in range(len(whole)):
        # A table cut between rows reads like one that was written earlier, and is one.
        if whole[:length].endswith(b"\n") or whole[length : length + 1] == b"\n":
            continue
        path.write_bytes(whole[:length])
        with pytest.raises(DamagedFileError) as caught:
            load(folder)
        assert str(path) in str(caught.value)


def flips(path, every):
    """Writes the file again and again, with one bit flipped; restores it in the end."""
    whole = path.read_bytes()
    bits = random.Random(0)
    for index in range(0, len(whole), every):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << bits.randrange(8)
        path.write_bytes(flipped)
        yield
    path.write_bytes(whole)


@pytest.mark.parametrize(("name", "every"), [(CURVES, 1), (BRAINS, 7)])
def test_a_flipped_bit_does_no_harm_or_is_named(folder, results, name, every):
    named = 0
    for _ in flips(folder / name, every):
        try:
            assert same(load(folder), results)  # a date in the archive, for instance
        except DamagedFileError as error:
            assert str(folder / name) in str(error)
            named += 1
    assert named > 100


def test_curves_whose_shape_was_altered_are_damage_though_numpy_could_read_them(folder, results):
    long = {name: np.tile(array, 100) for name, array in results.curves.items()}
    np.savez(folder / CURVES, **long)
    assert load(folder).curves["wall_avoidance/fixed"].shape == (3, 2000)
    altered = (folder / CURVES).read_bytes().replace(b"(3, 2000)", b"(3, 1000)")
    (folder / CURVES).write_bytes(altered)
    assert np.load(folder / CURVES)["wall_avoidance/fixed"].shape == (3, 1000)
    with pytest.raises(DamagedFileError, match=CURVES):
        load(folder)


def test_a_flipped_bit_in_robots_csv_ends_in_results_or_is_named(folder):
    named = 0
    for _ in flips(folder / ROBOTS, 1):
        try:
            assert isinstance(load(folder), Results)  # digits are as good as others
        except DamagedFileError as error:
            assert str(folder) in str(error)
            named += 1
    assert named > 100


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("wall_avoidance,fixed", "swimming,fixed"),
        ("wall_avoidance,fixed", "wall_avoidance,divine"),
        ("genius", "genie"),
        ("genius", "ignorant"),
        ("12.5", "long"),
        (",genius", ""),
        ("12.5,0.0,1.0,L = 1", "12.5,0.0,0.9,L = 1"),
        ("genius", "genius,"),
        ("t_pre_s", "t_pre"),
    ],
)
def test_a_robots_csv_with_something_strange_in_it_is_damaged_and_named(folder, old, new):
    path = folder / ROBOTS
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(DamagedFileError) as caught:
        load(folder)
    assert str(path) in str(caught.value)


def test_a_crash_before_robots_csv_was_written_leaves_the_older_lives(folder, results):
    before = (folder / ROBOTS).read_bytes()
    key = ("spot_finding", "random")
    newer = marked({("wall_avoidance", "fixed"): {3, 4}, key: {0}}, run=2)
    newer.curves = {name: np.tile(array, 10) for name, array in newer.curves.items()}
    newer.brains = {
        name.replace("hidden_biases", "output_weights"): np.tile(array, 7)
        for name, array in newer.brains.items()
    }
    save(folder, merge(results, newer))
    assert len(load(folder).robots) == 9
    (folder / ROBOTS).write_bytes(before)
    assert same(load(folder), results)


@pytest.mark.parametrize("lacking", ["curves", "brains"])
def test_fewer_curves_or_brains_than_rows_are_damage(tmp_path, results, lacking):
    arrays = getattr(results, lacking)
    arrays[next(iter(arrays))] = next(iter(arrays.values()))[:2]
    save(tmp_path, results)
    with pytest.raises(DamagedFileError, match="fewer lives"):
        load(tmp_path)


def test_rows_without_any_curve_are_damage(tmp_path, results):
    del results.curves["spot_finding/creative"]
    save(tmp_path, results)
    with pytest.raises(DamagedFileError, match="lacks spot_finding/creative"):
        load(tmp_path)


@pytest.mark.parametrize("failing", [1, 2, 3])
def test_a_failed_save_leaves_a_folder_that_can_be_read(folder, results, monkeypatch, failing):
    calls = 0
    fsync = os.fsync

    def sometimes(descriptor):
        nonlocal calls
        calls += 1
        if calls == failing:
            raise OSError(28, "No space left on device")
        fsync(descriptor)

    newer = marked({("spot_finding", "random"): {0, 1}}, run=2)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", sometimes)
        with pytest.raises(OSError, match="No space left"):
            save(folder, merge(results, newer))
    assert same(load(folder), results)
    assert {path.name for path in folder.iterdir()} == {ROBOTS, CURVES, BRAINS}


def test_learn_ability_survives_robots_csv_to_the_last_bit(tmp_path):
    ability = math.nextafter(1 / 3, 1)
    row = Robot("spot_finding", "fixed", 1, 0, 0, 1.0, 2.0, ability, "0 < L < 1")
    save(tmp_path, Results([row], {}, {}))
    assert read_robots(tmp_path / ROBOTS)[0].learn_ability == ability
