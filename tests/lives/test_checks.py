"""Files of a run that contradict its plan or each other are refused with file, row and column."""

import dataclasses
import io
import json
import os
import re
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from musebot.protocols.errors import DamagedFileError
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import MANIFEST, write_manifest
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Robot, check_events, check_network_shapes
from musebot.protocols.lives.run_files import (
    BRAINS_FILE,
    CURVES_FILE,
    ROBOTS_FILE,
    read_results,
    read_run,
    write_results,
)
from musebot.protocols.lives.schedules import PARTS, SPOT_FINDING, WALL_AVOIDANCE
from musebot.protocols.storage import load_arrays, save_arrays, write_json

WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
EXPERIMENT = Experiment(seed=3, cohort_size=2, time_scale=0.05)  # tests of 60 s and of 180 s
PLAN = Plan(EXPERIMENT, {WALLS: 4, SPOT: 2})
NAN = float("nan")


@pytest.fixture
def results(invented):
    walls = [
        Robot("wall_avoidance", "fixed", 3, 0, 0, 12.5, 0.0, 1.0, "L = 1"),
        Robot("wall_avoidance", "fixed", 3, 0, 1, 0.0, 0.0, NAN, "genius"),
        Robot("wall_avoidance", "fixed", 3, 1, 2, 3.0, 1.0, 0.5, "0 < L < 1"),
        Robot("wall_avoidance", "fixed", 3, 1, 3, 60.0, 60.0, NAN, "invalid"),
    ]
    spot = [
        Robot("spot_finding", "creative", 3, 0, 0, 1.0, 3.0, 0.5, "0 < L < 1"),
        Robot("spot_finding", "creative", 3, 0, 1, 3.0, 3.0, 0.0, "L = 0"),
    ]
    return {rows.condition: invented(EXPERIMENT, rows.rows) for rows in map(Rows, (walls, spot))}


@dataclasses.dataclass
class Rows:
    rows: list

    @property
    def condition(self):
        return Condition(self.rows[0].task, self.rows[0].proposer)


@pytest.fixture
def folder(tmp_path, results, without_digests):
    """A run of a version that recorded no digests, by which any change would be seen."""
    write_manifest(tmp_path, PLAN)
    write_results(tmp_path, results)
    assert {*read_run(tmp_path).results} == {WALLS, SPOT}
    without_digests(tmp_path)
    return tmp_path


def refusal(folder, name):
    """Returns the sentence with which a run is refused because of a file."""
    with pytest.raises(DamagedFileError) as caught:
        read_results(folder)
    sentence = str(caught.value)
    assert str(folder / name) in sentence and "\n" not in sentence and len(sentence) < 600
    return sentence


# robots.csv

