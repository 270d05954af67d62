"""The files of a run: what was measured comes back, and what is derived follows from it."""

import csv
import dataclasses

import numpy as np
import pytest
from helpers import change_physics
from hypothesis import given
from hypothesis import strategies as st

from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.manifest import MANIFEST, write_manifest
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.run import Lives, joined, network_shapes
from musebot.protocols.runs.run_files import (
    RESULTS_FILE,
    ROBOTS_FILE,
    planned,
    read_measured,
    read_run,
    write_results,
)
from musebot.protocols.storage import load_arrays, save_arrays

WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
AGENT = Condition("spot_finding", "some.where:agent")
EXPERIMENT = Experiment(seed=1, cohort_size=2, time_scale=0.05)
PLAN = Plan(EXPERIMENT, {WALLS: 6, SPOT: 4, AGENT: 2})


def sample(condition, robots=2, seed=0, most=600):
    """Returns random lives of robots with at most so many control steps of a minute counted."""
    draw, schedule = np.random.default_rng(seed), EXPERIMENT.life_of(condition.life)
    steps = schedule.steps_of_minutes()
    minutes = np.minimum(draw.integers(0, steps + 1, (robots, len(steps))), most)
    pre, post = (minutes[:, schedule.minutes_of(part)].sum(axis=1) for part in ("pre", "post"))
    shapes = network_shapes(EXPERIMENT, condition)
    before, after = (
        {
            name: draw.normal(0, 0.3, (robots, *shape)).astype(np.float32)
            for name, shape in ({"a/b": (2, 3), "c": ()} if shapes is None else shapes).items()
        }
        for _ in range(2)
    )
    events = np.column_stack([pre, minutes.sum(axis=1) - pre - post, post]).astype(np.int32)
    return Lives(events, minutes.astype(np.int16), draw.random(robots) < 0.8, before, after)


@st.composite
def measured(draw):
    """Draws what was measured of some of the plan's robots."""
    chosen = draw(st.sets(st.sampled_from([*PLAN.robots]), min_size=1))
    numbers = st.integers(0, 2**32 - 1)
    robots = {c: draw(st.sampled_from(range(2, PLAN.robots[c] + 1, 2))) for c in sorted(chosen)}
    return {
        c: sample(c, n, draw(numbers), draw(st.sampled_from([0, 1, 600])))
        for c, n in robots.items()
    }


def contents(lives):
    return [
        (c, [(k, x.dtype, x.shape, x.tobytes()) for k, x in sorted(own.arrays().items())])
        for c, own in lives.items()
    ]


def written(folder, measured, plan=PLAN):
    write_manifest(folder, plan)
    write_results(folder, plan.experiment, measured)
    return folder


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "run").mkdir()
    return written(tmp_path / "run", {WALLS: sample(WALLS), SPOT: sample(SPOT, 4)})


# Writing and reading


@given(measured())
def test_what_was_measured_survives_the_files(tmp_path_factory, lives):
    folder = written(tmp_path_factory.mktemp("run"), lives)
    assert {path.name for path in folder.iterdir()} == {RESULTS_FILE, ROBOTS_FILE, MANIFEST}
    assert contents(read_measured(folder, EXPERIMENT)) == contents(lives)
    without = {c: dataclasses.replace(own, before={}, after={}) for c, own in lives.items()}
    assert contents(read_measured(folder, EXPERIMENT, networks=False)) == contents(without)


