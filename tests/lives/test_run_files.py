"""The files of a run: what is written comes back, and damage is named."""

import csv
import dataclasses
import hashlib
import json
import math
import os
import random
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers import same_results
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.lives import run_files
from musebot.protocols.lives.agent import network_shapes
from musebot.protocols.lives.conditions import PAPER_TASKS, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.learn_ability import learn_ability
from musebot.protocols.lives.manifest import (
    MANIFEST,
    read_manifest,
    recorded_files,
    write_manifest,
)
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import WHEN, Robot, category_in, merge
from musebot.protocols.lives.run_files import (
    BRAINS_FILE,
    CURVES_FILE,
    ROBOTS_FILE,
    adopt_files,
    flat_networks,
    is_kept_without_brains,
    planned,
    read_results,
    read_robots,
    read_run,
    read_runs,
    read_so_far,
    run_names,
    write_results,
)
from musebot.protocols.storage import write_json

quick = settings(deadline=None, max_examples=50)
FILES = {ROBOTS_FILE, CURVES_FILE, BRAINS_FILE}
NAN = float("nan")
WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
OTHER = Condition("spot_finding", "random")
KEPT = Path(__file__).parents[2] / "docs" / "results"


EXPERIMENT = Experiment(seed=1, cohort_size=1, time_scale=0.05)
PLAN = Plan(EXPERIMENT, {WALLS: 5, OTHER: 3, SPOT: 3})


def rows_of(condition, numbers):
    name, ability = (condition.task, condition.proposer), -0.5 if condition == WALLS else 0.5
    kind = "L < 0" if ability < 0 else "0 < L < 1"
    return [Robot(*name, 1, n, n, 1.0, 3.0, ability, kind) for n in numbers]


@pytest.fixture(scope="module")
def part_of(invented):
    """Makes results of rows, with curves and networks to match."""

    def part_of(rows, seed=0):
        return invented(EXPERIMENT, rows, seed)

    return part_of


@pytest.fixture
def results(part_of):
    walls = [
        Robot("wall_avoidance", "fixed", 1, 0, 0, 12.5, 0.0, 1.0, "L = 1"),
        Robot("wall_avoidance", "fixed", 1, 1, 1, 0.0, 0.0, NAN, "genius"),
        Robot("wall_avoidance", "fixed", 1, 2, 2, 0.3, 0.1, 0.5, "0 < L < 1"),
    ]
    spot = [
        Robot("spot_finding", "creative", 1, 0, 0, 0.0, 0.0, NAN, "ignorant"),
        Robot("spot_finding", "creative", 1, 1, 1, 0.1, 0.2, 1 / 3, "0 < L < 1"),
        Robot("spot_finding", "creative", 1, 2, 2, 7.0, 0.0, NAN, "invalid"),
    ]
    return {WALLS: part_of(walls, seed=1), SPOT: part_of(spot, seed=2)}


@pytest.fixture
def folder(tmp_path, results):
    write_manifest(tmp_path, PLAN)
    write_results(tmp_path, results)
    return tmp_path


# Writing and reading


def test_results_survive_their_files(folder, results):
    assert {path.name for path in folder.iterdir()} == {*FILES, MANIFEST}
    assert same_results(read_results(folder), results)


def test_results_of_an_agent_without_weights_survive_their_files(tmp_path, part_of):
    agent = Condition("wall_avoidance", "some.where:agent")
    part = part_of(rows_of(agent, (0, 1)))
    part = part_of(
        [dataclasses.replace(r, learn_ability=-0.5, category="L < 0") for r in part.robots]
    )
    assert part.networks == {"before": {}, "after": {}}
    write_manifest(tmp_path, Plan(EXPERIMENT, {agent: 2}))
    write_results(tmp_path, {agent: part})
    assert same_results(read_results(tmp_path), {agent: part})


def test_equal_results_leave_equal_bytes_however_they_were_merged(tmp_path, part_of):
    first = {WALLS: part_of(rows_of(WALLS, (0, 1)), seed=1)}
    second = {OTHER: part_of(rows_of(OTHER, (0, 1)), seed=2)}
    write_manifest(tmp_path / "one", PLAN)
    write_manifest(tmp_path / "two", PLAN)
    write_results(tmp_path / "one", merge(first, second))
    write_results(tmp_path / "two", merge(second, first))
    for name in FILES:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.parametrize("name", ["mujoco", "ppo-mujoco"])