FIRST = "wall_avoidance,fixed,3,0,0,12.5,0.0,1.0,L = 1"
SECOND = "wall_avoidance,fixed,3,0,1,0.0,0.0,,genius"
THIRD = "wall_avoidance,fixed,3,1,2,3.0,1.0,0.5,0 < L < 1"
INVALID = "wall_avoidance,fixed,3,1,3,60.0,60.0,,invalid"
LAST = "spot_finding,creative,3,0,1,3.0,3.0,0.0,L = 0"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (SECOND, SECOND.replace("0.0,0.0,", "nan,nan,"), "row 3, column t_pre_s"),
        (SECOND, SECOND.replace("0.0,0.0,", "0.0,nan,"), "row 3, column t_post_s"),
        (FIRST, FIRST.replace("12.5", "1e400"), "row 2, column t_pre_s"),
        (FIRST, FIRST.replace("12.5", "-5.0"), "row 2, column t_pre_s: must lie in [0, 60.0]"),
        (FIRST, FIRST.replace("12.5", "60.1"), "row 2, column t_pre_s: must lie in [0, 60.0]"),
        (LAST, LAST.replace("3.0,3.0", "3.0,180.1"), "row 7, column t_post_s: must lie in [0, 180"),
        (FIRST, FIRST.replace("12.5", "12.53"), "row 2, column t_pre_s: must be a multiple of 0.1"),
        (FIRST, FIRST.replace("12.5", "1_2.5"), "row 2, column t_pre_s: must be a number"),
        (FIRST, FIRST.replace("12.5", "1" * 5000), "row 2, column t_pre_s: must be a number"),
        (THIRD, THIRD.replace(",0.5,", ",7.5,"), "row 4, column learn_ability: must be 0."),
        (THIRD, THIRD.replace(",0.5,", ",0.6,"), "row 4, column learn_ability: must be 0."),
        (THIRD, THIRD.replace(",0.5,", ",,"), "row 4, column learn_ability: must be 0."),
        (INVALID, INVALID.replace(",,", ",0.0,"), "row 5, column learn_ability: must be nan"),
        (THIRD, THIRD.replace("0 < L < 1", "L = 1"), "row 4, column category: must be '0 < L < 1'"),
        (SECOND, SECOND.replace("genius", "ignorant"), "row 3, column category: must be 'genius'"),
        (FIRST, FIRST.replace(",3,0,0,", ",4,0,0,"), "row 2, column seed: must be 3, got 4"),
        (FIRST, FIRST.replace(",3,0,0,", ",3.0,0,0,"), "row 2, column seed: must be a whole"),
        (FIRST, FIRST.replace(",3,0,0,", ",3,1,0,"), "row 2, column cohort: must be 0, got 1"),
        (THIRD, THIRD.replace(",1,2,", ",1,4,"), "row 4, column robot: must be 2, got 4"),
        (THIRD, THIRD.replace(",1,2,", ",0,1,"), "row 4, column robot: must be 2, got 1"),
        (THIRD, THIRD.replace(",1,2,", ",1,٢,"), "row 4, column robot: must be a whole number"),
        (THIRD, f"{SECOND}\n{THIRD}", "whole cohorts of 2, at most 4, got 5"),
        (f"{THIRD}\n{INVALID}\n", f"{THIRD}\n", "whole cohorts of 2, at most 4, got 3"),
        (FIRST, FIRST.replace("fixed", "random"), "the robots of wall_avoidance/random must be"),
        (LAST, LAST.replace("spot_finding", "swimming"), "row 7, the task must be one of"),
    ],
)
def test_a_row_that_contradicts_the_plan_or_itself_is_refused(folder, old, new, words):
    path = folder / ROBOTS_FILE
    text = path.read_text()
    assert old in text and new != old
    path.write_text(text.replace(old, new))
    assert words in refusal(folder, ROBOTS_FILE)


def test_a_users_agent_must_have_the_same_networks_before_and_after_training():
    shapes = {"before/one": ("F32", (2, 3)), "after/other": ("F32", (2, 3))}
    condition = Condition("wall_avoidance", "my.module:make")
    with pytest.raises(ValueError, match="has other networks before training than after it"):
        check_network_shapes(EXPERIMENT, condition, shapes, 4)


def test_a_run_that_is_being_enlarged_has_fewer_rows_than_its_plan(folder):
    path = folder / ROBOTS_FILE
    text = path.read_text()
    path.write_text(text.replace(f"{THIRD}\n{INVALID}\n", ""))
    assert [row.robot for row in read_results(folder)[WALLS].robots] == [0, 1]


# experiment.json of another run


@pytest.mark.parametrize(
    "changes", [{"seed": 4}, {"cohort_size": 1}, {"time_scale": 0.04}, {"protocol": "walls"}]
)
def test_an_edited_experiment_is_refused(folder, changes):
    content = json.loads((folder / MANIFEST).read_text())
    content["experiment"] |= changes
    write_json(folder / MANIFEST, content)
    with pytest.raises(DamagedFileError, match=re.escape(str(folder))):
        read_run(folder)