@given(measured(), st.randoms())
def test_cohorts_joined_in_any_order_leave_the_same_bytes(tmp_path_factory, lives, order):
    cohorts = [
        (CohortKey(c, n), Lives.of({k: x[2 * n : 2 * n + 2] for k, x in own.arrays().items()}))
        for c, own in lives.items()
        for n in range(len(own.valid) // 2)
    ]
    first = [pair for pair in cohorts if pair[0].index == 0]  # a run that is enlarged
    later = [pair for pair in cohorts if pair[0].index > 0]
    order.shuffle(later)
    again = joined(joined({}, reversed(first)), later)
    folders = [tmp_path_factory.mktemp("run") for _ in range(2)]
    for folder, own in zip(folders, (lives, again), strict=True):
        written(folder, own)
    for name in (RESULTS_FILE, ROBOTS_FILE):
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_the_export_has_a_row_for_each_robot_and_nothing_reads_it(folder):
    run = read_run(folder)
    with (folder / ROBOTS_FILE).open(newline="") as file:
        rows = [*csv.DictReader(file)]
    robots = [robot for condition in run.conditions() for robot in run.robots(condition)]
    assert len(rows) == len(robots) == 6
    for row, robot in zip(rows, robots, strict=True):
        ability = "" if np.isnan(robot.learn_ability) else str(robot.learn_ability)
        values = dataclasses.asdict(robot) | {"learn_ability": ability}
        assert row == {name: str(value) for name, value in values.items()}
    for spoil in (lambda path: path.write_text("mine"), lambda path: path.unlink()):
        spoil(folder / ROBOTS_FILE)
        assert repr(read_run(folder).results) == repr(run.results)


def test_the_export_is_never_older_than_the_results(folder, monkeypatch):
    monkeypatch.setattr("musebot.protocols.runs.run_files.save_arrays", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_results(folder, EXPERIMENT, {WALLS: sample(WALLS, 6), SPOT: sample(SPOT, 4)})
    assert len((folder / ROBOTS_FILE).read_text().splitlines()) == 11
    assert sum(len(read_run(folder).robots(c)) for c in (WALLS, SPOT)) == 6


def test_a_run_that_is_kept_without_networks_has_all_else(folder):
    full = read_run(folder)
    lives = read_measured(folder, EXPERIMENT, networks=False)
    write_results(folder, EXPERIMENT, lives)
    kept = read_run(folder, networks=False)
    for condition in full.conditions():
        assert repr(kept.robots(condition)) == repr(full.robots(condition))
        assert (kept.curves(condition) == full.curves(condition)).all()
    with pytest.raises(InputError, match=f"^{folder} is kept without the networks"):
        read_run(folder)


def test_a_folder_without_results_has_no_robots_yet(folder, tmp_path):
    (folder / RESULTS_FILE).unlink()
    for path, words in (
        (folder, "holds no finished robots yet"),
        (tmp_path, "; it has the runs run$"),
        (tmp_path / "nowhere", "there is no folder"),
    ):
        with pytest.raises(InputError, match=words):
            read_run(path)


# Damage; tests/hostile puts other files in the place


def test_a_file_that_is_none_of_results_is_refused(folder):
    arrays, notes = load_arrays(folder / RESULTS_FILE)
    events = arrays[f"{WALLS}/events"]
    for name, array in {
        f"{WALLS}/valid": None,
        "events": events,
        "a/b/events": events,
        "wall_avoidance/divine/events": events,
    }.items():
        others = {k: x for k, x in arrays.items() if k != name}
        changed = others | ({} if array is None else {name: array})
        save_arrays(folder / RESULTS_FILE, changed, **notes)
        with pytest.raises(DamagedFileError, match=f"^{folder / RESULTS_FILE} holds no results"):
            read_run(folder)


# Folders


def test_a_folder_holds_a_plan_or_can_hold_a_new_run_or_is_foreign(folder, tmp_path):
    assert planned(folder) == PLAN
    assert planned(tmp_path / "new") is None
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / ".experiment.json.0123456789abcdef.musebot").write_text("")
    assert planned(tmp_path / "new") is None  # what a killed command has left
    for name in ("thesis.tex", ".git", ".novel.2024.draft", ".x.0123456789abcdeg.musebot"):
        (tmp_path / "new" / name).write_text("mine")
        for path in (tmp_path / "new", tmp_path / "new" / name):
            with pytest.raises(InputError, match=str(path)):
                planned(path)
        (tmp_path / "new" / name).unlink()


def test_a_replay_tells_of_another_physics_and_runs_mujoco_warps_in_c(folder, tmp_path, capsys):
    read_run(folder, replay=True)
    assert capsys.readouterr().err == ""
    change_physics(folder)
    read_run(folder)
    assert capsys.readouterr().err == ""
    read_run(folder, replay=True)
    assert "another physics" in capsys.readouterr().err
    warp = dataclasses.replace(EXPERIMENT, physics="warp")
    written(tmp_path, {SPOT: sample(SPOT)}, dataclasses.replace(PLAN, experiment=warp))
    assert read_run(tmp_path).experiment.physics == "warp"
    assert read_run(tmp_path, replay=True).experiment.physics == "c"
    assert "now run in C MuJoCo" in capsys.readouterr().err