def test_a_kept_run_that_is_read_and_written_keeps_its_bytes(name, tmp_path):
    write_manifest(tmp_path, read_manifest(KEPT / name))
    write_results(tmp_path, read_results(KEPT / name))
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, MANIFEST}
    for file in FILES:
        assert (tmp_path / file).read_bytes() == (KEPT / name / file).read_bytes(), file


@st.composite
def any_robot(draw, task, index):
    """Draws a row as `collect` makes it."""
    schedule = EXPERIMENT.schedule(task)
    steps = [draw(st.integers(0, schedule.steps_of(part))) for part in ("pre", "post")]
    pre, post = (np.array([count]) * 0.1 for count in steps)
    ability = float(learn_ability(pre, post, schedule.wanted)[0])
    name = category_in(task, ability)
    if draw(st.booleans()):
        ability, name = NAN, "invalid"
    times = round(float(pre[0]), 1), round(float(post[0]), 1)
    return Robot(task, "random", 1, index, index, *times, ability, name)


@quick
@given(st.data(), st.sampled_from(PAPER_TASKS), st.integers(1, 5))
def test_every_row_that_a_cohort_can_leave_is_read_as_it_was(
    tmp_path_factory, part_of, data, task, count
):
    folder, condition = tmp_path_factory.mktemp("results"), Condition(task, "random")
    results = {condition: part_of([data.draw(any_robot(task, index)) for index in range(count)])}
    write_manifest(folder, Plan(EXPERIMENT, {condition: count}))
    write_results(folder, results)
    assert same_results(read_results(folder), results)


def test_robots_csv_is_a_plain_table(folder):
    with (folder / ROBOTS_FILE).open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        *("task", "proposer", "seed", "cohort", "robot"),
        *("t_pre_s", "t_post_s", "learn_ability", "category"),
    ]
    assert rows[0]["t_pre_s"] == "12.5"
    assert [row["learn_ability"] for row in rows[:3]] == ["1.0", "", "0.5"]


def test_learn_ability_survives_robots_csv_bit_exactly(tmp_path, part_of):
    condition, ability = Condition("spot_finding", "fixed"), math.nextafter(1 / 3, 1)
    row = Robot("spot_finding", "fixed", 1, 0, 0, 1.0, 2.0, ability, "0 < L < 1")
    plan = Plan(EXPERIMENT, {condition: 1})
    write_manifest(tmp_path, plan)
    write_results(tmp_path, {condition: part_of([row])})
    assert read_robots(tmp_path / ROBOTS_FILE, plan)[condition][0].learn_ability == ability


def test_networks_are_named_by_condition_time_and_tensor(results):
    flat = flat_networks(results)
    names = {c: [*network_shapes(EXPERIMENT, c)] for c in (WALLS, SPOT)}
    assert [*flat] == [f"{c}/{w}/{n}" for c in (WALLS, SPOT) for w in WHEN for n in names[c]]
    assert flat["spot_finding/creative/after/evaluation.output_weights"].shape == (3, 1, 7)
    after = [f"{c}/after/{n}" for c in (WALLS, SPOT) for n in names[c]]
    assert [*flat_networks(results, ["after"])] == after


def test_a_folder_without_robots_csv_holds_no_results_yet(folder):
    (folder / ROBOTS_FILE).unlink()
    assert read_results(folder) == {}


# Damage


@pytest.mark.parametrize("name", [CURVES_FILE, BRAINS_FILE])
def test_a_folder_that_lacks_a_file_is_damaged(folder, name):
    (folder / name).unlink()
    with pytest.raises(DamagedFileError, match=name):
        read_results(folder)


@pytest.mark.parametrize("name", [CURVES_FILE, BRAINS_FILE])
def test_a_truncated_file_is_damaged_and_named(folder, name):
    path = folder / name
    whole = path.read_bytes()
    for length in range(0, len(whole), 13):
        path.write_bytes(whole[:length])
        with pytest.raises(DamagedFileError) as caught:
            read_results(folder)
        assert str(path) in str(caught.value)