def test_an_edited_brain_is_refused(folder):
    content = json.loads((folder / MANIFEST).read_text())
    content["experiment"]["brain"]["evaluation_hidden"] = 8
    write_json(folder / MANIFEST, content)
    assert "evaluation.hidden_biases must have shape (N, 8) with N up to 4" in refusal(
        folder, BRAINS_FILE
    )


# curves.npz


def curves_of(results):
    return {str(condition): part.curves.copy() for condition, part in results.items()}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda curves: curves * NAN, "row 0, minute 0: must lie in [0, 1], got nan"),
        (lambda curves: curves - 2, "must lie in [0, 1]"),
        (lambda curves: curves * 0 + 1.5, "must lie in [0, 1], got 1.5"),
        (lambda curves: curves.astype(complex), "must be float32 of shape (N, 8)"),
        (lambda curves: curves.astype(float), "must be float32 of shape (N, 8)"),
        (lambda curves: curves[..., None], "must be float32 of shape (N, 8)"),
        (lambda curves: curves[0, 0], "must be float32 of shape (N, 8)"),
        (lambda curves: curves[:, :7], "must be float32 of shape (N, 8)"),
        (lambda curves: np.tile(curves, (2, 1)), "must be float32 of shape (N, 8) with N up to 4"),
        (lambda curves: np.array(["text"] * 4), "must be float32 of shape (N, 8)"),
        (lambda curves: curves[::-1], "row 0: the minutes of the test sum to "),
        (
            lambda curves: np.roll(curves, 1, axis=1),
            "but robots.csv has 12.5 s in contact (t_pre_s)",
        ),
    ],
)
def test_curves_that_are_no_shares_or_those_of_others_are_refused(folder, results, change, words):
    curves = curves_of(results)
    np.savez_compressed(folder / CURVES_FILE, **curves | {str(WALLS): change(curves[str(WALLS)])})
    assert words in refusal(folder, CURVES_FILE)


def test_curves_of_a_condition_that_is_not_planned_are_refused(folder, results):
    curves = curves_of(results)
    np.savez_compressed(folder / CURVES_FILE, **curves, other=curves[str(WALLS)])
    assert "other.npy, which is not planned" in refusal(folder, CURVES_FILE)


def npy(shape, content=b""):
    """Returns a file of numpy's whose head promises a shape."""
    head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + content