def test_robots_csv_truncated_within_a_row_is_damaged_and_named(folder):
    path = folder / ROBOTS_FILE
    whole = path.read_bytes()
    for length in range(len(whole)):
        # A table cut between rows reads like one that was written earlier, and is one.
        if whole[:length].endswith(b"\n") or whole[length : length + 1] == b"\n":
            continue
        path.write_bytes(whole[:length])
        with pytest.raises(DamagedFileError) as caught:
            read_results(folder)
        assert str(path) in str(caught.value)


def flips(path, every):
    """Writes a file again and again, with one bit flipped; restores it in the end."""
    whole = path.read_bytes()
    bits = random.Random(0)
    for index in range(0, len(whole), every):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << bits.randrange(8)
        path.write_bytes(flipped)
        yield
    path.write_bytes(whole)


@pytest.mark.parametrize(("name", "every"), [(CURVES_FILE, 1), (BRAINS_FILE, 7)])
def test_a_flipped_bit_has_no_effect_or_is_named(folder, results, name, every, without_digests):
    without_digests(folder)
    named = 0
    for _ in flips(folder / name, every):
        try:
            # A date in the archive, for instance.
            assert same_results(read_results(folder), results)
        except DamagedFileError as error:
            assert str(folder / name) in str(error)
            named += 1
    assert named > 100


@pytest.mark.parametrize("name", [ROBOTS_FILE, CURVES_FILE, BRAINS_FILE])
def test_every_flipped_bit_of_a_file_with_a_digest_is_noticed(folder, name):
    for _ in flips(folder / name, 29):
        with pytest.raises(DamagedFileError):
            read_results(folder)


def test_curves_whose_shape_was_altered_are_damaged(folder, results, without_digests):
    without_digests(folder)
    curves = {str(condition): part.curves for condition, part in results.items()}
    np.savez(folder / CURVES_FILE, **curves)
    assert read_results(folder)[WALLS].curves.shape == (3, 8)
    altered = (folder / CURVES_FILE).read_bytes().replace(b"(3, 8)", b"(2, 8)")
    (folder / CURVES_FILE).write_bytes(altered)
    with pytest.raises(DamagedFileError, match=CURVES_FILE):
        read_results(folder)


def test_a_flipped_bit_in_robots_csv_ends_in_results_or_is_named(folder, without_digests):
    without_digests(folder)

    def rows():
        """The rows, without the last digits of Learn Ability, which are not checked."""
        return [
            dataclasses.replace(row, learn_ability=round(row.learn_ability, 6))
            for part in read_results(folder).values()
            for row in part.robots
        ]

    named, true = 0, repr(rows())
    for _ in flips(folder / ROBOTS_FILE, 1):
        try:
            assert repr(rows()) == true
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
        ("genius", '"genius'),
    ],
)
def test_a_robots_csv_with_an_invalid_cell_is_damaged_and_named(folder, old, new):
    path = folder / ROBOTS_FILE
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(DamagedFileError) as caught:
        read_results(folder)
    assert str(path) in str(caught.value)


def test_a_crash_before_robots_csv_was_written_leaves_the_older_results(folder, results, part_of):
    before = (folder / ROBOTS_FILE).read_bytes()
    newer = {
        WALLS: part_of(rows_of(WALLS, (3, 4)), seed=3),
        OTHER: part_of(rows_of(OTHER, (0,)), seed=4),
    }
    write_results(folder, merge(results, newer))
    assert sum(len(part.robots) for part in read_results(folder).values()) == 9
    (folder / ROBOTS_FILE).write_bytes(before)
    assert same_results(read_results(folder), results)


# Digests


def refusal(folder, name):
    with pytest.raises(DamagedFileError) as caught:
        read_run(folder)
    text = str(caught.value)
    assert str(folder / name) in text and "\n" not in text
    return text


def digests(folder, names=FILES):
    found = {n: hashlib.sha256((folder / n).read_bytes()).hexdigest() for n in names}
    assert [*recorded_files(folder)[-1]] == [BRAINS_FILE, CURVES_FILE, ROBOTS_FILE]
    return found


def test_the_manifest_has_the_sha256_of_every_file(folder):
    assert recorded_files(folder) == [digests(folder)]


@pytest.mark.parametrize("name", [ROBOTS_FILE, CURVES_FILE, BRAINS_FILE])
def test_a_file_of_another_run_with_the_same_plan_is_refused_and_named(
    folder, results, part_of, tmp_path_factory, name
):
    other = tmp_path_factory.mktemp("other")
    write_manifest(other, PLAN)
    walls = [dataclasses.replace(row, seed=1) for row in results[WALLS].robots[::-1]]
    walls = [dataclasses.replace(row, robot=n, cohort=n) for n, row in enumerate(walls)]
    write_results(other, {WALLS: part_of(walls, seed=7), SPOT: part_of(results[SPOT].robots, 8)})
    read_run(other)
    (folder / name).write_bytes((other / name).read_bytes())
    refusal(folder, name)


def test_brains_of_another_run_are_refused_by_their_digest_alone(
    folder, results, part_of, without_digests, tmp_path_factory
):
    other = tmp_path_factory.mktemp("other")
    write_manifest(other, PLAN)
    write_results(other, {c: part_of(part.robots, seed=9) for c, part in results.items()})
    (folder / BRAINS_FILE).write_bytes((other / BRAINS_FILE).read_bytes())
    assert "is not the file that musebot wrote for this run" in refusal(folder, BRAINS_FILE)
    without_digests(folder)
    read_run(folder)


def test_an_edited_robots_csv_that_contradicts_nothing_is_refused(folder):
    text = (folder / ROBOTS_FILE).read_text()
    (folder / ROBOTS_FILE).write_text(text.replace("0.3333333333333333", "0.33333333333333334"))
    assert "is not the file that musebot wrote" in refusal(folder, ROBOTS_FILE)


def test_an_edited_manifest_is_refused(folder):
    text = (folder / MANIFEST).read_text()
    (folder / MANIFEST).write_text(text.replace('"python": "', '"python": "1'))
    assert "was changed after musebot had written it" in refusal(folder, MANIFEST)


def test_digests_that_are_none_are_damage(folder):
    for files in ([1], "x", [["a"]]):
        write_json(
            folder / MANIFEST, json.loads((folder / MANIFEST).read_text()) | {"files": files}
        )
        refusal(folder, MANIFEST)


def test_a_run_without_digests_is_read_with_a_warning_until_they_are_adopted(
    folder, results, without_digests, capsys
):
    without_digests(folder)
    before = {name: (folder / name).read_bytes() for name in FILES}
    assert same_results(read_run(folder).results, results)
    assert f"{folder} has no digests of its files" in capsys.readouterr().err
    adopt_files(folder)
    assert same_results(read_run(folder).results, results)
    assert capsys.readouterr().err == ""
    assert recorded_files(folder) == [digests(folder)]
    assert {name: (folder / name).read_bytes() for name in FILES} == before


@pytest.mark.parametrize(
    "manifest", sorted(KEPT.rglob(MANIFEST)), ids=lambda path: str(path.parent.relative_to(KEPT))
)
def test_the_digests_of_a_kept_run_are_recorded(manifest):
    # A run of an earlier version gets them by `adopt_files`.
    *_, recorded = recorded_files(manifest.parent)  # a run that was enlarged has earlier ones
    kept = [name for name in FILES if (manifest.parent / name).exists()]
    # Some runs are kept without brains, or as rows alone, if their pages need no more.
    of_benchmark = (manifest.parents[1] / "benchmark.md").exists()
    rows_and_curves = ("ppo-", "baselines", "cells-", "evolve-", "steady-again", "kinematic-walls")
    with_curves = of_benchmark or manifest.parent.name.startswith(rows_and_curves)
    less = {ROBOTS_FILE, CURVES_FILE} if with_curves else {ROBOTS_FILE}
    assert {*kept} in (less, {*FILES})
    assert {name: recorded[name] for name in kept} == digests(manifest.parent, kept)