@pytest.mark.parametrize(
    "content",
    [
        npy("(1000000000000, 8)"),
        npy("(4, 1000000000000)"),
        npy("(" * 200 + ")" * 200),
        npy("(4, 8)", bytes(2**28)),  # 256 MiB that were compressed to 260 KiB
    ],
    ids=["rows", "minutes", "nested", "bomb"],
)
def test_promises_of_many_numbers_are_refused_before_memory_is_taken(folder, content):
    with zipfile.ZipFile(folder / CURVES_FILE, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{WALLS}.npy", content)
    assert (folder / CURVES_FILE).stat().st_size < 2**20
    tracemalloc.start()
    refusal(folder, CURVES_FILE)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**24


def test_an_archive_with_an_array_twice_is_refused(folder, results):
    buffer = io.BytesIO()
    np.save(buffer, results[WALLS].curves)
    with pytest.warns(UserWarning, match="Duplicate"):
        with zipfile.ZipFile(folder / CURVES_FILE, "w") as archive:
            for _ in range(2):
                archive.writestr(f"{WALLS}.npy", buffer.getvalue())
    assert "an array is in it twice" in refusal(folder, CURVES_FILE)


# brains.safetensors

AFTER = f"{WALLS}/after/evaluation.output_weights"
BEFORE = f"{WALLS}/before/evaluation.output_weights"


def changed(name, index, value):
    def change(arrays):
        arrays[name][index] = value
        return arrays

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (changed(AFTER, (2, 0, 3), NAN), f"{AFTER}, row 2: must be finite"),
        (changed(BEFORE, (0, 0, 0), np.inf), f"{BEFORE}, row 0: must be finite"),
        (changed(BEFORE, (0, 0, 0), 1.1), f"{BEFORE}, row 0: must be finite and within [-1, 1]"),
        (lambda a: a | {AFTER: a[AFTER][:, :, :6]}, f"{AFTER} must have shape (N, 1, 7)"),
        (lambda a: a | {AFTER: a[AFTER][..., None]}, f"{AFTER} must have shape (N, 1, 7)"),
        (lambda a: a | {AFTER: a[AFTER].astype(float)}, f"{AFTER} must be of dtype F32"),
        (lambda a: a | {AFTER: a[AFTER].astype(np.complex64)}, f"{AFTER} must be of dtype F32"),
        (lambda a: {n: x for n, x in a.items() if n != AFTER}, f"{AFTER} is missing"),
        (lambda a: a | {f"{AFTER}2": a[AFTER]}, "has no network after/evaluation.output_weights2"),
        (lambda a: a | {"more": a[AFTER]}, "it has more, which is not planned"),
        (lambda a: a | {AFTER: a[AFTER][:3]}, "have different numbers of robots"),
        (
            lambda a: {n: x for n, x in a.items() if not n.startswith(str(WALLS))},
            "lacks wall_avoidance/fixed",
        ),
        (
            lambda a: {n: np.tile(x, (3, *[1] * (x.ndim - 1))) for n, x in a.items()},
            "with N up to",
        ),
    ],
)
def test_brains_that_do_not_fit_the_run_are_refused(folder, change, words):
    arrays, _ = load_arrays(folder / BRAINS_FILE)
    save_arrays(folder / BRAINS_FILE, change(arrays))
    assert words in refusal(folder, BRAINS_FILE)


def test_an_invalid_robot_may_have_any_weights(folder):
    arrays, _ = load_arrays(folder / BRAINS_FILE)
    save_arrays(folder / BRAINS_FILE, changed(AFTER, 3, NAN)(arrays))
    part = read_results(folder)[WALLS]
    assert np.isnan(part.networks["after"]["evaluation.output_weights"][3]).all()


# Counts of events


@pytest.mark.parametrize("schedule", [WALL_AVOIDANCE.scaled(0.011), SPOT_FINDING.scaled(0.011)])
@pytest.mark.parametrize("step", [1, 150, 601, 1000])
def test_one_event_more_than_control_steps_is_refused(schedule, step):
    parts = [
        phase.part
        for phase, steps in zip(schedule.phases, schedule.steps(), strict=True)
        for _ in range(steps)
    ]
    assert step < len(parts)
    # A robot with the event in each step so far.
    events = np.array([[parts[:step].count(part) for part in PARTS]])
    minutes = np.array([[len(parts[:step][a : a + 600]) for a in range(0, len(parts), 600)]])
    check_events(schedule, events, minutes, step)
    check_events(schedule, 0 * events, 0 * minutes, step)
    for counts in (events, minutes):
        for column in range(counts.shape[1]):
            counts[0, column] += 1
            with pytest.raises(ValueError, match=f"row 0, column {column}: must lie in"):
                check_events(schedule, events, minutes, step)
            counts[0, column] -= 1


# Files that are no files


@pytest.mark.parametrize("name", [ROBOTS_FILE, CURVES_FILE, BRAINS_FILE, MANIFEST])
@pytest.mark.parametrize("kind", ["pipe", "folder", "device"])
def test_what_is_not_a_regular_file_is_refused_and_not_waited_for(folder, name, kind):
    path = folder / name
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    assert "is not a regular file" in refusal(folder, name)


def test_a_link_to_nothing_in_place_of_the_rows_is_not_an_empty_run(folder):
    (folder / ROBOTS_FILE).unlink()
    (folder / ROBOTS_FILE).symlink_to("nowhere")
    refusal(folder, ROBOTS_FILE)