@pytest.mark.parametrize("older", [False, True])
def test_every_mixture_that_a_killed_enlargement_leaves_is_read(
    folder, results, part_of, monkeypatch, without_digests, older
):
    if older:
        without_digests(folder)
    newer = merge(results, {OTHER: part_of(rows_of(OTHER, (0, 1)), seed=4)})
    written, seen = run_files.write_atomically, []

    def look(path, content):
        written(path, content)
        seen.append(len(read_run(folder).conditions()))

    monkeypatch.setattr(run_files, "write_atomically", look)
    write_results(folder, newer)
    assert seen == [2, 2, 3]
    assert len(recorded_files(folder)) == 2


@pytest.mark.parametrize("shorter", ["curves", "networks"])
def test_fewer_curves_or_networks_than_rows_are_damage(folder, results, shorter):
    part = results[WALLS]
    cut = part.rows(np.array([0, 1]))
    fewer = dataclasses.replace(part, **{shorter: getattr(cut, shorter)})
    write_results(folder, results | {WALLS: fewer})
    with pytest.raises(DamagedFileError, match="fewer robots"):
        read_results(folder)


def test_rows_without_any_curve_are_damage(folder, results, without_digests):
    without_digests(folder)
    np.savez_compressed(folder / CURVES_FILE, **{str(WALLS): results[WALLS].curves})
    with pytest.raises(DamagedFileError, match="lacks spot_finding/creative"):
        read_results(folder)


@pytest.mark.parametrize("failing", [1, 2, 3])
def test_a_failed_write_leaves_a_folder_that_can_be_read(
    folder, results, part_of, monkeypatch, failing
):
    calls = 0
    fsync = os.fsync

    def sometimes(descriptor):
        nonlocal calls
        calls += 1
        if calls == failing:
            raise OSError(28, "No space left on device")
        fsync(descriptor)

    newer = {OTHER: part_of(rows_of(OTHER, (0, 1)), seed=4)}
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", sometimes)
        with pytest.raises(OSError, match="No space left"):
            write_results(folder, merge(results, newer))
    assert same_results(read_results(folder), results)
    assert {path.name for path in folder.iterdir()} == {*FILES, MANIFEST}


# Runs


def test_a_run_is_read_with_the_name_of_its_folder_or_a_given_one(folder, results):
    run = read_run(folder)
    assert (run.name, run.experiment) == (folder.name, EXPERIMENT)
    assert same_results(run.results, results)
    assert read_run(folder, "mine").name == "mine"


@pytest.mark.parametrize("read", [read_run, read_so_far])
def test_a_folder_without_a_run_is_refused(tmp_path, read):
    with pytest.raises(InputError) as caught:
        read(tmp_path)
    assert str(caught.value) == f"{tmp_path} holds no experiment of musebot's"
    for name in ("paper", "steady"):
        (tmp_path / name).mkdir()
        (tmp_path / name / MANIFEST).write_text("{}")
    with pytest.raises(InputError, match="musebot's; it has the runs paper, steady$"):
        read(tmp_path)
    with pytest.raises(InputError, match=f"^there is no folder {tmp_path / 'nothing'}$"):
        read(tmp_path / "nothing")


def test_rows_are_read_without_the_other_files(folder, results):
    for name in (CURVES_FILE, BRAINS_FILE):
        (folder / name).unlink()
    run = read_so_far(folder, "rows")
    for condition, part in results.items():
        assert repr(run.robots(condition)) == repr(part.robots)
        assert run.results[condition].curves.shape == (len(part.robots), 0)


def test_curves_of_another_version_of_the_format_are_damaged(folder, results, without_digests):
    without_digests(folder)
    with zipfile.ZipFile(folder / CURVES_FILE, "w") as archive:
        for condition, part in results.items():
            with archive.open(f"{condition}.npy", "w") as file:
                np.lib.format.write_array(file, part.curves, version=(2, 0))
    with pytest.raises(DamagedFileError, match="another version of numpy's format"):
        read_results(folder)


def test_a_run_without_finished_robots_is_refused(tmp_path):
    write_manifest(tmp_path, PLAN)
    with pytest.raises(InputError) as caught:
        read_run(tmp_path)
    sentence = f"{tmp_path} holds no finished robots yet; `musebot run {tmp_path}` continues it"
    assert str(caught.value) == sentence


def test_brains_of_another_physics_are_read_with_a_notice(folder, capsys):
    read_run(folder, replay=True)
    assert capsys.readouterr().err == ""
    content = json.loads((folder / MANIFEST).read_text())
    content["physics"][0] += 1
    write_json(folder / MANIFEST, content)
    read_run(folder)
    assert capsys.readouterr().err == ""
    read_run(folder, replay=True)
    notice = capsys.readouterr().err
    assert f"{folder} was simulated in another physics than this version's" in notice


def test_several_runs_have_distinct_names(tmp_path, results):
    folders = [tmp_path / name for name in ("a/run", "b/run", "b/other")]
    for folder in folders:
        write_manifest(folder, PLAN)
        write_results(folder, results)
    assert [run.name for run in read_runs(folders[1:])] == ["run", "other"]
    assert [run.name for run in read_runs(folders[:2])] == ["a/run", "b/run"]
    assert run_names([folders[0], folders[0].parent / "run"]) == [str(folders[0])] * 2
    with pytest.raises(InputError, match="a run is given twice"):
        read_runs([folders[0], folders[0].parent / ".." / "a" / "run"])
    with pytest.raises(InputError, match="at least one run is needed"):
        read_runs([])


def test_a_folder_can_hold_a_new_run_or_holds_one(tmp_path):
    assert planned(tmp_path / "new") is None
    assert planned(tmp_path) is None
    (tmp_path / ".robots.csv.0123456789abcdef.musebot").write_text("interrupted")
    assert planned(tmp_path) is None
    write_manifest(tmp_path, PLAN)
    assert planned(tmp_path) == PLAN


def test_a_file_or_a_foreign_folder_cannot_hold_a_run(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="is not empty and holds no experiment of musebot's"):
        planned(tmp_path)
    for out in (tmp_path / "thesis.tex", tmp_path / "thesis.tex" / "below"):
        with pytest.raises(InputError, match="is not a folder"):
            planned(out)


def test_curves_are_read_without_brains(folder, results):
    (folder / BRAINS_FILE).unlink()
    with pytest.raises(DamagedFileError, match="lacks a file"):
        read_run(folder)
    (run,) = read_runs([folder], needs="curves")
    for condition, part in results.items():
        assert np.array_equal(run.results[condition].curves, part.curves)
        assert run.networks(condition, "after") == {}
    (folder / CURVES_FILE).unlink()
    with pytest.raises(DamagedFileError, match="lacks a file"):
        read_runs([folder], needs="curves")


def test_curves_of_another_run_are_refused(folder, tmp_path, results):
    other = tmp_path / "other"
    curves = {c: part.curves[::-1].copy() for c, part in results.items()}
    write_manifest(other, planned(folder))
    write_results(
        other, {c: dataclasses.replace(part, curves=curves[c]) for c, part in results.items()}
    )
    (folder / CURVES_FILE).write_bytes((other / CURVES_FILE).read_bytes())
    with pytest.raises(DamagedFileError, match="is not the file that musebot wrote for this run"):
        read_so_far(folder, "curves")
    assert read_so_far(folder, "rows").results


def test_a_run_without_brains_is_whole_only_if_it_has_all_rows_and_what_is_needed(folder, results):
    counts = {condition: len(part.robots) for condition, part in results.items()}
    plan = dataclasses.replace(planned(folder), robots=counts)
    assert not is_kept_without_brains(folder, plan, "rows")  # has all files
    (folder / BRAINS_FILE).unlink()
    assert is_kept_without_brains(folder, plan, "curves")
    (folder / CURVES_FILE).unlink()
    assert is_kept_without_brains(folder, plan, "rows")
    assert not is_kept_without_brains(folder, plan, "curves")
    more = {condition: 2 * robots for condition, robots in counts.items()}
    assert not is_kept_without_brains(folder, dataclasses.replace(plan, robots=more), "rows")
    (folder / ROBOTS_FILE).unlink()
    assert not is_kept_without_brains(folder, plan, "rows")
